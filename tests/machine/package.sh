#!/bin/bash
# The Debian package in a root of its own: install, upgrade, remove, purge; the store stays.
. "$(dirname "$0")/common.sh"
set +e
verdict() { if [ "$1" = 0 ]; then echo "passed: package: $2"; else echo "failed: package: $2"; [ ! -e "$log" ] || tail -n 5 "$log"; fi; }
log=$(mktemp)
[ "$(id -u)" = 0 ] || { echo "failed: package: needs root for a chroot"; exit 1; }
package=$(cd "$ROOT" && sh packaging/build.sh "$BOARD" 2>"$log"); status=$?; verdict $status "built"
[ $status = 0 ] || exit 1
tar=$("$MACHINE/rootfs.sh") || { echo "failed: package: no root file system"; exit 1; }
root=$(mktemp -d); trap 'rm -rf "$root" "$log"' EXIT
tar -C "$root" -xf "$tar"
cp "$ROOT/$package" "$root/wingd.deb"
inside() { chroot "$root" env PATH=/usr/sbin:/usr/bin:/sbin:/bin DEBIAN_FRONTEND=noninteractive "$@" >>"$log" 2>&1; }
inside dpkg -i /wingd.deb; status=$?; verdict $status "installs on Debian with its dependencies"
[ $status = 0 ] || exit 1
inside wingd --version; verdict $? "the binary runs there"
inside sh -c 'id -nG wingd | grep -w video && id -nG wingd | grep -w plugdev && [ "$(id -u wingd)" -lt 1000 ]'
verdict $? "user wingd, in video and plugdev"
inside systemctl is-enabled wingd.service; verdict $? "the service is enabled"
mkdir -p "$root/var/lib/wingd/flights"; echo kept >"$root/var/lib/wingd/flights/frame"
echo '# edited' >>"$root/etc/wingd/wingd.toml"
# The next version, with another default configuration.
work=$(mktemp -d); dpkg-deb -R "$root/wingd.deb" "$work"
sed -i 's/^Version: .*/&+next/' "$work/DEBIAN/control"
dpkg-deb --root-owner-group -b "$work" "$root/next.deb" >/dev/null; rm -rf "$work"
inside dpkg -i --force-confold /next.deb; verdict $? "upgrades"
grep -q '^# edited' "$root/etc/wingd/wingd.toml" && [ "$(cat "$root/var/lib/wingd/flights/frame")" = kept ]
verdict $? "the upgrade keeps configuration and store"
inside dpkg -r wingd && [ ! -e "$root/usr/bin/wingd" ] && [ -e "$root/var/lib/wingd/flights/frame" ]
verdict $? "removes, and the store stays"
inside dpkg -P wingd && [ -e "$root/var/lib/wingd/flights/frame" ] && [ ! -e "$root/etc/wingd/wingd.toml" ]
verdict $? "purges its configuration, and the store stays"
