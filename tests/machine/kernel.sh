#!/bin/bash
# Builds a User-Mode Linux kernel with vivid, v4l2loopback and gpio-sim; prints its directory:
# `linux` and `modules/`. Cached by source version, configuration and recipe. With --cached it
# builds nothing and fails where there is none.
. "$(dirname "$0")/common.sh"
for pair in flex:flex bison:bison bc:bc gcc:gcc make:make xz:xz-utils; do need "${pair%%:*}" "${pair##*:}"; done
version=$(candidate linux-source-6.1)
case ${version:-(none)} in "(none)") apt-get -qq update; version=$(candidate linux-source-6.1) ;; esac
loopback=$(candidate v4l2loopback-dkms)
[ -n "$version" ] && [ "$version" != "(none)" ] || die "linux-source-6.1 is unknown to apt; run apt-get update"
recipe=1 # to be raised where the steps below give another kernel
key=$( (echo "$version $loopback $recipe"; cat "$MACHINE/um.cfg") | sha256sum | cut -c1-12)
out="$CACHE/kernel-$key"
if [ -x "$out/linux" ] && [ -e "$out/modules/v4l2loopback.ko" ]; then echo "$out"; exit 0; fi
[ "${1:-}" != --cached ] || exit 1
exec 9>"$CACHE/kernel.lock"; flock 9 # one at a time
if [ -x "$out/linux" ] && [ -e "$out/modules/v4l2loopback.ko" ]; then echo "$out"; exit 0; fi

say "kernel: building $version for User-Mode Linux, about 10 minutes, once"
work="$CACHE/kernel-build-$key"
mkdir -p "$work"
if [ ! -d "$work/tree" ]; then
    fetch_deb linux-source-6.1 "$work/deb"
    mkdir -p "$work/unpack"
    tar -C "$work/unpack" --strip-components=1 -xf "$work"/deb/usr/src/linux-source-6.1.tar.xz
    mv "$work/unpack" "$work/tree"; rm -rf "$work/deb"
fi
[ -d "$work/loopback" ] || fetch_deb v4l2loopback-dkms "$work/loopback"
build=(nice -n 19 make -C "$work/tree" ARCH=um "-j$JOBS")
(cd "$work/tree" && make ARCH=um defconfig && scripts/kconfig/merge_config.sh -m .config "$MACHINE/um.cfg" \
    && make ARCH=um olddefconfig) >"$work/configure.log" 2>&1 || die "see $work/configure.log"
grep -q CONFIG_VIDEO_VIVID=m "$work/tree/.config" || die "the configuration lost vivid; see $work/configure.log"
"${build[@]}" linux modules >"$work/build.log" 2>&1 || die "see $work/build.log"
module=("$work"/loopback/usr/src/v4l2loopback-*)
"${build[@]}" M="${module[0]}" modules >"$work/loopback.log" 2>&1 || die "see $work/loopback.log"
mkdir -p "$out/modules"
find "$work/tree" "${module[0]}" -name '*.ko' -exec cp {} "$out/modules/" \;
cp "$work/tree/linux" "$out/linux"
strip --strip-debug "$out/linux" "$out"/modules/*.ko
rm -rf "$work"
echo "$out"
