#!/bin/bash
# Power cuts: the recorder on a disk image in a User-Mode Linux machine that is killed at random moments; see README.md.
#   run.sh [--cuts N] [--fs ext4|vfat|exfat] [--options MOUNT,OPTIONS] [--without-fsync] [--seed N]
. "$(dirname "$0")/../machine/common.sh"
HERE=$(cd "$(dirname "$0")" && pwd)
WINGD=${WINGD:-$ROOT/target/release/wingd}
cuts=300 fs=ext4 options= fsync=yes seed=1
while [ $# -gt 0 ]; do
    case $1 in
        --cuts) cuts=$2; shift 2 ;;
        --fs) fs=$2; shift 2 ;;
        --options) options=$2; shift 2 ;;
        --seed) seed=$2; shift 2 ;;
        --without-fsync) fsync=; shift ;;
        *) die "unknown: $1; $(sed -n 3p "$0")" ;;
    esac
done
[ -x "$WINGD" ] || die "$WINGD is missing; run make build"
for pair in gcc:gcc mke2fs:e2fsprogs; do need "${pair%%:*}" "${pair##*:}"; done
CUTS_PER_STORE=50  # a new store then: every cycle verifies all of it
MEMORY=256M
work=$(mktemp -d "$CACHE/powercut.XXXXXX"); mkdir "$work/bin" "$work/frames"
guest=
end() { [ -z "$guest" ] || pkill -KILL -s "$guest" || true; [ -n "${KEEP:-}" ] || rm -rf "$work"; }
trap end EXIT

# The kernel that test-machine builds has all three file systems; Debian's own has no exFAT.
insmod=
if kernel=$("$MACHINE/kernel.sh" --cached 2>/dev/null); then linux=$kernel/linux
elif [ "$fs" = exfat ]; then die "Debian's user-mode-linux has no exFAT; tests/machine/kernel.sh builds a kernel that has it (10 to 25 minutes, once)"
else
    uml=$CACHE/user-mode-linux-$(candidate user-mode-linux)
    [ -e "$uml/usr/bin/linux.uml" ] || fetch_deb user-mode-linux "$uml"
    linux=$uml/usr/bin/linux.uml
    [ "$fs" != vfat ] || insmod=$(find "$uml" -name fat.ko -o -name vfat.ko -o -name nls_cp437.ko -o -name 'nls_iso8859-1.ko' | sort | tr '\n' ' ')
