#!/bin/bash
# The gphoto camera against the virtual PTP camera: a series without faults, then every fault again and
# again at random moments. Prints one line per fault, and `passed`/`failed` lines for the summary.
. "$(dirname "$0")/common.sh"
set +e
WINGD=${WINGD:?path of the wingd binary}
FRAMES=${FRAMES:?directory of JPEG frames}
# The camera alone; daemon.sh does more of it with the whole recorder.
ROUNDS=$(((${FAULT_ROUNDS:-2} + 3) / 4))
IOLIBS=$("$MACHINE/vcamera.sh"); export IOLIBS
work=$(mktemp -d); trap 'rm -rf "$work"' EXIT
RANDOM=${SEED:-1}
mapfile -t frames < <(find "$FRAMES" -name '*.jpg' | sort)
[ "${#frames[@]}" -ge 5 ] || die "at least 5 frames are needed in $FRAMES"

# fresh VIEWS: a fresh camera, and what talks to it.
fresh() {
    fresh_camera "$work/cam" "$1" "${frames[@]}"; mkdir "$work/cam/out"
    printf '%s\n' '[camera]' 'kind = "gphoto"' 'open_s = 10.0' '[camera.settings]' 'focusmode = "Manual"' \
        'f-number = "f/8"' 'iso = "100"' 'imagequality = "JPEG Fine"' >"$work/cam/wingd.toml"
}
# shoot SHOTS ATTEMPTS: the series; its exit status.
shoot() {
    "$WINGD" check --config "$work/cam/wingd.toml" --camera "$1" --attempts "$2" --deadline 2 \
        --output "$work/cam/out" >"$work/cam/lines" 2>"$work/cam/errors"
}
# Every stored file is a view, and every view that the camera shot whole is stored.
nothing_lost() {
    local stored view kept
    kept=$(for stored in "$work"/cam/out/*; do
        cmp -s "$stored" "$work/cam/shots/$(view_of "$stored").jpg" || echo "bad: $stored"
        view_of "$stored"; echo
    done)
    ! grep -q bad <<<"$kept" || { say "not as sent: $kept"; return 1; }
    for view in $(sed -n 's/^view //p' "$work/cam/state/log" | sort -u); do
        [ "$view" = "${1:-none}" ] || grep -qx "$view" <<<"$kept" || { say "view $view is lost"; return 1; }
    done
}
view_of() { dd if="$1" bs=1 skip=10 count=2 2>/dev/null; }
verdict() { if [ "$1" = 0 ]; then echo "passed: $2"; else echo "failed: $2"; sed 's/^/    /' "$work/cam/errors" | tail -5; fi; }

# 1. Ten frames, byte for byte, deleted on the card only afterwards, settings read back.
fresh 10
begin=$(date +%s.%N); shoot 10 1; status=$?; end=$(date +%s.%N)
for i in 0 1 2 3 4 5 6 7 8 9; do cmp -s "$work/cam/out/shot-00$i" "$work/cam/shots/0$i.jpg" || status=1; done
[ -z "$(find "$work/cam/card/DCIM" -name '*.JPG')" ] || status=1
grep -q '"focusmode":"Manual"' "$work/cam/lines" && grep -q '"warnings":\[\]' "$work/cam/lines" || status=1
verdict $status "gphoto: 10 frames of 12 MP unchanged in $(echo "$end - $begin" | bc) s"

# 2. Faults that strike once, at a random shot of a series of four.
once() {
    local name=$1 round bad=0 longest=0 begin took after
    for ((round = 0; round < ROUNDS; round++)); do
        fresh 12
        after=$(printf '0.%03d' $((RANDOM % 600)))
        (sleep "$after"; echo "$name" >"$work/cam/state/fault") &
        begin=$(date +%s%N)
        # Short series one after the other until the fault has struck and one more is through.
        shoot 4 4 || bad=$((bad + 1)); wait
        took=$((($(date +%s%N) - begin) / 1000000)); [ "$took" -gt "$longest" ] && longest=$took
        if [ -e "$work/cam/state/fault" ]; then
            mv "$work/cam/out" "$work/cam/first"; mkdir "$work/cam/out"
            begin=$(date +%s%N)
            shoot 3 4 || bad=$((bad + 1))
            took=$((($(date +%s%N) - begin) / 1000000)); [ "$took" -gt "$longest" ] && longest=$took
            for file in "$work"/cam/first/*; do mv "$file" "$work/cam/out/first-$(basename "$file")"; done
        fi
        grep -q "fault $name" "$work/cam/state/log" || { say "$name did not strike"; bad=$((bad + 1)); }
        case $name in
            truncate) whole_but_one || bad=$((bad + 1)) ;;
            *) nothing_lost || bad=$((bad + 1)) ;;
        esac
    done
    verdict $bad "gphoto: $name, $ROUNDS times at random moments: series completed, nothing lost, longest series $longest ms"
}
# The half picture is not stored and not deleted on the card.
whole_but_one() {
    local half view
    half=$(find "$work/cam/card/DCIM" -name '*.JPG') || return 1
    [ "$(echo "$half" | wc -l)" = 1 ] && [ -n "$half" ] || { say "the half picture is not on the card any more: $half"; return 1; }
    view=$(view_of "$half"); nothing_lost "$view"
}
for fault in hang die truncate stale; do once $fault; done

# 3. Faults that last a while.
lasting() {
    local name=$1 words=$2 round bad=0 hold
    for ((round = 0; round < ROUNDS; round++)); do
        fresh 12
        echo "$name" >"$work/cam/state/fault"
        hold=$(printf '0.%03d' $((RANDOM % 900 + 50)))
        (sleep "$hold"; rm -f "$work/cam/state/fault") &
        shoot 4 30 || bad=$((bad + 1)); wait
        nothing_lost || bad=$((bad + 1))
        rm -rf "$work/cam/out"; mkdir "$work/cam/out"
        echo "$name" >"$work/cam/state/fault"
        shoot 1 1 && { say "$name: a shot came through"; bad=$((bad + 1)); }
        grep -q "$words" "$work/cam/lines" || { say "$name is not named: $(cat "$work/cam/lines")"; bad=$((bad + 1)); }
    done
    verdict $bad "gphoto: $name for a while, $ROUNDS times: named, then the series completed, nothing lost"
}
lasting gone "check cable"
lasting full "card is full"
lasting busy "mirror lock-up"
lasting claimed "gvfs"

# 4. Autofocus that only a person can switch off is reported.
fresh 2; echo autofocus >"$work/cam/state/fault"; shoot 1 1; status=$?
grep -q 'setting focusmode is .*switch on the lens' "$work/cam/lines" || status=1
verdict $status "gphoto: autofocus that cannot be switched off is reported"

# 5. The recorder is killed after the shot, before the download: the next one takes the picture over.
fresh 3
mkdir -p "$work/cam/card/DCIM/100GPHOT"
cp "$work/cam/shots/02.jpg" "$work/cam/card/DCIM/100GPHOT/GPH_0001.JPG"
shoot 1 1; status=$?
cmp -s "$work/cam/out/recovered-000" "$work/cam/shots/02.jpg" || status=1
[ -z "$(find "$work/cam/card/DCIM" -name '*.JPG')" ] || status=1
verdict $status "gphoto: a picture left on the card by an interrupted series is recovered, then deleted there"
