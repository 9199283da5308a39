# Sourced by the rigs: what they share.

rigs=$(dirname "$(realpath "${BASH_SOURCE[0]}")")
tree=$(realpath "$rigs/../..")
cache_root=${RIG_CACHE:-$HOME/.cache/motord-rigs}

# Prints the comment at the head of the script that was called, and ends it.
usage() {
    sed -n '2,/^[^#]/s/^# \{0,1\}//p' "$0"
    exit 64
}

# provide COMMAND=PACKAGE...: installs the Debian packages of commands that are not there.
provide() {
    local pair missing=()
    for pair; do
        command -v "${pair%%=*}" >/dev/null || missing+=("${pair#*=}")
    done
    [ ${#missing[@]} -eq 0 ] || apt install -y --no-install-recommends "${missing[@]}"
}

# apt COMMAND...: runs apt-get, after an update if it fails without one. Silent unless it fails twice.
apt() {
    local log
    log=$(mktemp)
    { apt-get "$@" || { apt-get update && apt-get "$@"; }; } >"$log" 2>&1 || { cat "$log" >&2; return 1; }
    rm "$log"
}

# User Mode Linux 6.1 ends at its first program on a processor with AMX: it cannot restore that many registers (put_fp_registers).
uml_runs() { ! grep -qw amx_tile /proc/cpuinfo; }

must_run_uml() {
    uml_runs && return
    echo "$(basename "$0"): User Mode Linux 6.1 does not run on a processor with AMX: use another machine" >&2
    exit 125
}

# takes_no_longer QUIET RUN: the median cycle of RUN is at most 1.25 times that of QUIET; runs differ by 5 %. Both are files of
# `motorctl latency --json`. Missed ticks tell of this machine's other work, too, and are not judged.
takes_no_longer() { jq -s -e '.[1].cycle_us.p50 <= 1.25 * .[0].cycle_us.p50' "$1" "$2" >/dev/null; }

# in_two_groups: a quadruped's configuration, with a group for a controller, the front, and one for somebody else.
in_two_groups() {
    sed '/^\[\[group\]\]/,$d'
    printf '[[group]]\nname = "%s"\njoints = [%s]\n' \
        front '"fl-hip", "fl-thigh", "fl-knee", "fr-hip", "fr-thigh", "fr-knee"' \
        rear '"rl-hip", "rl-thigh", "rl-knee", "rr-hip", "rr-thigh", "rr-knee"'
}

# hand_over COMMAND...: makes the folder $rig, from which `guest` learns what to run, where and with which environment.
hand_over() {
    rig=$(mktemp -d /var/tmp/motord-rig.XXXXXX)
    trap 'rm -rf "$rig"' EXIT
    printf '%q ' "$@" >"$rig/command"
    pwd >"$rig/directory"
    echo "$tree" >"$rig/tree"
    env -0 | grep -zE '^(PATH|HOME|CI|RIG_[A-Z_]*|CARGO_[A-Z_]*|RUST[A-Z_]*|MOTORD_[A-Z_]*)=' >"$rig/environment" || true
}

# Ends the script with the status of the command that ran in the guest.
finish() {
    [ -f "$rig/status" ] || { echo "$(basename "$0"): the guest ended without a status" >&2; exit 125; }
    exit "$(cat "$rig/status")"
}
