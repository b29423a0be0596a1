# In the guest: the V4L2 camera. Prints `passed:` and `failed:` lines.
# shellcheck shell=bash disable=SC2154
. "${G_script%/*}/guest-lib.sh"
load_loopback || { echo "failed: v4l: v4l2loopback does not load"; exit 1; }
cp -r "$G_installation" /mnt/installation; chmod -R u+w /mnt/installation
"$wingd" orient --installation /mnt/installation "$G_frames"/ground*.jpg >/mnt/lines 2>&1; verdict $? "v4l: the ground frame orients the camera"

# Ten pictures through the loopback and the whole recorder: stored unchanged, and solved.
flight() {
    local format=$1 status=0 stored solved begin
    start_feed "$format" 0
    INSTALLATION=/mnt/installation recorder_config 'interval = "10m"\nuntil = "1s"\nshots = 10\ngap = "200ms"\nshot_deadline = "10s"\nretries = 10' \
        'kind = "v4l"' 'card = "wing"' "format = \"$format\"" "width = $width" "height = $height" 'settle_frames = 3'
    rm -rf /mnt/store; begin=$(now_ms)
    "$wingd" run --config /mnt/wingd.toml >/mnt/log 2>&1 & recorder=$!
    # The next picture once the last one is stored: the loopback device overwrites what is being read.
    for _ in $(seq 2400); do durable >/mnt/control; grep -q 'series closed' /mnt/log && break; sleep 0.05; done
    kill -STOP "$feeder"
    wait $recorder || status=1
    stop_feed
    mapfile -t stored < <(find /mnt/store/flights -type f \( -iname '*.grey' -o -name '*.jpg' \) | sort)
    [ ${#stored[@]} = 10 ] && all_as_sent "${stored[@]}"
    verdict $? "v4l: 10 frames of $width x $height px as $format stored, bytes as sent"
    solved=$(cat "$(find /mnt/store -name results.jsonl | head -n 1)" | grep -c '"status":"ok"')
    [ "$solved" = 10 ] && [ $status = 0 ]; verdict $? "v4l: $solved of 10 $format frames solved, $(($(now_ms) - begin)) ms with one core"
}
flight GREY
flight MJPG

# Without a camera: named, at once.
config 'kind = "v4l"' 'card = "no-such"' 'format = "GREY"' 'width = 64' 'height = 64'
begin=$(now_ms); ! SHOTS=1 shoot && grep -q 'no camera with card "no-such".*connected: /dev/video0' /mnt/lines && [ $(($(now_ms) - begin)) -lt 3000 ]
verdict $? "v4l: a missing camera is named, and what is there instead"

# A camera that stalls or repeats itself, in the midst of a recording.
recorder_config 'interval = "2s"\nshots = 20\ngap = "50ms"\nshot_deadline = "1500ms"\nretries = 5' \
    'kind = "v4l"' 'card = "wing"' 'format = "MJPG"' "width = $width" "height = $height" 'settle_frames = 1'
start_feed MJPG auto
stall() { kill -STOP "$feeder"; }
go_on() { kill -CONT "$feeder"; echo auto >/mnt/control; }
repeat() { echo hold >/mnt/control; }
campaign v4l "a camera that stalls" stall go_on
campaign v4l "a camera that repeats its picture" repeat go_on
stop_feed
rmmod v4l2loopback

# vivid: controls, Bayer, dropped and damaged buffers, unplugging and coming back under another number.
load_for_vivid
load_vivid 0 || { echo "failed: v4l: vivid does not load"; exit 1; }
[ -c "/dev/$(node)" ] || { echo "failed: v4l: vivid has no video node"; exit 1; }
card=$(cat "/sys/class/video4linux/$(node)/name")
vivid() { config 'kind = "v4l"' "card = \"$card\"" "format = \"$1\"" 'width = 4000' 'height = 3000' 'settle_frames = 2' '[camera.controls]' "${@:2}"; }
for format in GREY YUYV BA81 RG10 RG12; do
    vivid $format 'brightness = 77' 'gain = 33' 'autogain = 0'
    rm -rf /mnt/out; mkdir /mnt/out
    SHOTS=1 shoot; status=$?
    grep -q '"brightness":77' /mnt/lines && grep -q '"warnings":\[\]' /mnt/lines || status=1
    bytes=$(stat -c %s /mnt/out/shot-000 2>/dev/null || echo 0)
    case $format in GREY | BA81) want=12000000 ;; *) want=24000000 ;; esac
    [ "$bytes" = $want ] || status=1
    verdict $status "v4l: vivid $format 4000 x 3000 px, $bytes bytes, controls set and read back"
