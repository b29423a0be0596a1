#!/bin/bash
# First process of the guest: mounts, loads modules, runs the script, switches off.
export PATH=/usr/sbin:/usr/bin:/sbin:/bin HOME=/root
mount -t proc proc /proc; mount -t sysfs sys /sys; mount -t tmpfs work /mnt; mount -t tmpfs run /run
mountpoint -q /dev || mount -t devtmpfs dev /dev
ln -s /proc/self/fd /dev/fd
mount -t configfs config /sys/kernel/config 2>/dev/null
for word in $(cat /proc/cmdline); do case $word in *=*) export "G_${word%%=*}=${word#*=}" ;; esac; done
# shellcheck disable=SC2154
load() { insmod "$G_kernel/modules/$1.ko" "${@:2}"; }
cd /mnt || exit
( . "$G_script" ); echo "guest: end $?"
sync; echo o >/proc/sysrq-trigger; sleep 5
