#!/bin/bash
# Runs a command in the Debian of aarch64-root.sh, in this project's folder; the crates of this machine's cargo are in
# /cargo, build results in /target, kept in the cache. Other changes by the command are discarded.
. "$(dirname "$0")/../tests/machine/common.sh"
if [ -z "${WINGD_AARCH64:-}" ]; then
    [ "$(id -u)" = 0 ] || die "needs root for a chroot"
    WINGD_AARCH64=$("$(dirname "$0")/aarch64-root.sh"); export WINGD_AARCH64
    exec unshare --mount "$0" "$@" # the mounts end with it
fi
base=$(dirname "$WINGD_AARCH64")
cargo=${CARGO_HOME:-$HOME/.cargo}
mkdir -p "$base/target" "$base/mount" "$cargo"
mount -t tmpfs aarch64 "$base/mount"
mkdir "$base"/mount/{upper,work,root}
mount -t overlay aarch64 -o "lowerdir=$WINGD_AARCH64,upperdir=$base/mount/upper,workdir=$base/mount/work" "$base/mount/root"
cd "$base/mount/root"
bind() { mkdir -p ".$2"; mount --bind "$1" ".$2"; ${3:+mount -o "remount,bind,$3" ".$2"}; }
bind "$ROOT" "$ROOT" ro
bind "$cargo" /cargo ro
bind "$base/target" /target
mount --rbind /dev dev
mount -t proc proc proc
exec chroot . env -i PATH=/usr/sbin:/usr/bin:/sbin:/bin HOME=/root LC_ALL=C.UTF-8 DEBIAN_FRONTEND=noninteractive \
    CARGO_HOME=/cargo CARGO_TARGET_DIR=/target sh -c 'cd "$0" && exec "$@"' "$ROOT" "$@"