done
vivid MJPG 'gain = 33'; rm -rf /mnt/out; mkdir /mnt/out
! SHOTS=1 shoot && grep -q 'instead of MJPG' /mnt/lines; verdict $? "v4l: another format than asked for is refused, with what there is"
vivid GREY 'focus_absolute = 3'; rm -rf /mnt/out; mkdir /mnt/out
SHOTS=1 shoot && grep -q 'control focus_absolute cannot be' /mnt/lines; verdict $? "v4l: a control that the camera lacks is reported"

# Faults of the driver; the numbers are vivid's own controls.
series='interval = "3s"\nshots = 40\ngap = "50ms"\nshot_deadline = "2s"\nretries = 10'
small=('kind = "v4l"' "card = \"$card\"" 'format = "GREY"' 'width = 640' 'height = 360' 'settle_frames = 1')
# Noise, so that no two frames are alike: the numbers in vivid's pictures begin anew with each stream.
noise=('[camera.controls]' '0x00f0f000 = 21')
recorder_config "$series" "${small[@]}" "${noise[@]}"
# A fault that is set while no stream runs is without effect: again, until it is felt.
hammer() { local before; before=$(failures); for _ in $(seq 40); do press "$1"; [ "$(failures)" -eq "$before" ] || return; sleep 0.02; done; }
disconnect() { hammer 0xf0f041; }
fatal() { hammer 0xf0f046; }
no_start() { hammer 0xf0f045; }
no_buffers() { hammer 0xf0f043; }
campaign v4l "unplugged" disconnect
campaign v4l "streaming broken off by the driver" fatal
campaign v4l "streaming cannot be started" no_start
campaign v4l "no buffers to be had" no_buffers
number=0
# Gone for a moment; the module can be taken away only while the recorder has let go of the device.
unplug() { disconnect; for _ in $(seq 200); do rmmod vivid 2>/dev/null && return; sleep 0.02; done; }
replug() { number=$(((number + 1) % 8)); load_vivid $number; }
campaign v4l "unplugged and back under another number" unplug replug

# Damaged and dropped buffers are passed over within the shot, and counted with it.
start_recorder; status=$?
for ((i = 0; i < rounds; i++)); do sleep "0.$(printf %03d $((RANDOM % 400 + 100)))"; press 0xf0f042; done
before=$(durable); wait_more durable "$before" 20 && stop_recorder && nothing_stored_lost || status=1
damaged=$(counted damaged_frames); [ "$damaged" -ge $((rounds / 4)) ] && [ "$(failures)" = 0 ] || status=1
verdict $status "v4l: a buffer flagged as damaged, $rounds times: $damaged of them hit a shot and were passed over, $(durable) shots completed, none failed"
recorder_config "$series" "${small[@]}" "${noise[@]}" '0x00f0f040 = 30'
start_recorder; status=$?
wait_more durable "$rounds" 60 && stop_recorder && nothing_stored_lost || status=1
dropped=$(counted dropped_frames); [ "$dropped" -gt 0 ] && [ "$(failures)" = 0 ] || status=1
verdict $status "v4l: 30 % of the buffers dropped by the driver: $(durable) shots completed, $dropped drops counted, none failed"
true
