#!/bin/bash
# Boots a User-Mode Linux kernel on this machine's own files (hostfs) and runs a script in it.
#   uml.sh SCRIPT [NAME=VALUE …]; its output is the script's; fails where the script did not reach its end.
. "$(dirname "$0")/common.sh"
script=$1; shift
part=$(basename "$script" -guest.sh)
kernel=$("$MACHINE/kernel.sh") || { echo "failed: $part: no kernel for the virtual machine"; exit 1; }
export UML_LIMIT=${UML_LIMIT:-$((240 + 90 * ${FAULT_ROUNDS:-2}))}
out=$(mktemp); trap 'rm -f "$out"' EXIT
# The words reach the script by /proc/cmdline.
boot() {
    uml "$kernel" root=/dev/root rootfstype=hostfs rootflags=/ rw init="$MACHINE/guest.sh" "GLIBC_TUNABLES=$TUNABLES" \
        "kernel=$kernel" "script=$script" "$@" | tee "$out"
}
ended() { grep -q '^guest: end 0$' "$out"; }
boot "$@"
# A virtual machine that stands still is no verdict on what runs in it; twice in a row is one.
ended || grep -q '^guest: end' "$out" || { say "$part: the virtual machine stood still; once more"; boot "$@"; }
ended || { echo "failed: $part: the guest did not reach the end of $(basename "$script")"; exit 1; }
