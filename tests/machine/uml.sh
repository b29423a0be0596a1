#!/bin/bash
# Boots a User-Mode Linux kernel on this machine's own files (hostfs) and runs a script in it.
#   uml.sh SCRIPT [NAME=VALUE …]; its output is the script's; fails where the script did not reach its end.
. "$(dirname "$0")/common.sh"
script=$1; shift
part=$(basename "$script" -guest.sh)
kernel=$("$MACHINE/kernel.sh") || { echo "failed: $part: no kernel for the virtual machine"; exit 1; }
out=$(mktemp); trap 'rm -f "$out"' EXIT
# The words reach the script by /proc/cmdline.
uml "$kernel" root=/dev/root rootfstype=hostfs rootflags=/ rw init="$MACHINE/guest.sh" "GLIBC_TUNABLES=$TUNABLES" \
    "kernel=$kernel" "script=$script" "$@" | tee "$out"
grep -q '^guest: end 0$' "$out" || { echo "failed: $part: the guest did not reach the end of $(basename "$script")"; exit 1; }
