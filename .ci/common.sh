# Sourced by .ci/full: runs steps, keeps their logs and times, and installs what a new machine lacks.

export CARGO_TERM_COLOR=never
# A clean clone is built once: the files of an incremental build would only fill the disk.
export CARGO_INCREMENTAL=0
target=$(realpath -m "${CARGO_TARGET_DIR:-target}")
work=$(mktemp -d)
lane=''

# step NAME: runs the function of that name, or the rig. Prints its output, and keeps it, the time and the failure. Its status is 0:
# bash ignores set -e below a command whose status is tested.
step() {
    local name=$1 begun=$SECONDS status
    printf '\n=== %s\n' "$name"
    set +e
    (set -e; perform "$name") 2>&1 </dev/null | tee "$work/$name.log"
    status=${PIPESTATUS[0]}
    set -e
    [ "$status" = 0 ] || echo "$name" >>"$work/failed"
    printf '%5d s  %s%s\n' $((SECONDS - begun)) "$name" "$([ "$status" = 0 ] || echo ": FAILED")" >>"$work/times"
}

has_failed() { [ -s "$work/failed" ]; }

perform() {
    local function=${1//-/_}
    if declare -F "$function" >/dev/null; then "$function"; else "verify/rigs/$1"; fi
}

# start_lane NAME...: runs these steps one after the other beside the others, with the processor time that they leave.
start_lane() {
    (
        chrt --idle --pid 0 $BASHPID
        for name; do step "$name"; done
    ) >"$work/lane" 2>&1 &
    lane=$!
}

# Waits for the lane, and prints its output.
join_lane() {
    [ -n "$lane" ] || return 0
    wait "$lane" || true
    lane=
    cat "$work/lane"
}

# Prints the times, and last the end of the log of each step that failed.
finish() {
    local status=$? name
    join_lane
    ! has_failed || status=1
    if [ -s "$work/times" ]; then
        printf '\n=== times\n'
        cat "$work/times"
        printf '%5d s  in all, status %d\n' $SECONDS "$status"
    fi
    ! has_failed || while read -r name; do
        printf '\n=== %s FAILED; the end of its log:\n' "$name"
        tail -n 60 "$work/$name.log"
    done <"$work/failed"
    rm -rf "$work"
    exit "$status"
}
trap finish EXIT
trap 'exit 130' INT TERM

# has COMMAND PACKAGE: installs the Debian package of a command that this machine lacks.
has() {
    command -v "$1" >/dev/null && return
    local apt="apt-get -o DPkg::Lock::Timeout=600"
    $apt install -y "$2" >/dev/null 2>&1 || { $apt update >/dev/null && $apt install -y "$2" >/dev/null; }
}

# cargo_has COMMAND: builds a command of cargo that this machine lacks.
cargo_has() { command -v "$1" >/dev/null || cargo install --quiet --locked "$1"; }

# readme_command N: the sh block number N of README.md.
readme_command() {
    awk -v want="$1" '/^```sh$/ { block++; inside = 1; next } /^```$/ { inside = 0 } inside && block == want' README.md
}
