# Sourced by the rigs that run in a new Debian 12 with gcc, Rust and no other tool. Needs root.
#
# debootstrap makes the system once. Each run has a copy of it in memory, a new copy of the source tree at /motord, and an empty cargo home.
# Of a run before, only cargo's target directories are kept. The toolchain, the resolver and the certificates are those of this machine.

. "$(dirname "$(realpath "${BASH_SOURCE[0]}")")/common.sh"

place=$cache_root/bare-debian
system=$place/system
# The essential packages, a C compiler, and what cargo needs for a download.
base_packages=gcc,libc6-dev,ca-certificates

make_system() {
    rm -rf "$place"
    mkdir -p "$place"
    debootstrap --variant=minbase --include="$base_packages" bookworm "$system" >"$place/debootstrap.log" 2>&1 ||
        { tail -n 5 "$place/debootstrap.log" >&2; exit 125; }
    mkdir -p "$system"/{motord,opt/rust,root/.cargo}
    echo "$base_packages" >"$system/.complete"
}

# The files of the source tree that git does not ignore. Their times are kept, so that cargo builds only what changed.
copy_tree() {
    rm -rf "$place"/{tree,cargo}
    mkdir -p "$place"/{tree,cargo,memory,target,wheel-target}
    git -C "$tree" ls-files -z --cached --others --exclude-standard |
        (cd "$tree" && while IFS= read -r -d '' file; do [ ! -e "$file" ] || printf '%s\0' "$file"; done) |
        tar --create --directory "$tree" --null --files-from=- | tar --extract --directory "$place/tree"
    mkdir -p "$place/tree"/{target,client/python/target}
}

# in_system online|offline COMMAND: runs it in a copy of the system, in namespaces of its own. Without a network it has the loopback
# interface only. With one, /run/loopback has the id of a process whose network namespace has that interface only, for `nsenter`.
in_system() {
    local separate=(--mount --pid --ipc)
    [ "$1" = online ] || separate+=(--net)
    place=$place network=$1 toolchain=$(rustc --print sysroot) command=$2 unshare "${separate[@]}" --fork --kill-child bash -e <<'INSIDE'
offline=false
[ "$network" = online ] || { ip link set lo up; offline=true; }
mount -t tmpfs tmpfs "$place/memory"
mkdir "$place/memory"/{upper,work,root}
root=$place/memory/root
mount -t overlay overlay -o "lowerdir=$place/system,upperdir=$place/memory/upper,workdir=$place/memory/work" "$root"
mount --rbind /dev "$root/dev"
for folder in dev/shm tmp run; do mount -t tmpfs tmpfs "$root/$folder"; done
mount -t proc proc "$root/proc"
mount -t sysfs sysfs "$root/sys"
mount --bind -o ro "$toolchain" "$root/opt/rust"
mount --bind "$place/cargo" "$root/root/.cargo"
mount --bind "$place/tree" "$root/motord"
mount --bind "$place/target" "$root/motord/target"
mount --bind "$place/wheel-target" "$root/motord/client/python/target"
# Networks with certificates of their own.
cp /etc/resolv.conf "$root/etc/"
cp /etc/ssl/certs/ca-certificates.crt "$root/etc/ssl/certs/"
if [ "$network" = online ]; then
    unshare --net bash -c 'ip link set lo up multicast on && ip route add 224.0.0.0/4 dev lo && exec sleep infinity' &
    echo $! >"$root/run/loopback"
fi
# The bash stays the first process of the system, and reaps orphans: cargo in its place would not.
exec chroot "$root" env -i HOME=/root PATH=/opt/rust/bin:/usr/bin:/bin:/usr/sbin:/sbin LANG=C.UTF-8 TERM=xterm \
    DEBIAN_FRONTEND=noninteractive PIP_CERT=/etc/ssl/certs/ca-certificates.crt \
    CARGO_NET_OFFLINE=$offline CARGO_INCREMENTAL=0 CARGO_TERM_COLOR=never \
    bash -c "cd /motord && $command; exit \$?" </dev/null
INSIDE
}

# timed online|offline COMMAND: runs it in the system, and prints its time.
timed() {
    local begun=$SECONDS status=0
    echo "\$ $2"
    in_system "$@" || status=$?
    echo "$((SECONDS - begun)) s, status $status: $2"
    return $status
}

# provide_system: makes the system where it is missing, and copies the source tree.
provide_system() {
    provide debootstrap=debootstrap ip=iproute2
    [ "$(cat "$system/.complete" 2>/dev/null)" = "$base_packages" ] || make_system
    copy_tree
}
