# Sourced by test-service: the packages of motord-bridge and motord-remote and their units, by docs/bridge.md, docs/gamepad.md,
# docs/gpio.md and docs/remote.md, beside the running robot.

# of_process UNIT FIELD: this line of its main process in /proc.
of_process() { sed -n "s/^$2:[[:space:]]*//p" "/proc/$(of "$1" MainPID)/status"; }

# runs_as_a_user_of_its_own UNIT: one that systemd makes for it, and a member of the group motord.
runs_as_a_user_of_its_own() {
    local user
    user=$(of_process "$1" Uid | cut -f 1)
    [ "$user" -ge 61184 ] && [ "$user" -le 65519 ] || fail "$1 runs as $user"
    is_member "$1" motord
}

# is_member UNIT GROUP
is_member() {
    [[ " $(of_process "$1" Groups) " == *" $(getent group "$2" | cut -d : -f 3) "* ]] || fail "$1 is no member of $2: $(of_process "$1" Groups)"
}

# sends_from UNIT ADDRESS: a process in the unit's control group sends a packet there.
sends_from() {
    local groups=/sys/fs/cgroup
    [ ! -d "$groups/unified" ] || groups+=/unified
    (
        echo $BASHPID >"$groups$(of "$1" ControlGroup)/cgroup.procs"
        exec perl -MIO::Socket::INET -e 'defined IO::Socket::INET->new(Proto => "udp", PeerAddr => "$ARGV[0]:9")->send("x") or die "$!\n"' "$2"
    )
}

# denies_other_addresses UNIT: its packets stay on loopback, where the kernel has the filter.
denies_other_addresses() {
    local status=0
    ip address replace 10.9.0.1/32 dev lo
    sends_from "$1" 127.0.0.1 || fail "$1 may not send to this computer"
    sends_from "$1" 10.9.0.1 2>denied.log || status=$?
    ip address delete 10.9.0.1/32 dev lo
    if [ "$status" != 0 ]; then
        grep -q 'Operation not permitted' denied.log || fail "the packet was not denied: $(cat denied.log)"
    else
        [ "$(journalctl --output=cat | grep -c 'does not support BPF')" -gt 0 ] || fail "$1 sends to other addresses"
        echo "  NOT CHECKED: this kernel does not support BPF, so IPAddressDeny= of $1 has no effect"
    fi
}

# returns_after_a_kill UNIT: systemd starts another process.
returns_after_a_kill() {
    local process restarts
    process=$(of "$1" MainPID) restarts=$(of "$1" NRestarts)
    kill -KILL "$process"
    await "$1 is started again" restarted "$1" "$restarts"
    [ "$(of "$1" MainPID)" != "$process" ] || fail "$1 is the same process"
}

restarted() { [ "$(of "$1" NRestarts)" -gt "$2" ] && [ "$(of "$1" ActiveState) $(of "$1" SubState)" = "active running" ]; }

# request METHOD PATH ORIGIN: the answer of the page. This Debian has no curl.
request() {
    perl -MIO::Socket::INET -e '
        my $page = IO::Socket::INET->new(PeerAddr => "127.0.0.1:8642") or die "$!\n";
        print $page "$ARGV[0] $ARGV[1] HTTP/1.1\r\nHost: 127.0.0.1:8642\r\nOrigin: $ARGV[2]\r\nContent-Length: 0\r\nConnection: close\r\n\r\n";
        print while <$page>' "$@"
}

# answers STATUS METHOD PATH [ORIGIN]
answers() { request "$2" "$3" "${4:-http://127.0.0.1:8642}" >answer.log 2>&1 && head -n 1 answer.log | grep "^HTTP/1.1 $1 " >/dev/null; }

bridge_is_a_service_whose_page_stops_the_robot() {
    as_told bridge 1 Service
    units_are inactive motord-bridge
    sed -i '/^\[web\]/,/^\[gamepad\]/s/^enabled = false/enabled = true/' /etc/motord/bridge.toml
    as_told bridge 2 Service
    await "the page shows the robot" answers 200 GET /api/state
    tail -n 1 answer.log | grep -o '{.*' | jq -e '.' >/dev/null || fail "it shows $(cat answer.log)"
    runs_as_a_user_of_its_own motord-bridge
    denies_other_addresses motord-bridge
    trot
    answers 403 POST /api/stop http://example.org || fail "another site gets $(cat answer.log)"
    group_is active || fail "another site stops the robot"
    note stopped
    answers 200 POST /api/stop || fail "the page gets $(cat answer.log)"
    await "the group is stopped" group_is disarmed
    [ "$(status '.groups[0].stop.cause')" = emergency-stop ] || fail "the cause is $(status '.groups[0].stop.cause')"
    status '.groups[0].stop.asked_by.program' | grep '^motord-bridge: the page' >/dev/null ||
        fail "the stop names $(status '.groups[0].stop.asked_by')"
    motorctl reset --wait >/dev/null
    note start
}

