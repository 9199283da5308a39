# Sourced by the rigs that run the daemon. Such a script runs twice: on this machine, where it builds and judges, and in
# between in the guest, where it measures. `motord-checker` judges the logs of candump.

. "$(dirname "$(realpath "${BASH_SOURCE[0]}")")/common.sh"
export MOTORD_INSTANCE=demo

# Settings for run_inside: the times that a robot has by default.
robots_times=({cycle.max-lateness,safety.setpoint-timeout,safety.deadman,safety.start-timeout}-ms= safety.lost-cycles=)

inside() { [ -n "${RIG_PLACE:-}" ]; }

# into_memory COMMAND...: brings these programs, those of the rig, their libraries, and the linker's cache into the guest's memory. A file
# of /usr or /etc is copied there when it changes, and a new time of access is a change.
into_memory() {
    local files
    files=$(for command; do type -P "$command" || true; done; find . -type f -perm -1)
    files+=$'\n'$(echo "$files" | xargs ldd 2>/dev/null | grep -o '/[^ :]*' || true) # scripts have no libraries
    files=$(sort -u <<<"$files")
    # The files, and the links that lead to them.
    xargs touch -ac /etc/ld.so.cache <<<"$files"
    xargs touch -ach <<<"$files"
}

# In the guest a rig works in memory, and its programs are there, too: the guest's time runs ahead while it waits for
# this machine. What the rig leaves in its folder goes back to this machine.
if inside; then
    mkdir /tmp/robot
    cp -a "$RIG_PLACE/." /tmp/robot
    cd /tmp/robot
    trap 'cp -au . "$RIG_PLACE"' EXIT
    export MOTORD_RUNTIME_DIR=/run/motord-rig PATH=/tmp/robot:/usr/sbin:/usr/bin:/sbin:/bin
    mkdir -m 700 "$MOTORD_RUNTIME_DIR"
    into_memory bash awk cat chrt candump cangen cut date env grep ip jq kill ldd ls pgrep sed setpriv sleep sort strace tail wc xargs
fi

# run_inside SCRIPT [SECTION.KEY=[VALUE]...]: builds the programs and runs the script in a guest, with these settings in the
# robot's configuration. Both work in one folder, which goes when the calling script ends.
#
#   RIG_PROFILE=release cargo's profile
#   RIG_FEATURES=       features of cargo that the programs are built with
#   RIG_BIN=            a folder with the programs, and in `examples` the examples
#   RIG_EXAMPLE=        examples of the client or of verify/attackers that the script runs
#   RIG_FILES=          files of this repository that the script needs
#   RIG_ROBOT=          the robot's configuration, with at most eight simulated buses; config/quadruped-simulated.toml
#   RIG_ALSO=           a file that is appended to it
run_inside() {
    local script
    script=$(realpath "$1")
    shift
    provide candump=can-utils jq=jq cc=gcc
    cd "$tree"
    build_programs ${RIG_EXAMPLE:-}
    RIG_PLACE=$(mktemp -d /var/tmp/motord-robot.XXXXXX)
    chmod 755 "$RIG_PLACE" # others than root run programs here
    trap 'rm -rf "$RIG_PLACE"' EXIT
    cp "$bin"/{motord,motord-sim,motorctl,motord-checker} "$RIG_PLACE"
    [ -z "${RIG_EXAMPLE:-}" ] || cp $(printf "$bin/examples/%s " $RIG_EXAMPLE) "$RIG_PLACE"
    [ -z "${RIG_FILES:-}" ] || cp $RIG_FILES "$RIG_PLACE"
    cc -O2 -Wall -o "$RIG_PLACE/bare-loop" "$rigs/bare-loop.c"
    cc -O2 -Wall -o "$RIG_PLACE/block-thread" "$rigs/block-thread.c"
    on_vcan daemon.instance="\"$MOTORD_INSTANCE\"" "$@" <"${RIG_ROBOT:-config/quadruped-simulated.toml}" >"$RIG_PLACE/robot.toml"
    [ -z "${RIG_ALSO:-}" ] || cat "$RIG_ALSO" >>"$RIG_PLACE/robot.toml"
    cd "$RIG_PLACE"
    RIG_PLACE=$RIG_PLACE "$rigs/qemu-run" "$script"
}

