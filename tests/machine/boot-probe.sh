# Runs in the service's own unit: each attempt must fail, but for the state directory.
# shellcheck shell=bash
refused() { if "${@:2}" 2>/dev/null; then echo "failed: boot: sandbox: $1 succeeded"; else echo "passed: boot: sandbox: $1 refused"; fi; }
# shellcheck disable=SC2329
write() { echo x >"$1/probe-$$"; }
# shellcheck disable=SC2329
look() { head -c 1 "$1" >/dev/null; }
for place in /etc /usr /var/log /boot /home /root; do refused "writing to $place" write "$place"; done
refused "reading /home" look /home/secret
refused "reading the disk's device" look /dev/ubda
refused "reading the kernel's log" look /dev/kmsg
refused "a new namespace" unshare -m true
refused "mounting" mount -t tmpfs none /var/lib/wingd
refused "changing a kernel setting" sh -c 'echo 1 >/proc/sys/kernel/panic'
refused "a packet socket" perl -MSocket -e 'socket(my $s, 17, SOCK_RAW, 0) or exit 1'
if write /var/lib/wingd && rm /var/lib/wingd/probe-$$; then echo "passed: boot: sandbox: the state directory is writable"; else echo "failed: boot: sandbox: the state directory is not writable"; fi
exit 0
