#!/bin/bash
# The whole recorder on the virtual PTP camera: a series of ten, stored unchanged and solved; the same with a
# camera that dies in the middle; then every fault again and again in one running recorder.
. "$(dirname "$0")/common.sh"
set +e
export NO_COLOR=1
WINGD=${WINGD:-$ROOT/target/release/wingd}
FRAMES=${FRAMES:-$ROOT/fixtures/dev/frames}
IOLIBS=$("$MACHINE/vcamera.sh") || { echo "failed: daemon: no virtual camera"; exit 1; }; export IOLIBS
work=$(mktemp -d); trap 'rm -rf "$work"' EXIT
verdict() { if [ "$1" = 0 ]; then echo "passed: daemon: $2"; else echo "failed: daemon: $2"; tail -n 5 "$work/log"; fi; }
cp -r "$FRAMES/../installation" "$work/installation"; chmod -R u+w "$work/installation"
mapfile -t flight < <(find "$FRAMES" -name 'flight*.jpg' | sort)
"$WINGD" orient --installation "$work/installation" "$FRAMES"/ground*.jpg >"$work/log" 2>&1; verdict $? "the ground frame orients the camera"

fresh() { # VIEWS
    rm -rf "$work/store"; fresh_camera "$work/cam" "$1" "${flight[@]}"
    cat >"$work/wingd.toml" <<END
installation = "installation"
[camera]
kind = "gphoto"
[camera.settings]
focusmode = "Manual"
iso = "100"
[series]
interval = "1m"
shots = 10
gap = "200ms"
shot_deadline = "5s"
until = "20s"
[store]
path = "store"
[status]
socket = "wingd.sock"
END
}
record() {
    "$WINGD" run --config "$work/wingd.toml" >"$work/log" 2>&1 & daemon=$!
    peak=0
    for _ in $(seq 2400); do
        kill -0 $daemon 2>/dev/null || break
        rss=$(sed -n 's/^VmHWM:[[:space:]]*\([0-9]*\).*/\1/p' /proc/$daemon/status 2>/dev/null); [ "${rss:-0}" -gt "$peak" ] && peak=$rss
        sleep 0.1
    done
    wait $daemon
}
stored() { find "$work/store/flights" -name '*.jpg' -exec sha256sum {} + | cut -d' ' -f1 | sort; }

fresh 16; record; verdict $? "a series of ten ends by itself"
[ "$(stored | wc -l)" = 10 ] && [ "$(stored)" = "$(sha256sum "$work"/cam/shots/0?.jpg | cut -d' ' -f1 | sort)" ]
verdict $? "10 frames stored, bytes as the camera sent them"
told=$(grep -ho '"exposure_source": "trigger_and_event"' "$work"/store/flights/*/*/series.json | wc -l)
[ "$told" = 10 ]; verdict $? "$told of 10 instants of exposure lie between the trigger and the camera's word"
"$WINGD" verify "$work/store" >"$work/verify" 2>&1; verdict $? "the store verifies"
solved=$(cat "$(find "$work/store" -name results.jsonl | head -n 1)" 2>/dev/null | grep -c '"status":"ok"')
[ "$solved" = 10 ]; verdict $? "$solved of 10 frames solved; peak memory of the recorder $((peak / 1024)) MB"
[ -z "$(find "$work/cam/card/DCIM" -name '*.JPG')" ]; verdict $? "the card is empty again"

fresh 16; (sleep 1; echo die >"$work/cam/state/fault") & record; verdict $? "a camera that dies mid-download does not end the recorder"
missing=0
{ stored; find "$work/cam/card/DCIM" -name '*.JPG' -exec sha256sum {} +; } >"$work/kept"
for view in $(sed -n 's/^view //p' "$work/cam/state/log" | sort -u); do
    grep -q "$(sha256sum "$work/cam/shots/$view.jpg" | cut -d' ' -f1)" "$work/kept" || missing=$((missing + 1))
done
grep -q 'fault die' "$work/cam/state/log" || missing=$((missing + 100))
verdict $missing "every picture that the camera took is in the store ($(stored | wc -l) frames) or whole on the card for the next series"

# Faults of the camera on USB. The views repeat after 40, far more than the recorder compares with.
wingd=$WINGD W=$work rounds=${FAULT_ROUNDS:-2}
. "$MACHINE/faults.sh"
fresh 40; export VCAMERA_VIEWS=40
sed -i -e '/^installation/d' -e 's/^interval.*/interval = "1s"/' -e 's/^shots = .*/shots = 20/' -e 's/^gap.*/gap = "50ms"/' \
    -e 's/^shot_deadline.*/shot_deadline = "2s"/' -e '/^until/d' "$work/wingd.toml"
printf 'reserve_mb = 0\n' | sed -i '/^path = "store"/r /dev/stdin' "$work/wingd.toml"
# strike FAULT: brings it on and waits until the recorder has felt it.
strike() { local before; before=$(failures); echo "$1" >"$work/cam/state/fault"; wait_more failures "$before" 10; }
deflection() { rm -f "$work/cam/state/fault"; }
for fault in hang die truncate stale gone full busy claimed; do
    eval "inject() { strike $fault; }"
    rm -rf "$work/cam/card/DCIM"; mkdir "$work/cam/card/DCIM"
    campaign "USB" "$fault" inject deflection
done
