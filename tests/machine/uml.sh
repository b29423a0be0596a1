#!/bin/bash
# Boots a User-Mode Linux kernel on this machine's own files (hostfs) and runs a script in it.
#   uml.sh SCRIPT [NAME=VALUE …]; its output is the script's; fails where the script did not reach its end.
. "$(dirname "$0")/common.sh"
kernel=$("$MACHINE/kernel.sh") || exit 1
shim="$CACHE/uml-xstate-$(sha256sum "$MACHINE/uml-xstate.c" | cut -c1-12).so"
[ -e "$shim" ] || gcc -O1 -shared -fPIC "$MACHINE/uml-xstate.c" -o "$shim" -ldl
script=$1; shift
out=$(mktemp); trap 'rm -f "$out"' EXIT
# mem is also the size of the guest's memory; the rest of the words reach the script by /proc/cmdline.
LD_PRELOAD=$shim timeout -k 5 "${UML_LIMIT:-900}" "$kernel/linux" "mem=${UML_MEMORY:-900M}" root=/dev/root rootfstype=hostfs \
    rootflags=/ rw init="$MACHINE/guest.sh" "kernel=$kernel" "script=$script" "$@" \
    con=null con0=fd:0,fd:1 quiet panic=1 </dev/null 2>&1 | tr -d '\r' >"$out" || true
cat "$out"
grep -q '^guest: end 0$' "$out" || { echo "failed: the guest did not reach the end of $(basename "$script")"; exit 1; }
