# Sourced by qemu-run and fresh-debian: Debian's kernel, and the emulated machine that it runs on.

modules=(virtio virtio_ring virtio_pci virtio_pci_modern_dev virtio_pci_legacy_dev fscache netfs 9p 9pnet 9pnet_virtio overlay
    can can-raw can-gw can-dev vcan vxcan sja1000 kvaser_pci slcan sch_netem veth evdev uinput hid uhid hid-mcp2221)
flavour=${RIG_KERNEL:-amd64}
kernel=$cache_root/$flavour
# Each change of this script makes a new one.
initrd=initrd-$(cksum <"$rigs/qemu.sh" | cut -d' ' -f1).gz

# Fetches Debian's kernel and packs the few modules needed before the guest sees this machine's files.
make_kernel() {
    local image version root tree name file
    rm -rf "$kernel"
    mkdir -p "$kernel"
    cd "$kernel"
    image=$(apt-cache depends "linux-image-$flavour" | awk '/Depends:/ {print $2; exit}')
    [ -n "$image" ] || { apt update; image=$(apt-cache depends "linux-image-$flavour" | awk '/Depends:/ {print $2; exit}'); }
    apt download "$image"
    dpkg-deb -x ./*.deb .
    rm ./*.deb
    version=$(ls lib/modules)
    root=$kernel/initrd
    tree=$root/lib/modules/$version
    mkdir -p "$root"/{bin,proc,host,root,memory} "$tree"
    cp "$(command -v busybox)" "$root/bin/"
    for name in sh mount umount modprobe chroot switch_root mkdir cp tar rm; do ln -s busybox "$root/bin/$name"; done
    for name in "${modules[@]}"; do
        file=$(find "lib/modules/$version" -name "${name//_/[_-]}.ko" -print -quit)
        [ -z "$file" ] || cp "$file" "$tree/"
    done
    depmod -b "$root" "$version" 2>/dev/null
    cat >"$root/init" <<INIT
#!/bin/sh
export PATH=/bin
mount -t proc proc /proc
for module in ${modules[*]}; do modprobe \$module 2>/dev/null; done
# A whole system: in memory but for /mnt, through which it exchanges files with this machine.
if [ -f /system.tar ]; then
    mount -t tmpfs -o mode=755,size=90% root /root
    tar -x -f /system.tar -C /root && rm /system.tar
    mount -t 9p -o trans=virtio,version=9p2000.L,msize=262144,cache=mmap host /root/mnt
    umount /proc
    exec switch_root /root /sbin/init
fi
mount -t 9p -o trans=virtio,version=9p2000.L,msize=262144,cache=loose host /host
mount -t tmpfs -o mode=755 root /root
mount -t tmpfs memory /memory
for entry in /host/*; do
    name=\${entry##*/}
    if [ -L \$entry ]; then cp -d \$entry /root/ && continue; fi
    [ -d \$entry ] || continue
    mkdir /root/\$name
    case \$name in
        proc | sys | dev) ;;
        usr | etc | bin | sbin | lib*)
            mkdir /memory/\$name /memory/\$name.work
            mount -t overlay -o lowerdir=\$entry,upperdir=/memory/\$name,workdir=/memory/\$name.work memory /root/\$name
            ;;
        *) mount -o bind \$entry /root/\$name ;;
    esac
done
exec chroot /root \$guest
INIT
    chmod +x "$root/init"
    (cd "$root" && find . | cpio -o -H newc 2>/dev/null | gzip -1) >"$initrd.new"
    mv "$initrd.new" "$initrd"
}

# provide_kernel: installs the emulator, and makes the kernel and its initrd where they are missing.
provide_kernel() {
    provide qemu-system-x86_64=qemu-system-x86 cpio=cpio depmod=kmod busybox=busybox-static tc=iproute2
    [ -f "$kernel/$initrd" ] || (make_kernel)
}

# boot FOLDER INITRD MEMORY SECONDS PARAMETER...: runs the machine until it ends, for at most SECONDS. The guest can mount FOLDER. The
# array `devices` holds further arguments of the emulator.
boot() {
    local machine='-accel tcg,thread=single -icount shift=0,sleep=off'
    [ "${RIG_PROCESSORS:-1}" = 1 ] || machine='-accel tcg,thread=multi'
    timeout -k 5 "$4" qemu-system-x86_64 $machine -cpu max -smp "${RIG_PROCESSORS:-1}" -m "$3" \
        -nographic -no-reboot -kernel "$kernel"/boot/vmlinuz-* -initrd "$2" \
        -append "console=ttyS0 tsc=reliable quiet loglevel=1 panic=-1 ${*:5}" \
        -virtfs "local,path=$1,mount_tag=host,security_model=passthrough,multidevs=remap" \
        "${devices[@]}" -net none </dev/null
}
