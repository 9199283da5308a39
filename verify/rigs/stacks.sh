# Sourced by the rigs that run the scripts of docs/stacks.md. They define `fail`, and have `await` of common.sh.

page=$(dirname "$(realpath "${BASH_SOURCE[0]}")")/../../docs/stacks.md

# block HEADING: the first script below this heading of the page.
block() {
    awk -v heading="## $1" '$0 == heading { found = 1 } found && /^```$/ && inside { exit } inside { print }
        found && /^```(python|rust|c|cpp)$/ { inside = 1 }' "$page"
}

# steps HEADING: the blocks below this heading, as calls of these functions with the block as their input, up to the first that fails:
#   write FILE    a script; FILE is the last name in backticks before it
#   terminal      commands in a terminal of their own
#   commands      other commands
steps() {
    awk -v heading="## $1" '
        /^## / && !inside { found = $0 == heading; next }
        !found { next }
        inside { print; if (/^```$/) inside = 0; next }
        /^```/ {
            inside = 1
            call = $0 != "```sh" ? "write " file : terminal ? "terminal" : "commands"
            print call " <<'\''```'\'' || return"
            terminal = 0
            next
        }
        { if (match($0, /`[^`]*`[^`]*$/)) { file = substr($0, RSTART + 1); sub(/`.*/, "", file) } }
        /terminal of its own/ { terminal = 1 }' "$page"
}

# must_be_short: each script of the page has at most 30 lines.
must_be_short() {
    awk '/^```/ && inside { if (kind != "sh" && lines > 30) print kind ": " lines " lines"; inside = 0; next }
        /^```/ { inside = 1; kind = substr($0, 4); lines = 0; next } inside { lines++ }' "$page" >long.log
    [ ! -s long.log ] || fail "a script is too long: $(cat long.log)"
}

# watch PYTHON...: starts the watcher of the robot, by a Python that has the package motord.
watch() {
    "$@" "$(dirname "$page")/../verify/rigs/stacks-watch.py" >seen.log 2>watch.log &
    watcher=$!
    processes+=($watcher)
    await 60 "the watcher" grep -qs watching seen.log
}

# seen SIGNAL: ends a part of the watch, and prints its line.
seen() {
    local lines
    lines=$(wc -l <seen.log)
    kill "-$1" "$watcher"
    await 30 "the watcher's line" reported "$lines"
    tail -n 1 seen.log
}

reported() { tail -n "+$(($1 + 1))" seen.log | grep '^largest step' >/dev/null; }

driven() { [ "$(tail -n 1 seen.log)" = driven ]; }

# run NAME COMMAND...: runs a stack. The watcher reads the states from the stop of the stack before until the group is stopped again.
run() {
    local name=$1 status=0
    shift
    seen USR1 >between.log
    : >"$name.log"
    "$@" >"$name.log" 2>&1 || status=$?
    [ $status = 0 ] || { cat "$name.log"; fail "$name ended with status $status"; }
    await 30 "the end of $name" stopped
    seen USR2 >stack.log
    echo "$name: $(cat stack.log)"
    grep -q 'good$' stack.log || fail "$name: a step, or a robot that did not move"
    # A policy begins near its pose.
    [[ $name == *policy ]] || grep -q 'each joint moved' stack.log || fail "$name: a joint that did not move"
    grep -q 'good$' between.log || fail "between $name and the stack before it: $(cat between.log)"
}

# The robot has one group.
stopped() { motorctl --instance demo status --json | grep '"phase": *"disarmed"' >/dev/null; }
