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

maintainer="The motord authors <motord@packages.invalid>"

# shared_libraries WORK PACKAGE FILE...: the packages of the libraries that the files need, with their versions.
shared_libraries() {
    local work=$1 package=$2 found
    shift 2
    mkdir -p "$work/debian"
    printf 'Source: motord\n\nPackage: %s\nArchitecture: any\n' "$package" >"$work/debian/control"
    found=$(cd "$work" && dpkg-shlibdeps -O "$@" 2>"$work/shlibdeps.log" | sed -n 's/^shlibs:Depends=//p') ||
        { cat "$work/shlibdeps.log" >&2; return 1; }
    [[ $found == *libc6* ]] || fail "$package does not depend on libc6: $found"
    echo "$found"
}

# rust_libraries MANIFEST: the Rust libraries in a program, each with its licence.
rust_libraries() {
    cargo tree --manifest-path "$1" --locked --edges normal,no-proc-macro --prefix none --format '{p} {l}' |
        sed -E 's| \(/[^)]*\)||; s| \(\*\)$||' | sort -u | grep -v '^motor'
}

# copyright_and_changelog FOLDER VERSION LIBRARIES: the two files that every package has. LIBRARIES is where its libraries are listed.
copyright_and_changelog() {
    mkdir -p "$1"
    sed "s|/usr/share/doc/motord/libraries|$3|" packaging/debian/copyright >"$1/copyright"
    gzip --best --no-name >"$1/changelog.gz" <<CHANGES
motord ($2) unstable; urgency=medium

  * CHANGELOG.md of motord has the changes.

 -- $maintainer  $(date --utc --rfc-email --date="@$SOURCE_DATE_EPOCH")
CHANGES
}

# pack ROOT DEB: the folder as a package, and prints its path. Owners, order and times are the same in each build.
pack() {
    (cd "$1" && find usr -type f -print0 | sort -z | xargs -0 md5sum >DEBIAN/md5sums)
    find "$1" -exec touch --no-dereference --date="@$SOURCE_DATE_EPOCH" {} +
    dpkg-deb --root-owner-group --uniform-compression -Zxz --build "$1" "$2" >/dev/null
    echo "$2"
}

# pack_program PROGRAM MANIFESTS CONFIGURATION VERSION: packs the folder $root with the programs of MANIFESTS in it, their units, configuration
# and manual pages. The files of packaging/NAME, NAME that of the program without `motord-`, and the function `control` of the caller give the
# rest.
pack_program() {
    local program=$1 manifests=$2 configuration=$3 version=$4 name=${1#motord-} documents=$root/usr/share/doc/$1 page manifest
    mkdir -p "$documents" "$root"/usr/share/{man/man1,lintian/overrides}
    for manifest in $manifests; do rust_libraries "$manifest"; done | sort -u >"$documents/libraries"
    copyright_and_changelog "$documents" "$version" "/usr/share/doc/$program/libraries"
    for page in "packaging/$name"/*.1; do
        gzip --best --no-name <"$page" >"$root/usr/share/man/man1/$(basename "$page").gz"
    done
    cp "packaging/$name/lintian-overrides" "$root/usr/share/lintian/overrides/$program"
    chmod -R u=rwX,go=rX "$root"
    chmod 755 "$root"/usr/bin/*
    install -m 755 "packaging/$name"/{postinst,prerm,postrm} "$root/DEBIAN/"
    echo "/etc/motord/$configuration" >"$root/DEBIAN/conffiles"
    used=$(shared_libraries "$work" "$program" "$root"/usr/bin/*)
    control >"$root/DEBIAN/control"
    pack "$root" "$target/debian/${program}_${version}_$architecture.deb"
}
