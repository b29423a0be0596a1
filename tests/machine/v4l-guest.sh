# In the guest: the V4L2 camera and the remote release. Prints `passed:` and `failed:` lines.
# shellcheck shell=bash disable=SC2154
wingd=$G_wingd feed=$G_feed rounds=$G_rounds
mapfile -t frames < <(find "$G_frames" -name '*.jpg' | sort)
verdict() { if [ "$1" = 0 ]; then echo "passed: $2"; else echo "failed: $2"; tail -n 4 /mnt/feed.log /mnt/errors /mnt/lines 2>/dev/null | cut -c1-400; fi; }
config() { printf '%s\n' '[camera]' "$@" >/mnt/wingd.toml; }
shoot() { "$wingd" camera-test --config /mnt/wingd.toml --deadline "${DEADLINE:-8}" --output /mnt/out "$@" >/mnt/lines 2>/mnt/errors; }
now() { date +%s%N; }
ms() { echo $((($(now) - $1) / 1000000)); }
size() { sed -n 's/.*'"$1"' *= *\([0-9]*\).*/\1/p' "$G_installation" | head -n 1; }
width=$(size width) height=$(size height)

load v4l2loopback max_width=8192 max_height=8192 card_label=wing exclusive_caps=0 || { echo "failed: v4l2loopback does not load"; exit 1; }
start_feed() { rm -rf /mnt/sent; mkdir /mnt/sent; echo "${2:-0}" >/mnt/control; "$feed" /dev/video0 "$1" /mnt/control /mnt/sent "${frames[@]}" 2>/mnt/feed.log & feeder=$!; for _ in $(seq 200); do [ -n "$(ls /mnt/sent)" ] && break; sleep 0.1; done; sleep 0.3; }
stop_feed() { echo stop >/mnt/control; wait "$feeder"; }

# Ten pictures through the loopback, each once, unchanged. The shown picture moves on when a shot is in.
ten() {
    local format=$1 status=0 line k=0 begin
    rm -rf /mnt/out; mkdir /mnt/out
    start_feed "$format"
    config 'kind = "v4l"' 'card = "wing"' "format = \"$format\"" "width = $width" "height = $height" 'settle_frames = 3'
    begin=$(now)
    "$wingd" camera-test --config /mnt/wingd.toml --shots 10 --attempts 4 --deadline 8 --output /mnt/out 2>/mnt/errors | while read -r line; do
        case $line in *'"shot"'*) k=$((k + 1)); echo "$k" >/mnt/control ;; esac
        echo "$line"
    done >/mnt/lines || status=1
    took=$(ms "$begin")
    stop_feed
    [ "$(grep -c '"error":null' /mnt/lines)" = 10 ] || status=1
    for k in 00 01 02 03 04 05 06 07 08 09; do
        grep -lq . /mnt/sent/$k && cmp -s "/mnt/out/shot-0$k" /mnt/sent/$k || { echo "picture $k is not as sent"; status=1; }
    done
    verdict $status "v4l: 10 frames of $width x $height px as $format unchanged in $took ms"
}
ten GREY
ten MJPG

# Without a camera: named, at once.
config 'kind = "v4l"' 'serial = "no-such"' 'format = "GREY"' 'width = 64' 'height = 64'
begin=$(now); ! shoot --shots 1 && grep -q 'no camera with serial no-such.*connected: /dev/video0' /mnt/lines && [ "$(ms "$begin")" -lt 3000 ]
verdict $? "v4l: a missing camera is named, and what is there instead"

# A camera that stops in the middle: never longer than its deadline; afterwards it goes on.
bad=0 longest=0
for ((i = 0; i < rounds; i++)); do
    rm -rf /mnt/out; mkdir /mnt/out
    start_feed GREY $((i % 5)) 2>/dev/null
    config 'kind = "v4l"' 'card = "wing"' 'format = "GREY"' "width = $width" "height = $height" 'settle_frames = 2'
    kill -STOP "$feeder"
    (sleep "1.$((RANDOM % 10))"; kill -CONT "$feeder") & waker=$!
    begin=$(now)
    DEADLINE=1 shoot --shots 1 --attempts 20 || bad=$((bad + 1))
    took=$(ms "$begin"); [ "$took" -gt "$longest" ] && longest=$took
    wait $waker; stop_feed
    cmp -s /mnt/out/shot-000 "/mnt/sent/$(printf %02d $((i % 5)))" || bad=$((bad + 1))
done
[ "$longest" -lt 8000 ] || bad=$((bad + 1))
verdict $bad "v4l: a camera that stalls, $rounds times: series completed, longest $longest ms"
rmmod v4l2loopback

