#!/bin/sh
# Builds the on-board Debian package from an existing build (make build-board): target/package/wingd_VERSION_ARCH.deb
#   packaging/build.sh [BINARY [ARCHITECTURE]]
set -eu
cd "$(dirname "$0")/.."
binary=${1:-target/board/wingd}
architecture=${2:-$(dpkg --print-architecture)}
version=$(sed -n 's/^version = "\(.*\)"/\1/p' Cargo.toml | head -n 1)
[ -x "$binary" ] || { echo "$binary is missing; run make build-board" >&2; exit 1; }

root=$(mktemp -d)
trap 'rm -rf "$root"' EXIT
put() { install -D -m "$1" "$2" "$root/$3"; }
put 755 "$binary" usr/bin/wingd
put 644 systemd/wingd.service lib/systemd/system/wingd.service
put 644 config/99-wingd.rules lib/udev/rules.d/99-wingd.rules
put 644 config/wingd.toml etc/wingd/wingd.toml
# The default's paths count from its own folder; the service may write to its state directory only.
sed -i -e 's#^path = "store"#path = "/var/lib/wingd/store"#' -e 's#^socket = .*#socket = "/run/wingd/wingd.sock"#' \
    -e 's#"live.sock"#"/run/wingd/live.sock"#' \
    -e 's#^folder = .*#folder = "/var/lib/wingd/frames"#' "$root/etc/wingd/wingd.toml"
grep -q '^path = "/var/lib/wingd/store"' "$root/etc/wingd/wingd.toml" || { echo "config/wingd.toml: no [store] path to set" >&2; exit 1; }
for page in README.md LICENSE* CHANGELOG.md docs/operations.md docs/operations/camera.md docs/operations/flights-to-the-desk.md docs/reference/*.md docs/licences.md docs/evaluation.md docs/faq.md docs/troubleshooting.md docs/store.md docs/store/column.py; do
    [ ! -f "$page" ] || put 644 "$page" "usr/share/doc/wingd/$(basename "$page")"
done
for schema in docs/schema/*.schema.json; do put 644 "$schema" "usr/share/doc/wingd/schema/$(basename "$schema")"; done
# Man pages and completions come from the program itself, or for another processor from this machine's build.
pages=$binary
"$pages" --version >/dev/null 2>&1 || pages=target/board/wingd
"$pages" --version >/dev/null 2>&1 || { echo "$binary does not run here and $pages is missing; run make build-board" >&2; exit 1; }
"$pages" man "$root/usr/share/man/man1"
gzip -9n "$root"/usr/share/man/man1/*.1
complete() { install -d "$root/$(dirname "$2")"; "$pages" completions "$1" >"$root/$2"; }
complete bash usr/share/bash-completion/completions/wingd
complete zsh usr/share/zsh/vendor-completions/_wingd
complete fish usr/share/fish/vendor_completions.d/wingd.fish
mv "$root/usr/share/doc/wingd/LICENSE" "$root/usr/share/doc/wingd/copyright" 2>/dev/null ||
    cat LICENSE* >"$root/usr/share/doc/wingd/copyright" 2>/dev/null || true

install -d -m 755 "$root/DEBIAN"
for script in postinst prerm postrm; do install -m 755 "packaging/debian/$script" "$root/DEBIAN/$script"; done
echo /etc/wingd/wingd.toml >"$root/DEBIAN/conffiles"
needs=$(sh packaging/needs.sh "$binary")
cat >"$root/DEBIAN/control" <<END
Package: wingd
Version: $version
Architecture: $architecture
Maintainer: wingd <root@localhost>
Section: science
Priority: optional
Installed-Size: $(du -ks "$root" | cut -f1)
Depends: $needs, adduser
Recommends: udev, systemd
Description: measures the shape of a wing in flight
 The recorder for one camera at a cabin window: deflection and torsion of the
 wing from markers on its upper surface, with uncertainties. Calibration,
 reports, exports and analyses are in wingd-desk.
END
(cd "$root" && find . -path ./DEBIAN -prune -o -type f -printf '%P\0' | sort -z | xargs -0 md5sum >DEBIAN/md5sums)
mkdir -p target/package
package="target/package/wingd_${version}_${architecture}.deb"
dpkg-deb --root-owner-group -Zxz --build "$root" "$package" >/dev/null
echo "$package"
