# Sourced by the scripts that build packages.

# fail MESSAGE: ends the script.
fail() {
    echo "$(basename "$0"): $*" >&2
    exit 1
}

# needs COMMAND=PACKAGE...: ends the script where a command is missing, and prints the line that installs the Debian packages.
needs() {
    local pair missing=()
    for pair; do command -v "${pair%%=*}" >/dev/null || missing+=("${pair#*=}"); done
    [ ${#missing[@]} != 0 ] || return 0
    mapfile -t missing < <(printf '%s\n' "${missing[@]}" | sort -u)
    fail "commands are missing; install their packages: sudo apt install ${missing[*]}"
}

# commit_time: the time of the commit, which the files in the packages get, in seconds; that of CHANGELOG.md in a source without git.
commit_time() { git log -1 --format=%ct 2>/dev/null || stat --format=%Y CHANGELOG.md; }
