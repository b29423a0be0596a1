#!/bin/bash
# First process of the guest: checks and mounts the image, looks at what the last cut left, and records until
# it is killed, or until the timetable is over. The words of the kernel's command line say what and how.
export PATH=/usr/sbin:/usr/bin:/sbin:/bin HOME=/root NO_COLOR=1
mount -t proc proc /proc; mount -t tmpfs work /mnt; mount -t tmpfs run /run
mountpoint -q /dev || mount -t devtmpfs dev /dev
for word in $(cat /proc/cmdline); do case $word in *=*) export "G_${word%%=*}=${word#*=}" ;; esac; done
# shellcheck disable=SC2154
work=$G_work fs=$G_fs root=/mnt/disk/store
off() { sync; echo o >/proc/sysrq-trigger; sleep 5; exit; }
for module in $G_insmod; do insmod "$module" 2>/dev/null; done

mkdir /mnt/disk
case $fs in
    ext4) e2fsck -p /dev/ubda >"$work/fsck" 2>&1; [ $? -le 1 ] || echo "guest: fsck failed" ;;
    vfat) "$work/bin/fsck.fat" -a /dev/ubda >"$work/fsck" 2>&1 ;;
    exfat) "$work/bin/fsck.exfat" -y /dev/ubda >"$work/fsck" 2>&1 ;;
esac
mount -t "$fs" ${G_options:+-o "$G_options"} /dev/ubda /mnt/disk || { echo "guest: cannot mount"; off; }
if [ -e $root/store.toml ]; then
    "$G_wingd" verify $root >"$work/verify" 2>&1; echo "guest: verify $?"
fi
# Every frame with its hash, under the name that it has or is about to have.
find $root/flights $root/incoming -name '[0-9]*.jpg*' -exec sha256sum {} + 2>/dev/null |
    sed -n 's|^\([0-9a-f]*\)  .*/\(s[0-9]*/[0-9]*\.jpg\)[.part]*$|\2 \1|p' | sort -u >"$work/held"
echo "guest: ready"
cp "$work/wingd.toml" /mnt/wingd.toml
[ "$G_last" != yes ] || echo 'until = "2s"' >>/mnt/wingd.toml
${G_preload:+env LD_PRELOAD=$G_preload} "$G_wingd" run --config /mnt/wingd.toml 2>&1
echo "guest: ended $?"
if [ "$G_last" = yes ]; then
    "$G_wingd" verify $root >"$work/verify" 2>&1; echo "guest: verify $?"
    (cd $root/flights && for f in */; do (cd "$f" && sha256sum --quiet -c SHA256SUMS); done) >"$work/sums" 2>&1; echo "guest: sums $?"
    find $root/flights -name '[0-9]*.jpg' -exec sha256sum {} + | sed -n 's|^\([0-9a-f]*\)  .*/\(s[0-9]*/.*\)$|\2 \1|p' | sort >"$work/held"
    (cd $root/flights && grep -o '"frame":"[^"]*","frame_sha256":"[^"]*","inputs":"[^"]*"' */*/results.jsonl) | sort >"$work/results"
    umount /mnt/disk
fi
off
