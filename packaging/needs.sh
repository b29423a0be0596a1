#!/bin/sh
# Prints the dependencies of a package from the libraries of a binary and the newest C library symbol it needs; names of Debian 12, and of 13 and later.
set -eu
binary=$1
linked=$(objdump -p "$binary")
libc=$(echo "$linked" | sed -n 's/.* GLIBC_\([0-9.]*\)$/\1/p' | sort -V | tail -n 1)
needs="libc6 (>= ${libc:?$binary: no C library version}), libgcc-s1"
case $linked in *" libgphoto2."*) needs="$needs, libgphoto2-6 | libgphoto2-6t64, libgphoto2-port12 | libgphoto2-port12t64" ;; esac
echo "$needs"
