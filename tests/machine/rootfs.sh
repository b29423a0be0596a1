#!/bin/bash
# A small Debian with systemd, udev and what wingd links, as a tar file; prints its path. Cached by month.
. "$(dirname "$0")/common.sh"
need mmdebstrap mmdebstrap
packages=systemd,systemd-sysv,udev,adduser,dbus,libgphoto2-6,libgphoto2-port12,libexif12,procps
. /etc/os-release
key=$( (date +%Y-%m; echo "$packages $VERSION_CODENAME"; cat "$0") | sha256sum | cut -c1-12)
out="$CACHE/rootfs-$key.tar"
if [ ! -s "$out" ]; then
    say "rootfs: fetching Debian $VERSION_CODENAME, about a minute, once"
    sources=(/etc/apt/sources.list.d/*debian.sources)
    [ -e "${sources[0]}" ] || sources=(/etc/apt/sources.list)
    nice mmdebstrap --quiet --variant=minbase "--include=$packages" "$VERSION_CODENAME" "$out.part" "${sources[@]}" \
        --format=tar >"$CACHE/rootfs.log" 2>&1 || die "see $CACHE/rootfs.log"
    mv "$out.part" "$out"
fi
echo "$out"