bridge_returns_after_a_kill_and_has_its_devices_by_drop_ins() {
    local drop_in
    returns_after_a_kill motord-bridge
    await "the page shows the robot again" answers 200 GET /api/state
    as_told gamepad 1 Service
    as_told gpio 1 "Switch it on"
    await "the page shows the robot with the drop-ins" answers 200 GET /api/state
    for drop_in in gamepad:char-input:input gpio:char-gpiochip:gpio; do
        IFS=: read -r drop_in device group <<<"$drop_in"
        of motord-bridge DropInPaths | grep "/$drop_in.conf" >/dev/null || fail "the unit has $(of motord-bridge DropInPaths)"
        of motord-bridge DeviceAllow | grep "$device r" >/dev/null || fail "the unit has $(of motord-bridge DeviceAllow)"
        is_member motord-bridge "$group"
    done
    [ "$(of motord-bridge PrivateDevices) $(of motord-bridge DevicePolicy)" = "no closed" ] || fail "the unit has other devices"
    apt-get purge --quiet --yes motord-bridge >commands.log 2>&1 || { cat commands.log; fail "the purge fails"; }
    rm -r /etc/systemd/system/motord-bridge.service.d
    groupdel gpio
    systemctl daemon-reload
}

# mirrored FILTER: what jq's FILTER makes of the state of the mirror.
mirrored() { motorctl --instance go7 status --json 2>mirror.log | jq -r "$1"; }

mirror_has_newer_states() {
    local cycle
    cycle=$(mirrored .cycle)
    [ "${cycle:-0}" -gt "$1" ]
}

# serve and mirror on one computer, in place of two.
remote_robot_is_served_and_mirrored_by_units() {
    local unit
    as_told remote 1 Service
    units_are inactive motord-remote-serve motord-remote-mirror
    refused_without_configuration motord-remote-serve
    printf '[%s]\nrobot = "go7"\n[network]\nplaintext = true\n%s = ["udp/127.0.0.1:7447"]\n' serve listen >/etc/motord/remote.toml
    printf '[%s]\nrobot = "go7"\ninstance = "go7"\n[network]\nplaintext = true\n%s = ["udp/127.0.0.1:7447"]\n' mirror connect \
        >/etc/motord/mirror.toml
    mkdir /etc/systemd/system/motord-remote-mirror.service.d
    printf '[Service]\nExecStart=\nExecStart=/usr/bin/motord-remote mirror --config /etc/motord/mirror.toml\n' \
        >/etc/systemd/system/motord-remote-mirror.service.d/rig.conf
    systemctl daemon-reload
    as_told remote 2 Service
    as_told remote 3 Service
    await "the mirror has a state" mirror_has_newer_states 0
    [ "$(mirrored '.joints | length')" = 12 ] || fail "the mirror has $(mirrored '[.joints[].name]')"
    runs_as_a_user_of_its_own motord-remote-serve
    [ "$(ps -o user= -p "$(of motord-remote-mirror MainPID)")" = motord ] || fail "the mirror does not run as motord"
    for unit in motord-remote-serve motord-remote-mirror; do
        denies_other_addresses $unit
        returns_after_a_kill $unit
        await "the mirror has newer states after a kill of $unit" mirror_has_newer_states "$(status .cycle)"
    done
    apt-get purge --quiet --yes motord-remote >commands.log 2>&1 || { cat commands.log; fail "the purge fails"; }
    rm -r /etc/systemd/system/motord-remote-mirror.service.d /etc/motord/mirror.toml
    systemctl daemon-reload
}

refused_without_configuration() {
    mv /etc/motord/remote.toml remote.toml
    systemctl start "$1"
    await "$1 ends" units_have failed "$1"
    [ "$(of "$1" ExecMainStatus) $(of "$1" NRestarts)" = "66 0" ] ||
        fail "$1 ends with $(of "$1" ExecMainStatus) after $(of "$1" NRestarts) restarts"
    [ "$(said "$1" '/etc/motord/remote.toml')" -gt 0 ] || fail "$1 does not name its file: $(journalctl --unit="$1" --output=cat)"
    systemctl reset-failed "$1"
}

units_have() { [ "$(of "$2" ActiveState)" = "$1" ]; }
