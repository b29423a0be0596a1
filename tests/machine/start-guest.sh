# In the guest: clean starts where the machine is not as it should be. Prints `passed:` and `failed:` lines.
# shellcheck shell=bash disable=SC2154
. "${G_script%/*}/guest-lib.sh"
export NO_COLOR=1
mkdir /mnt/pictures; for i in 0 1 2 3 4; do cp "${frames[i]}" "/mnt/pictures/0$i.jpg"; done
replay=('kind = "replay"' 'folder = "/mnt/pictures"')
every='interval = "2s"\nshots = 3\ngap = "50ms"\nshot_deadline = "2s"\nretries = 0'
status_of() { "$wingd" status --json --socket /mnt/wingd.sock 2>/dev/null; }
log_has() { grep -qE "$1" /mnt/log; }
# until_true SECONDS COMMAND…
until_true() { local end=$((SECONDS + $1)); shift; until "$@"; do [ $SECONDS -lt $end ] || return 1; sleep 0.1; done; }
start() { : >/mnt/log; "$wingd" run --config /mnt/wingd.toml >/mnt/log 2>&1 & recorder=$!; }
# refused STATUS WORDS: does not start, at once, and says why.
refused() {
    local begin; begin=$(now_ms)
    timeout 20 "$wingd" run --config /mnt/wingd.toml >/mnt/log 2>&1
    [ $? = "$1" ] && grep -qE "$2" /mnt/log && [ $(($(now_ms) - begin)) -lt 5000 ]
}

# No clock: 1970 until the third series, then the true time, by a jump.
date -s @30 >/dev/null; [ "$(date +%Y)" = 1970 ] || { echo "failed: start: the guest's clock cannot be set"; exit 1; }
rm -rf /mnt/store; recorder_config "$every" "${replay[@]}"
start; until_true 30 log_has 'series closed.*s000002'; status=$?
date -s '2026-03-01 07:00:00' >/dev/null
until_true 30 log_has 'series closed.*s000004' || status=1
stop_recorder && nothing_stored_lost || status=1
manifests=(/mnt/store/flights/*/*/series.json)
grep -q '"utc": *"1970' "${manifests[0]}" && grep -q '"utc": *"2026-03-01' "${manifests[-1]}" || status=1
[ "$(find /mnt/store/flights -mindepth 1 -maxdepth 1 -type d | wc -l)" = 1 ] || status=1
verdict $status "start: in 1970: recorded; the clock's jump to 2026 loses nothing and begins no new flight, ${#manifests[@]} series"

# No camera: up, says so, and takes the camera that comes.
recorder_config "$every" 'kind = "v4l"' 'card = "vivid-000-vid-cap"' 'format = "GREY"' 'width = 640' 'height = 360' 'settle_frames = 1' \
    '[camera.controls]' '0x00f0f000 = 21'
rm -rf /mnt/store; start; until_true 30 log_has 'kind="gone"'; status=$?
status_of >/mnt/lines || true; kill -0 $recorder || status=1
load_for_vivid 2>/dev/null
load_vivid 0 || status=1
wait_more durable 0 30 || status=1
stop_recorder && nothing_stored_lost || status=1
verdict $status "start: without a camera: recorded as gone, and frames without a restart once it is there"

# A disk that cannot be written.
mkdir /mnt/disk; mount -t tmpfs -o size=40m disk /mnt/disk
recorder_config "$every" "${replay[@]}"; sed -i 's#^path = "store"#path = "/mnt/disk/store"#' /mnt/wingd.toml
mount -o remount,ro /mnt/disk
refused 1 '/mnt/disk/store.*Read-only file system.*mount'; verdict $? "start: on a read-only disk: ends with status 1, names store and mend"
mount -o remount,rw /mnt/disk

# A full disk: up, the series refused, and taken once there is room.
sed -i 's/^reserve_mb = 0/reserve_mb = 20/' /mnt/wingd.toml
dd if=/dev/zero of=/mnt/disk/other bs=1M count=30 2>/dev/null
start; until_true 30 log_has 'series refused'; status=$?
[ "$(durable)" = 0 ] || status=1
rm /mnt/disk/other; wait_more durable 2 30 || status=1
stop_recorder; "$wingd" verify /mnt/disk/store >/mnt/verify 2>&1 || status=1
grep -q 'reserve of 20 MB' /mnt/verify || status=1
verdict $status "start: on a full disk: up, series refused with the reason in the store, taken once there is room"

# A store of another version, and a folder that is none.
rm -rf /mnt/disk/store; mkdir /mnt/disk/store; echo 'format = 7' >/mnt/disk/store/store.toml; cp /mnt/disk/store/store.toml /mnt/before
refused 1 'format 7' && cmp -s /mnt/before /mnt/disk/store/store.toml && [ "$(ls /mnt/disk/store)" = store.toml ]
verdict $? "start: on a store of another version: ends with status 1, and touches nothing"
true
