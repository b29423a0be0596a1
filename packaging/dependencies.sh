#!/bin/sh
# Installs the Debian packages named as arguments, unless they are installed.
set -eu

if ! command -v cargo >/dev/null 2>&1; then
    echo "cargo is missing: install Rust 1.90 or newer with rustfmt and clippy (rustup), then run make again" >&2
    exit 1
fi
if ! command -v dpkg-query >/dev/null 2>&1; then
    command -v pkg-config >/dev/null 2>&1 && pkg-config --exists libgphoto2 && exit 0
    echo "this is not a Debian system: install a C compiler, pkg-config, libclang and libgphoto2 with its headers," >&2
    echo "then run make again (on Debian: $*)" >&2
    exit 1
fi
missing=
for package in "$@"; do
    state=$(dpkg-query -W -f '${db:Status-Status}' "$package" 2>/dev/null || true)
    [ "$state" = installed ] || missing="$missing $package"
done
[ -n "$missing" ] || exit 0
echo "installing:$missing"
if [ "$(id -u)" -eq 0 ]; then
    sudo=
elif command -v sudo >/dev/null 2>&1; then
    sudo=sudo
else
    echo "these packages are missing and there is no sudo; as root: apt-get install$missing" >&2
    exit 1
fi
# shellcheck disable=SC2086
{
    $sudo apt-get update -q
    $sudo env DEBIAN_FRONTEND=noninteractive apt-get install -q -y --no-install-recommends $missing
}
