# Sourced by all rigs.

rigs=$(dirname "$(realpath "${BASH_SOURCE[0]}")")
tree=$(realpath "$rigs/../..")
cache_root=${RIG_CACHE:-$HOME/.cache/motord-rigs}

# Prints the comment at the head of the script that was called, and ends it.
usage() {
    sed -n '2,/^[^#]/s/^# \{0,1\}//p' "$0"
    exit 64
}

# provide COMMAND=PACKAGE...: installs the Debian packages of missing commands, or files.
provide() {
    local pair missing=()
    for pair; do
        command -v "${pair%%=*}" >/dev/null || [ -f "${pair%%=*}" ] || missing+=("${pair#*=}")
    done
    [ ${#missing[@]} -eq 0 ] || apt install -y --no-install-recommends "${missing[@]}"
}

# apt COMMAND...: runs apt-get, after an update if it fails without one. Silent unless it fails twice.
apt() {
    local log get="apt-get -o DPkg::Lock::Timeout=600"
    log=$(mktemp)
    { $get "$@" || { $get update && $get "$@"; }; } >"$log" 2>&1 || { cat "$log" >&2; return 1; }
    rm "$log"
}

# User Mode Linux 6.1, Debian's, exits at its first program on a processor with AMX: it cannot restore that many registers
# (put_fp_registers).
uml_runs() { ! grep -qw amx_tile /proc/cpuinfo; }

# Prints the hypervisor of `fresh-debian`: uml or qemu.
hypervisor() { echo "${RIG_HYPERVISOR:-$(uml_runs && echo uml || echo qemu)}"; }

# takes_no_longer QUIET RUN: the median cycle of RUN is at most 1.25 times that of QUIET, in the same run of the rig. Medians of two runs
# differed by 5 %; the spread of 20 runs was not measured. Both are files of `motorctl latency --json`. Missed ticks depend on the
# other load of this machine and are not judged.
takes_no_longer() { jq -s -e '.[1].cycle_us.p50 <= 1.25 * .[0].cycle_us.p50' "$1" "$2" >/dev/null; }

# in_two_groups: a quadruped's configuration with the group `front` for a controller and the group `rear` for another client.
in_two_groups() {
    sed '/^\[\[group\]\]/,$d'
    printf '[[group]]\nname = "%s"\njoints = [%s]\n' \
        front '"fl-hip", "fl-thigh", "fl-knee", "fr-hip", "fr-thigh", "fr-knee"' \
        rear '"rl-hip", "rl-thigh", "rl-knee", "rr-hip", "rr-thigh", "rr-knee"'
}

# build_programs [EXAMPLE...]: builds the programs that the rigs run, and these examples, in the folder $bin. RIG_BIN is a folder that has
# them. The examples of the client and of verify/attackers are built with the features of the workspace, the daemon without those of tests.
build_programs() {
    local target profile=${RIG_PROFILE:-release} options example examples=("${@/#/--example=}")
    target=$(realpath -m "${CARGO_TARGET_DIR:-$tree/target}")
    # A build for a rig must not be taken for one for a robot.
    [ -z "${RIG_FEATURES:-}" ] || target+=/with-features
    # The folder of cargo's profile dev is called debug.
    bin=${RIG_BIN:-$target/${profile/#dev/debug}}
    if [ -n "${RIG_BIN:-}" ]; then
        for example in "$@"; do
            [ -x "$bin/examples/$example" ] || { echo "RIG_BIN has no examples/$example" >&2; exit 1; }
        done
        return
    fi
    options=(--quiet --locked --profile "$profile" --manifest-path "$tree/Cargo.toml" --target-dir "$target")
    # Programs last: a build of examples may replace them.
    [ $# = 0 ] || cargo build "${options[@]}" --workspace "${examples[@]}"
    cargo build "${options[@]}" -p motord -p motorctl -p motord-checker --features "${RIG_FEATURES:-}"
}

# build_beside FOLDER PROGRAM [OPTION...]: builds a program of a workspace of its own, with these options of cargo, and prints its path.
build_beside() {
    local target
    target=$(realpath -m "${CARGO_TARGET_DIR:-$tree/target}")/${1#bridge/}
    cargo build --quiet --locked --release --manifest-path "$tree/$1/Cargo.toml" --target-dir "$target" "${@:3}" >&2 || return
    echo "$target/release/$2"
}

# build_bridge: builds motord-bridge, and sets RIG_BRIDGE to its path. RIG_BRIDGE may name one that is built.
build_bridge() { RIG_BRIDGE=${RIG_BRIDGE:-$(build_beside bridge motord-bridge)}; }

# build_remote: the same for motord-remote and RIG_REMOTE.
build_remote() { RIG_REMOTE=${RIG_REMOTE:-$(build_beside bridge/remote motord-remote)}; }

# zenoh_python: an environment of Python with zenoh, in $cache_root/remote.
zenoh_python() {
    ! "$cache_root/remote/bin/python3" -c 'import zenoh' 2>/dev/null || return 0
    python3 -c 'import ensurepip' 2>/dev/null || apt install -y --no-install-recommends python3-venv
    python3 -m venv "$cache_root/remote"
    "$cache_root/remote/bin/pip" install --disable-pip-version-check --quiet eclipse-zenoh
}

# wheel_python FOLDER EXTRAS: an environment of Python with the wheel of this tree and its extras. RIG_WHEEL may name one that is built.
wheel_python() {
    local pip=("$1/bin/pip" --disable-pip-version-check --quiet) wheel
    python3 -c 'import ensurepip' 2>/dev/null || apt install -y --no-install-recommends python3-venv
    python3 -m venv "$1"
    "${pip[@]}" install maturin
    wheel=${RIG_WHEEL:-$(PATH=$1/bin:$PATH "$tree/packaging/wheel" "$1/wheel")}
    "${pip[@]}" install --force-reinstall --no-deps "$wheel"
    "${pip[@]}" install "$wheel[$2]"
}

# build_router: the router zenohd, of the version of motord-remote's zenoh, and sets RIG_ZENOHD to its path. RIG_ZENOHD may name one that is
# installed.
build_router() {
    local version
    version=$(awk '$0 == "name = \"zenoh\"" { getline; gsub(/"/, ""); print $3 }' "$tree/bridge/remote/Cargo.lock")
    RIG_ZENOHD=${RIG_ZENOHD:-$cache_root/zenohd-$version/bin/zenohd}
    [ -x "$RIG_ZENOHD" ] || nice -n 10 cargo install --quiet --locked --root "$cache_root/zenohd-$version" "zenohd@$version"
}

# authority NAME: a certificate that signs others, NAME.pem and NAME.key in $work.
authority() {
    openssl req -x509 -newkey ec -pkeyopt ec_paramgen_curve:prime256v1 -noenc -keyout "$work/$1.key" -subj "/CN=$1" -days 10 \
        -out "$work/$1.pem" 2>/dev/null
}

# certificate NAME AUTHORITY [COMMON_NAME [DAYS]]: NAME.pem and NAME.key in $work, for the addresses of the rigs.
certificate() {
    openssl req -newkey ec -pkeyopt ec_paramgen_curve:prime256v1 -noenc -keyout "$work/$1.key" -subj "/CN=${3:-$1}" \
        -out "$work/$1.csr" 2>/dev/null
    openssl x509 -req -in "$work/$1.csr" -CA "$work/$2.pem" -CAkey "$work/$2.key" -days "${4:-10}" -out "$work/$1.pem" \
        -extfile <(echo "subjectAltName = IP:127.0.0.1, IP:10.7.0.1, DNS:$1") 2>/dev/null
}

# await SECONDS WHAT COMMAND...: repeats the command until it succeeds, at most for so long. Then the rig's `fail` ends it.
await() {
    local end=$((SECONDS + $1)) what=$2
    until "${@:3}"; do
        [ $SECONDS -lt $end ] || fail "not within $1 s: $what"
        sleep 0.05
    done
}

# go_first NICENESS: this process and its children run before other load of this machine, which otherwise takes turns and messages from
# them. The kernel weighs sessions where it has autogroups, and processes within each. close_work undoes it for the session.
go_first() {
    renice --priority "$1" $$ >/dev/null
    goes_first=1
    [ ! -e /proc/self/autogroup ] || echo "$1" >/proc/self/autogroup
}

# open_work: makes the folder $work. At its end the rig kills $processes, and removes the folder with what is mounted in it.
open_work() {
    work=$(mktemp -d)
    processes=()
    trap close_work EXIT
}

close_work() {
    [ ${#processes[@]} -eq 0 ] || kill "${processes[@]}" 2>/dev/null || true
    wait
    umount "$work"/* 2>/dev/null || true
    rm -rf "$work"
    [ -z "${goes_first:-}" ] || [ ! -e /proc/self/autogroup ] || echo 0 >/proc/self/autogroup
}

# stops_python: the Python of the sources in bridge-stops.py. Makes its environment where it is missing.
stops_python() {
    local environment=$cache_root/bridge-stops
    if ! "$environment/bin/python3" -c 'import websockets, cyclonedds' 2>/dev/null; then
        python3 -c 'import ensurepip' 2>/dev/null || apt install -y --no-install-recommends python3-venv
        python3 -m venv "$environment"
        "$environment/bin/pip" install --disable-pip-version-check --quiet websockets cyclonedds
    fi
    echo "$environment/bin/python3"
}

# hand_over COMMAND...: makes the folder $rig, from which `guest` reads the command, its directory and its environment.
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

# mcap_python: the Python of an environment with the official reader of MCAP. Makes it where it is missing.
mcap_python() {
    local environment=$cache_root/mcap
    if ! "$environment/bin/python3" -c 'import mcap, mcap_protobuf' 2>/dev/null; then
        python3 -c 'import ensurepip' 2>/dev/null || apt install -y --no-install-recommends python3-venv
        python3 -m venv "$environment"
        "$environment/bin/pip" install --disable-pip-version-check --quiet mcap mcap-protobuf-support
    fi
    echo "$environment/bin/python3"
}

# judge_loss RECORDING MOST: in a recording of a robot with the IMU `base`, the cycles from its last sample to its loss, which must be fewer
# than MOST, and from there to the stop of the group `legs`, at most one.
judge_loss() {
    local python
    python=$(mcap_python)
    "$python" - "$1" "$2" <<'PYTHON'
import sys
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

decode, cycles = DecoderFactory().decoder_for, {}
with open(sys.argv[1], "rb") as file:
    for schema, channel, message in make_reader(file).iter_messages(topics=["/cycle", "/imus/base", "/groups/legs"]):
        cycles.setdefault(message.log_time, {})[channel.topic] = decode(channel.message_encoding, schema)(message.data)
lost, stopped, fresh, after = None, None, 0, 0
for time, topics in sorted(cycles.items()):
    imu, group = topics.get("/imus/base"), topics.get("/groups/legs")
    if imu and lost is None:
        fresh = fresh + 1 if not imu.fresh else 0
        if imu.lost:
            lost, after = time, fresh
    if group and group.cause == "imu-lost" and stopped is None:
        stopped = time
assert lost and stopped, (lost, stopped)
later = sum(lost < time <= stopped for time in cycles)
print(f"  lost {after} cycles after the last sample, stopped {later} cycle after the loss")
assert after < int(sys.argv[2]), "the IMU is lost late"
assert later <= 1, "the robot is stopped in the cycle after the one that finds the loss"
PYTHON
}