# vivid: controls, Bayer, dropped buffers, unplugging and coming back under another number.
for m in v4l2-tpg videobuf2-common videobuf2-memops videobuf2-v4l2 videobuf2-vmalloc videobuf2-dma-contig cfbcopyarea cfbfillrect cfbimgblt font; do load $m; done
load vivid n_devs=1 node_types=0x1 input_types=0xff num_inputs=1 || { echo "failed: vivid does not load"; exit 1; }
node=$(basename "$(dirname "$(grep -l vivid /sys/class/video4linux/video*/name | head -n 1)")")
[ -c "/dev/$node" ] || { echo "failed: vivid has no video node"; exit 1; }
card=$(cat "/sys/class/video4linux/$node/name")
vivid() { config 'kind = "v4l"' "card = \"$card\"" "format = \"$1\"" 'width = 4000' 'height = 3000' 'settle_frames = 2' '[camera.controls]' "${@:2}"; }
for format in GREY YUYV BA81 RG10 RG12; do
    vivid $format 'brightness = 77' 'gain = 33' 'autogain = 0'
    rm -rf /mnt/out; mkdir /mnt/out
    shoot --shots 1; status=$?
    grep -q '"brightness":77' /mnt/lines && grep -q '"warnings":\[\]' /mnt/lines || status=1
    bytes=$(stat -c %s /mnt/out/shot-000 2>/dev/null || echo 0)
    case $format in GREY | BA81) want=12000000 ;; *) want=24000000 ;; esac
    [ "$bytes" = $want ] || status=1
    verdict $status "v4l: vivid $format 4000 x 3000 px, $bytes bytes, controls set and read back"
done
vivid MJPG 'gain = 33'; rm -rf /mnt/out; mkdir /mnt/out
! shoot --shots 1 && grep -q 'instead of MJPG' /mnt/lines; verdict $? "v4l: another format than asked for is refused, with what there is"
vivid GREY 'focus_absolute = 3'; rm -rf /mnt/out; mkdir /mnt/out
shoot --shots 1 && grep -q 'control focus_absolute cannot be' /mnt/lines; verdict $? "v4l: a control that the camera lacks is reported"
vivid GREY '0x00f0f0a0 = 30' # vivid: percentage of dropped buffers
drops=0 bad=0
for ((i = 0; i < rounds; i++)); do
    rm -rf /mnt/out; mkdir /mnt/out
    shoot --shots 1 --attempts 3 || bad=$((bad + 1))
    drops=$((drops + $(sed -n 's/.*"dropped_frames":\([0-9]*\).*/\1/p' /mnt/lines | head -n 1)))
done
verdict $bad "v4l: $rounds shots with 30 % of the buffers dropped by the driver, $drops drops counted"

# Remote release: a simulated GPIO line, frames as files in a watched folder.
load gpio-sim 2>/dev/null
sim=/sys/kernel/config/gpio-sim/wing
mkdir -p $sim/bank0 && echo 8 >$sim/bank0/num_lines && mkdir $sim/bank0/line3 && echo release >$sim/bank0/line3/name && echo 1 >$sim/live \
    || { echo "failed: gpio-sim is missing"; exit 1; }
value=$(find /sys/devices/platform/gpio-sim.*/gpiochip*/sim_gpio3 -name value | head -n 1)
[ -e "$value" ] || { echo "failed: gpio-sim shows no line"; exit 1; }
config 'kind = "release"' 'full_press = { name = "release" }' 'full_press_s = 1.0' '[camera.frames]' 'kind = "folder"' 'path = "/mnt/card"' 'delete = true'
# A camera that takes a picture for every press that it sees.
camera() { local last=0 v; n=0; while :; do v=$(cat "$value"); [ "$v$last" = 10 ] && { n=$((n + 1)); cp "${frames[n % ${#frames[@]}]}" "/mnt/card/part"; mv /mnt/card/part "/mnt/card/IMG_$(printf %04d $n).JPG"; }; last=$v; sleep 0.02; done; }
rm -rf /mnt/card /mnt/out; mkdir /mnt/card /mnt/out
camera & sim_camera=$!
status=0
for k in 1 2 3 4 5; do
    DEADLINE=5 shoot --shots 1 || status=1
    cmp -s /mnt/out/shot-000 "${frames[k % ${#frames[@]}]}" || status=1
    sleep 1 # the simulated camera looks at the line now and then only
done
[ -z "$(ls /mnt/card)" ] || status=1
verdict $status "release: 5 presses of a GPIO line, 5 frames from the watched folder, unchanged, then deleted there"
kill $sim_camera; wait $sim_camera 2>/dev/null
DEADLINE=1 shoot --shots 1; grep -q 'release was pressed and no frame came' /mnt/lines; verdict $? "release: a shot without a frame is named"
bad=0
for ((i = 0; i < rounds; i++)); do
    "$wingd" camera-test --config /mnt/wingd.toml --deadline 10 --output /mnt/out >/dev/null 2>&1 & holder=$!
    named=1
    for _ in 1 2 3 4 5 6; do
        sleep 0.3
        DEADLINE=0.1 shoot --shots 1; grep -q 'camera is busy: line release is held by' /mnt/lines && { named=0; break; }
    done
    bad=$((bad + named))
    kill $holder 2>/dev/null; wait $holder 2>/dev/null
done
verdict $bad "release: a line that another program holds, $rounds times: named"
true
