#!/bin/sh
# Debian package for the workstation: wingd with `upload`, and the wheel of wingd-fleet. No service, no rules for cameras, no compiler needed.
#   packaging/desk.sh BINARY
set -eu
cd "$(dirname "$0")/.."
binary=$1
"$binary" upload --help | grep -q -- --repair || { echo "$binary has no upload; run make package-desk" >&2; exit 1; }
version=$(sed -n 's/^version = "\(.*\)"/\1/p' Cargo.toml | head -n 1)
architecture=$(dpkg --print-architecture)
root=$(mktemp -d)
trap 'rm -rf "$root"' EXIT
install -D -m 755 "$binary" "$root/usr/bin/wingd"
"$binary" man "$root/usr/share/man/man1"
gzip -9n "$root"/usr/share/man/man1/*.1
install -d "$root/usr/share/bash-completion/completions" "$root/usr/share/wingd-desk" "$root/usr/share/doc/wingd-desk"
"$binary" completions bash >"$root/usr/share/bash-completion/completions/wingd"
python3 -m pip wheel --quiet --disable-pip-version-check --no-deps --wheel-dir "$root/usr/share/wingd-desk" ./fleet
rm -rf fleet/build
cp docs/fleet.md docs/fleet/*.md CHANGELOG.md "$root/usr/share/doc/wingd-desk/"
cat LICENSE* >"$root/usr/share/doc/wingd-desk/copyright"
install -d -m 755 "$root/DEBIAN"
cat >"$root/DEBIAN/control" <<END
Package: wingd-desk
Version: $version
Architecture: $architecture
Maintainer: wingd <root@localhost>
Section: science
Priority: optional
Installed-Size: $(du -ks "$root" | cut -f1)
Depends: $(sh packaging/needs.sh "$binary")
Recommends: python3-venv
Conflicts: wingd
Provides: wingd
Description: measures the shape of a wing in flight: programs for the workstation
 wingd with upload into object stores, and the Python package wingd-fleet as a wheel in
 /usr/share/wingd-desk: python3 -m venv venv && venv/bin/pip install /usr/share/wingd-desk/*.whl
END
(cd "$root" && find . -path ./DEBIAN -prune -o -type f -printf '%P\0' | sort -z | xargs -0 md5sum >DEBIAN/md5sums)
mkdir -p target/package
package="target/package/wingd-desk_${version}_${architecture}.deb"
dpkg-deb --root-owner-group -Zxz --build "$root" "$package" >/dev/null
echo "$package"
