#!/bin/sh
# Debian package for the workstation: wingd, and wingd for Python with all that it needs, its commands in /usr/bin. No service, no
# rules for cameras, no compiler needed.
#   packaging/desk.sh BINARY
set -eu
cd "$(dirname "$0")/.."
binary=$1
"$binary" help | grep -q '^  report ' || { echo "$binary has no commands of the workstation; run make package-desk" >&2; exit 1; }
version=$(sed -n 's/^version = "\(.*\)"/\1/p' Cargo.toml | head -n 1)
architecture=$(dpkg --print-architecture)
root=$(mktemp -d)
trap 'rm -rf "$root"' EXIT
install -D -m 755 "$binary" "$root/usr/bin/wingd"
"$binary" man "$root/usr/share/man/man1"
gzip -9n "$root"/usr/share/man/man1/*.1
install -d "$root/usr/share/bash-completion/completions" "$root/usr/share/wingd-desk" "$root/usr/share/doc/wingd-desk"
"$binary" completions bash >"$root/usr/share/bash-completion/completions/wingd"
# The environment is of Debian's Python: compiled modules are of one minor version.
python=/usr/bin/python3
minor=$("$python" -c 'import sys; print(f"{sys.version_info.major}.{sys.version_info.minor}")')
next=$("$python" -c 'import sys; print(f"{sys.version_info.major}.{sys.version_info.minor + 1}")')
place=usr/lib/wingd-desk/python
"$python" -m venv "$root/venv"
pip="$root/venv/bin/pip --quiet --disable-pip-version-check"
$pip wheel --no-deps --wheel-dir "$root/usr/share/wingd-desk" ./python
rm -rf python/build
$pip install --no-compile --constraint python/constraints.txt --target "$root/$place" './python[desk]'
rm -rf "$root/venv" "$root/$place/bin"
# The commands of the package's own list.
PYTHONPATH="$root/$place" "$python" -c 'from wingd.commands import COMMANDS
for name, module in COMMANDS.items(): print(name, module)' | while read -r name module; do
    cat >"$root/usr/bin/wingd-$name" <<END
#!/usr/bin/python3 -sP
import sys

sys.path.insert(0, "/$place")
from $module import main

sys.exit(main())
END
    chmod 755 "$root/usr/bin/wingd-$name"
done
find "$root/$place" -name __pycache__ -prune -exec rm -rf {} +
# Compiled once: users cannot write beside the modules, and each command would take 5 s longer. Some tests of libraries do not compile.
"$python" -m compileall -qq --invalidation-mode unchecked-hash -s "$root" -p / "$root/$place" || true
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
Depends: $(sh packaging/needs.sh "$binary"), python3 (>= $minor), python3 (<< $next)
Conflicts: wingd
Provides: wingd
Description: measures the shape of a wing in flight: programs for the workstation
 wingd, and wingd for Python with its commands wingd-mean, wingd-upload, wingd-fleet and others. For
 notebooks: python3 -m venv venv && venv/bin/pip install /usr/share/wingd-desk/*.whl
END
(cd "$root" && find . -path ./DEBIAN -prune -o -type f -printf '%P\0' | sort -z | xargs -0 md5sum >DEBIAN/md5sums)
mkdir -p target/package
package="target/package/wingd-desk_${version}_${architecture}.deb"
dpkg-deb --root-owner-group -Zzstd --build "$root" "$package" >/dev/null
echo "$package"