# on_vcan [SECTION.KEY=[VALUE]...]: a simulated robot with its buses on vcan0 and up and these settings; one
# without a value has its default. The file's times are those of a machine that stalls now and then. Without IMUs: their thread
# would share the emulated core with the cycle.
on_vcan() {
    awk -v settings="$*" '
        BEGIN {
            for (n = split(settings, setting, " "); n; n--) {
                split(setting[n], part, /[.=]/)
                replaced[part[2]]
                if (part[3] == "") continue
                added["[" part[1] "]"] = added["[" part[1] "]"] "\n" part[2] " = " part[3]
            }
        }
        /^\[/ { is_imu = /^\[\[imu\]\]/ }
        is_imu || $1 in replaced { next }
        /^type = "simulated"/ { $0 = "type = \"socketcan\"\ninterface = \"vcan" buses++ "\"\nbitrate = 1000000" }
        { print $0 added[$0] }'
}

# What a busy kernel leaves to ksoftirqd waits behind every real-time program on its processor (docs/realtime.md), and on virtual CAN that
# is all frames.
raise_ksoftirqd() { pgrep ksoftirqd | xargs -n 1 chrt --fifo --pid 79; }

# start_simulator [FILE]: starts simulated motors on the CAN interfaces of FILE, of robot.toml. The process id is $simulator.
start_simulator() {
    raise_ksoftirqd
    : >simulator.log
    # The emulated kernel is slower than the wire: the motors leave it the time that a wire would take.
    chrt --fifo 40 motord-sim --config "${1:-robot.toml}" --wire-bitrate 8000000 </dev/null >simulator.log 2>&1 &
    simulator=$!
    await "motord-sim is ready" grep -q ready simulator.log
}

# Starts the daemon with robot.toml. The process id is $daemon.
start_daemon() {
    : >motord.log # that of the daemon before is ready already
    motord run --config robot.toml >motord.log 2>&1 &
    daemon=$!
    await "motord is ready" grep -q ' ready ' motord.log
}

# Both, up to motors that can be enabled.
start_robot() {
    start_simulator
    start_daemon
    await "all motors are idle" motors_are idle
}

stop_daemon() { kill "$daemon" && wait "$daemon"; }

stop_robot() { stop_daemon && kill "$simulator"; }

# start_trot SECONDS [COMMAND...]: lets the robot trot; COMMAND runs the controller. Its process id is $controller.
start_trot() {
    : >controller.log # that of the trot before tells of progress
    "${@:2}" motorctl demo-controller "$1" >controller.log 2>&1 &
    controller=$!
    await "the robot trots" grep -q progress controller.log
}

# note MARK...: for the checker, with the time as candump tells it.
note() { echo "$EPOCHREALTIME $*" >>notes; }

# Cycles since the daemon's start, by its own count.
ran() { status '.cycle - .overruns'; }

# The id of the thread that runs the cycle.
cycle_thread() { grep -lx motord-cycle /proc/"$daemon"/task/*/comm | cut -d/ -f5; }

# account THREAD: "cycles nanoseconds" of the cycle thread up to now; the time is the kernel's.
account() { echo "$(ran)" "$(cut -d' ' -f1 "/proc/$daemon/task/$1/schedstat")"; }

# cycle_cost SECONDS: the nanoseconds of processor time that a cycle takes meanwhile.
cycle_cost() {
    local thread
    thread=$(cycle_thread)
    { account "$thread" && sleep "$1" && account "$thread"; } |
        awk '{ cycles = $1 - cycles; time = $2 - time } END { print time / cycles }'
}

# status FILTER: what jq's FILTER makes of the daemon's state.
status() { motorctl status --json 2>/dev/null | jq -r "$1"; }

# motors_are MODE: all of them.
motors_are() { [ "$(status "[.joints[].mode == \"$1\"] | all")" = true ]; }

# group_is PHASE
group_is() { [ "$(status '.groups[0].phase')" = "$1" ]; }

# await WHAT COMMAND...: repeats the command until it succeeds, at most for 20 s.
await() {
    local what=$1 end=$((SECONDS + 20))
    shift
    until "$@"; do
        [ $SECONDS -lt $end ] || fail "not within 20 s: $what"
        sleep 0.1
    done
}

fail() {
    echo "$(basename "$0"): $*" >&2
    ! inside || tail -n 40 motord.log controller.log simulator.log >&2 2>/dev/null
    exit 1
}