fi
# tools PACKAGE: its programs, without installing it.
tools() { [ -d "$CACHE/$1" ] || fetch_deb "$1" "$CACHE/$1"; cp "$CACHE/$1"/sbin/* "$CACHE/$1"/usr/sbin/* "$work/bin/" 2>/dev/null || true; }
case $fs in vfat) tools dosfstools ;; exfat) tools exfatprogs ;; esac
gcc -O1 -shared -fPIC "$MACHINE/uml-xstate.c" -o "$work/xstate.so" -ldl
gcc -O1 -shared -fPIC "$HERE/nosync.c" -o "$work/nosync.so"

# Pictures of a camera's format and some 150 kB each, no two alike.
picture=$ROOT/fixtures/jpeg/baseline-1x1.jpg
for n in $(seq -w 40); do
    { head -c 2 "$picture"
      for part in 1 2 3; do printf '\xff\xfe\xc3\x52'; head -c 50000 < <(yes "frame $n $part"); done
      tail -c +3 "$picture"; } >"$work/frames/$n.jpg"
done
# Without an orientation that fits the pictures each gets a result that says so: what counts here is that it gets one.
cp -r "$ROOT/fixtures/dev/installation" "$work/installation"
"$WINGD" orient --installation "$work/installation" "$ROOT/fixtures/dev/frames/ground.jpg" >/dev/null 2>&1
cat >"$work/wingd.toml" <<TOML
installation = "$work/installation"
[camera]
kind = "replay"
folder = "$work/frames"
[store]
path = "/mnt/disk/store"
reserve_mb = 0
[status]
socket = "/mnt/wingd.sock"
[series]
interval = "300ms"
shots = 3
gap = "10ms"
stale_window = 1
TOML

format() { # a new disk
    rm -f "$work/disk"; truncate -s 512M "$work/disk"
    case $fs in
        ext4) mke2fs -q -t ext4 "$work/disk" ;;
        vfat) "$work/bin/mkfs.fat" -F 32 "$work/disk" >/dev/null ;;
        exfat) "$work/bin/mkfs.exfat" "$work/disk" >/dev/null ;;
    esac
    : >"$work/said"
}
boot() { # LAST: starts the machine; its console goes to $work/console
    : >"$work/console"
    LD_PRELOAD=$work/xstate.so setsid "$linux" mem=$MEMORY root=/dev/root rootfstype=hostfs rootflags=/ rw init="$HERE/guest.sh" \
        "GLIBC_TUNABLES=$TUNABLES" "ubd0=$work/disk" "work=$work" "wingd=$WINGD" "fs=$fs" "last=$1" \
        ${options:+"options=$options"} ${insmod:+"insmod=$insmod"} ${preload:+"preload=$preload"} \
        con=null con0=fd:0,fd:1 quiet panic=1 </dev/null >"$work/console" 2>&1 & guest=$!
}
preload=; [ -n "$fsync" ] || preload=$work/nosync.so
await() { # PATTERN: until the console has it, or the machine is off; at most a minute
    local _; for _ in $(seq 1200); do
        grep -qa "$1" "$work/console" && return 0
        kill -0 "$guest" 2>/dev/null || return 1
        sleep 0.05
    done; return 1
}
cut() { { pkill -KILL -s "$guest"; wait "$guest"; } 2>/dev/null || true; guest=; }
# What the console said is durable: from here on it must be there.
note() {
    sed -n 's/.*frame is durable.*series="\(s[0-9]*\)" file="\([0-9a-z.]*\)" sha256="\([0-9a-f]*\)".*/\1\/\2 \3/p' "$work/console" |
        tr -d '\r' >>"$work/said"
    sed -n 's/.*store is open.*took_ms=\([0-9]*\).*/\1/p' "$work/console" | tr -d '\r' >>"$work/took"
}
lost=0 torn=0 twice=0 done_cuts=0 frames=0 mounted=0
: >"$work/took"
judge() { # WHEN: what the last boot found
    local missing verdict
    missing=$(sort -u "$work/said" | comm -23 - "$work/held" | wc -l)
    [ "$missing" = 0 ] || { lost=$((lost + missing)); say "$1: $missing acknowledged frames are lost"; comm -12 <(sort -u "$work/said") "$work/held" >"$work/rest"; mv "$work/rest" "$work/said"; }
    verdict=$(tr -d '\r' <"$work/console" | sed -n 's/^guest: verify //p' | tail -n 1)
    [ "${verdict:-0}" = 0 ] || { torn=$((torn + 1)); say "$1: verify says"; head -n 5 "$work/verify" >&2; }
    ! grep -qa '^guest: \(cannot mount\|fsck failed\)' "$work/console" || { mounted=$((mounted + 1)); say "$1: the file system is gone"; format; }
}

RANDOM=$seed
begin=$SECONDS
while [ "$done_cuts" -lt "$cuts" ]; do
    [ $((done_cuts % CUTS_PER_STORE)) != 0 ] || format
    boot no
    if [ $((RANDOM % 8)) = 0 ]; then
        # In checking, mounting and recovering, too.
        sleep "$((RANDOM % 2)).$(printf %03d $((RANDOM % 1000)))"
        if grep -qa '^guest: ready' "$work/console"; then judge "cut $((done_cuts + 1))"; fi
    else
        await '^guest: ready' || { say "the machine does not come up:"; tail -n 5 "$work/console" >&2; lost=$((lost + 1)); }
        judge "cut $((done_cuts + 1))"
        sleep "$((RANDOM % 3)).$(printf %03d $((RANDOM % 1000)))"
    fi
    cut; note
    done_cuts=$((done_cuts + 1))
    if [ $((done_cuts % CUTS_PER_STORE)) = 0 ] || [ "$done_cuts" = "$cuts" ]; then
        boot yes; await '^guest: sums' || say "the last boot did not end"
        wait "$guest" 2>/dev/null || true; guest=
        note; judge "after $done_cuts cuts"
        grep -qa '^guest: sums 0' "$work/console" || { torn=$((torn + 1)); say "sha256sum -c: $(cat "$work/sums")"; }
        twice=$((twice + $(uniq -d "$work/results" | wc -l)))
        frames=$((frames + $(wc -l <"$work/said")))
        say "$done_cuts cuts, $((SECONDS - begin)) s: $(wc -l <"$work/said") frames acknowledged since the last disk, $(wc -l <"$work/results") results"
    fi
done
took=$(sort -n "$work/took" | awk '{ all[NR] = $1 } END { printf "median %d ms, at most %d ms", all[int((NR + 1) / 2)], all[NR] }')
echo "$fs${options:+ ($options)}, fsync ${fsync:-no}: $done_cuts cuts, $frames acknowledged frames, lost $lost, torn or unsound $torn, solved twice $twice, file system gone $mounted; recovery $took; $((SECONDS - begin)) s"
if [ -z "$fsync" ]; then
    # The control: a test that loses nothing here notices nothing.
    [ "$lost" -gt 0 ] || die "without fsync nothing was lost: the test is blind"
else
    [ "$((lost + torn + twice + mounted))" = 0 ]
fi
