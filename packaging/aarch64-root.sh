#!/bin/bash
# A Debian 12 with Rust for aarch64, that architecture's libraries and its emulator; prints its folder. Cached by month.
# With --cached it makes nothing and fails where there is none.
. "$(dirname "$0")/../tests/machine/common.sh"
# rustc-web: the Rust that Debian keeps new for its browsers, with a standard library for each architecture.
packages=rustc-web,cargo-web,libstd-rust-web-dev:arm64,gcc-aarch64-linux-gnu,libgphoto2-dev:arm64,libclang-dev,pkg-config
packages=$packages,adduser,qemu-user-static
. /etc/os-release
key=$( (date +%Y-%m; echo "$VERSION_CODENAME"; cat "$0") | sha256sum | cut -c1-12)
out="$CACHE/aarch64-$key"
ready() { [ ! -x "$out/root/usr/bin/cargo" ] || { echo "$out/root"; exit 0; }; }
ready
[ "${1:-}" != --cached ] || exit 1
need mmdebstrap mmdebstrap
[ "$(id -u)" = 0 ] || die "needs root for a chroot"
exec 9>"$CACHE/aarch64.lock"; flock 9 # one at a time
ready

say "aarch64: fetching Debian $VERSION_CODENAME with a cross compiler, 3 to 9 minutes, 2 GB, once"
rm -rf "$CACHE"/aarch64-* # last month's, or half of one
mkdir -p "$out"
sources=(/etc/apt/sources.list.d/*debian.sources)
[ -e "${sources[0]}" ] || sources=(/etc/apt/sources.list)
# Of the emulators, this one only.
nice mmdebstrap --variant=apt --architectures=amd64,arm64 "--include=$packages" --format=directory \
    --dpkgopt='path-exclude=/usr/share/doc/*' --dpkgopt='path-exclude=/usr/share/locale/*' \
    --dpkgopt='path-exclude=/usr/bin/qemu-*-static' --dpkgopt='path-include=/usr/bin/qemu-aarch64-static' \
    "$VERSION_CODENAME" "$out/making" "${sources[@]}" >"$CACHE/aarch64.log" 2>&1 || die "see $CACHE/aarch64.log"
mv "$out/making" "$out/root"
echo "$out/root"
