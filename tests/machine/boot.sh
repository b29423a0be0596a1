#!/bin/bash
# The installed package under systemd: a Debian on an ext4 image, booted by the virtual machine's kernel.
. "$(dirname "$0")/common.sh"
set +e
WINGD=${WINGD:-$ROOT/target/release/wingd}
FRAMES=${FRAMES:-$ROOT/fixtures/dev/frames}
need mke2fs e2fsprogs; need gcc gcc
[ "$(id -u)" = 0 ] || { echo "failed: boot: needs root for a chroot"; exit 1; }
kernel=$("$MACHINE/kernel.sh") || { echo "failed: boot: no kernel for the virtual machine"; exit 1; }
tar=$("$MACHINE/rootfs.sh") || { echo "failed: boot: no root file system"; exit 1; }
package=$(cd "$ROOT" && sh packaging/build.sh "$BOARD") || { echo "failed: boot: no package"; exit 1; }
work=${BOOT_WORK:-$(mktemp -d)}; [ -n "${BOOT_WORK:-}" ] || trap 'rm -rf "$work"' EXIT
root=$work/root; mkdir "$root"
tar -C "$root" -xf "$tar" --exclude='./dev/*'
cp "$ROOT/$package" "$root/wingd.deb"
chroot "$root" env PATH=/usr/sbin:/usr/bin:/sbin:/bin DEBIAN_FRONTEND=noninteractive dpkg -i /wingd.deb >"$work/log" 2>&1 \
    || { echo "failed: boot: the package does not install"; tail -n 5 "$work/log"; exit 1; }
rm "$root/wingd.deb"

# The package's own configuration: the replay camera; what is added is the installation.
state=$root/var/lib/wingd; mkdir -p "$state/frames"
cp -r "$(dirname "$FRAMES")/installation" "$state/installation"; chmod -R u+w "$state/installation"
"$WINGD" orient --installation "$state/installation" "$FRAMES"/ground*.jpg >"$work/log" 2>&1 || { echo "failed: boot: no orientation"; exit 1; }
sed -i 's#^\# installation = .*#installation = "/var/lib/wingd/installation"#' "$root/etc/wingd/wingd.toml"
grep -q '^installation' "$root/etc/wingd/wingd.toml" || { echo "failed: boot: the package's configuration names no installation"; exit 1; }
mapfile -t flight < <(find "$FRAMES" -name 'flight*.jpg' | sort)
for ((i = 0; i < 30; i++)); do
    numbered "$i" "${flight[i % ${#flight[@]}]}" >"$state/frames/$(printf %02d "$i").jpg"
done
chroot "$root" chown -R wingd:wingd /var/lib/wingd

# The unit as installed but for the watchdog's patience, so that a test need not wait for two minutes.
watchdog_s=10
mkdir -p "$root/etc/systemd/system/wingd.service.d" "$root/etc/systemd/system/multi-user.target.wants"
printf '[Service]\nWatchdogSec=%s\n' $watchdog_s >"$root/etc/systemd/system/wingd.service.d/test.conf"
# The same unit around a program that tries what it must not do.
sed -e 's#^ExecStart=.*#ExecStart=/bin/bash /boot-probe.sh#' -e 's/^Type=notify/Type=oneshot/' -e '/^WatchdogSec/d' -e '/^RuntimeDirectory/d' \
    -e 's/^Restart=always/Restart=no/' "$root/lib/systemd/system/wingd.service" >"$root/etc/systemd/system/probe.service"
cp "$MACHINE/boot-guest.sh" "$MACHINE/boot-probe.sh" "$root/"
gcc -O1 -static "$MACHINE/boot-hold.c" -o "$root/usr/bin/hold" || { echo "failed: boot: hold does not build"; exit 1; }
cat >"$root/etc/systemd/system/machine.service" <<END
[Unit]
After=wingd.service systemd-user-sessions.service
[Service]
Type=oneshot
TimeoutStartSec=600
Environment=WATCHDOG_S=$watchdog_s
ExecStart=/bin/bash /boot-guest.sh
ExecStopPost=/bin/systemctl poweroff --force --force
END
ln -s ../machine.service "$root/etc/systemd/system/multi-user.target.wants/machine.service"
mkdir -p "$root/etc/systemd/system.conf.d"
printf '[Manager]\nDefaultEnvironment=GLIBC_TUNABLES=%s\n' "$TUNABLES" >"$root/etc/systemd/system.conf.d/host.conf"
ln -sf /dev/null "$root/etc/systemd/system/systemd-timesyncd.service"

size_mb=$(($(du -sm "$root" | cut -f1) + 2500)) # above the reserve that the store keeps free
mke2fs -q -t ext4 -d "$root" "$work/image" "${size_mb}M" >"$work/log" 2>&1 || { echo "failed: boot: no image"; exit 1; }
rm -rf "$root"
boot() {
    cp --sparse=always "$work/image" "$work/disk"
    UML_END='^boot: end' uml "$kernel" "ubd0=$work/disk" root=/dev/ubda rootfstype=ext4 rw init=/sbin/init "GLIBC_TUNABLES=$TUNABLES" \
        systemd.show_status=no console=tty0 >"$work/console"
}
ended() { grep -qa '^boot: end' "$work/console"; }
boot
# As in uml.sh.
ended || { say "boot: the virtual machine stood still; once more"; tail -n 5 "$work/console" >&2; boot; }
grep -a '^\(passed\|failed\|    \)' "$work/console"
ended || { echo "failed: boot: did not reach its end"; tail -n 20 "$work/console"; exit 1; }
