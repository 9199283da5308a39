# Sourced by the rigs of motord-remote: a network namespace for the robot, in which `serve` runs, and this one for the other computer, with
# a cable between them, the interfaces `cable` (10.7.0.2) and `robot` (10.7.0.1), and on the other computer remote-link, which delays, loses,
# reorders, repeats and cuts.
#
#   RIG_REMOTE=    a motord-remote that is built; RIG_BIN, a folder with the other programs
#   RIG_SECONDS=   of each drive
#   RIG_NETEM=1    in a guest of qemu-run the kernel delays, loses, reorders and repeats, by netem on both ends of the cable; remote-link cuts

. "$(dirname "$(realpath "${BASH_SOURCE[0]}")")/common.sh"

arguments=("$@")

fail() {
    echo "$(basename "$0"): $*" >&2
    tail -n 5 "$work"/*.log >&2
    exit 1
}

# enter_network [EXAMPLE...]: builds what is missing, and runs the rig again in a network namespace, with RIG_NETEM in one of a guest. Returns
# there only.
enter_network() {
    [ -z "${RIG_IN_NAMESPACE:-}" ] || { bin=$RIG_BIN; return 0; }
    provide jq=jq ip=iproute2 nsenter=util-linux
    build_programs "$@"
    build_remote
    export RIG_BIN=$bin RIG_REMOTE
    if [ -n "${RIG_NETEM:-}" ] && [ -z "${RIG_IN_GUEST:-}" ]; then
        RIG_IN_GUEST=1 exec "$rigs/qemu-run" "$0" "${arguments[@]}"
    fi
    RIG_IN_NAMESPACE=1 exec unshare --net "$0" "${arguments[@]}"
}

# open_network: the folder $work, both namespaces and the cable.
open_network() {
    open_work
    mkdir -m 700 "$work/robot" "$work/other"
    [ -z "${RIG_NETEM:-}" ] || programs_into_memory
    unshare --net sleep infinity &
    robot_ns=$!
    processes+=("$robot_ns")
    await 20 "the robot's namespace" other_namespace "$robot_ns"
    ip link set lo up
    ip link add cable type veth peer name robot netns "$robot_ns"
    ip address add 10.7.0.2/24 dev cable
    ip link set cable up
    on_robot ip link set lo up
    on_robot ip address add 10.7.0.1/24 dev robot
    on_robot ip link set robot up
}
# The guest's time runs ahead while it waits for a file of this machine, such as a page of a program.
programs_into_memory() {
    mkdir -p "$work/bin/examples"
    cp -L "$bin"/{motord,motorctl} "$RIG_REMOTE" "$work/bin"
    cp -L "$bin/examples/remote-link" "$work/bin/examples"
    bin=$work/bin RIG_REMOTE=$work/bin/$(basename "$RIG_REMOTE")
}
other_namespace() { [ "$(readlink "/proc/$1/ns/net")" != "$(readlink /proc/self/ns/net)" ]; }
on_robot() { MOTORD_RUNTIME_DIR=$work/robot nsenter --net --target "$robot_ns" "$@"; }
on_other() { MOTORD_RUNTIME_DIR=$work/other "$@"; }

# start NAME PLACE COMMAND...: runs it in the background on `robot` or `other`, its output in NAME.log, its process in pid_NAME. $scheduled
# are the words of a command that runs it, such as chrt.
scheduled=()
start() {
    local name=$1 runtime="MOTORD_RUNTIME_DIR=$work/$2" enter=()
    [ "$2" = other ] || enter=(nsenter --net --target "$robot_ns")
    shift 2
    # No shell between: a signal must reach the program.
    exec_in_background "$runtime" "${enter[@]}" "${scheduled[@]}" "$@" >>"$work/$name.log" 2>&1 &
    printf -v "pid_$name" %s $!
    processes+=($!)
}
exec_in_background() { exec env "$@"; }
# end NAME SIGNAL
end() {
    local name=pid_$1
    kill "-$2" "${!name}" 2>/dev/null || true
    wait "${!name}" 2>/dev/null || true
}

# configuration PROTOCOL [CERTIFICATE]: of both computers. The mirror connects to $peer, by default remote-link. $of_serve are further lines
# of [serve].
peer=127.0.0.1
options=
of_serve=
configuration() {
    local security=$'plaintext = true\n' claims=$of_serve
    if [ $# = 2 ]; then
        claims+=$'\nmay-claim = ["nuc"]'
        security=$'[network.tls]\n'"authority = \"$work/ca.pem\""
    fi
    local of_robot="certificate = \"$work/robot.pem\"
key = \"$work/robot.key\""
    [ $# = 2 ] || of_robot=
    printf '[serve]\nrobot = "go7"\ninstance = "demo"\n%s\n[network]\nlisten = ["%s/10.7.0.1:7447%s"]\n%s\n%s\n' \
        "$claims" "$1" "$options" "$security" "$of_robot" >"$work/serve.toml"
    local of_other=
    [ $# != 2 ] || of_other="certificate = \"$work/$2.pem\"
key = \"$work/$2.key\""
    printf '[mirror]\nrobot = "go7"\n[network]\nconnect = ["%s/%s:7447%s"]\n%s\n%s\n' \
        "$1" "$peer" "$options" "$security" "$of_other" >"$work/mirror.toml"
}

start_remote() {
    start serve robot "$RIG_REMOTE" serve --config "$work/serve.toml"
    start mirror other "$RIG_REMOTE" mirror --config "$work/mirror.toml"
}
sees_robot() { on_other "$bin/motorctl" status --json >"$work/status.json" 2>/dev/null; }
group() { on_robot "$bin/motorctl" --instance demo status --json | jq -r ".groups[0].$1"; }
is_phase() { [ "$(group phase)" = "$1" ]; }
reset() { on_robot "$bin/motorctl" --instance demo reset >/dev/null; }

# start_link ARGUMENT...: remote-link on the other computer.
start_link() {
    coproc LINK { "${scheduled[@]}" "$bin/examples/remote-link" "$@" 2>>"$work/link.log"; }
    processes+=("$LINK_PID")
}
# tell LINE: to remote-link.
tell() { echo "$@" >&"${LINK[1]}"; }

# quality DELAY_MS JITTER_MS LOSS REORDER DUPLICATE: of the network from now on, each way; shares of the packets, 0 to 1.
quality() {
    if [ -z "${RIG_NETEM:-}" ]; then
        tell quality "$@"
        return
    fi
    tell quality 0 0 0 0 0
    local netem
    netem=$(awk '{
        printf "delay %sms", $1
        if ($2 > 0) printf " %sms", $2
        if ($3 > 0) printf " loss %s%%", 100 * $3
        if ($4 > 0) printf " reorder %s%%", 100 * $4
        if ($5 > 0) printf " duplicate %s%%", 100 * $5
    }' <<<"$*")
    # A changed qdisc would keep the reordering of the one before.
    tc qdisc del dev cable root 2>/dev/null || true
    on_robot tc qdisc del dev robot root 2>/dev/null || true
    tc qdisc add dev cable root netem $netem
    on_robot tc qdisc add dev robot root netem $netem
}
