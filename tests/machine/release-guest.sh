# In the guest: the remote release on a simulated GPIO line; frames from a folder, V4L2, USB.
# shellcheck shell=bash disable=SC2154
. "${G_script%/*}/guest-lib.sh"
load gpio-sim 2>/dev/null
sim=/sys/kernel/config/gpio-sim/wing
mkdir -p $sim/bank0 && echo 8 >$sim/bank0/num_lines && mkdir $sim/bank0/line3 && echo release >$sim/bank0/line3/name \
    && mkdir $sim/bank0/line4 && echo focus >$sim/bank0/line4/name && echo 1 >$sim/live \
    || { echo "failed: release: gpio-sim is missing"; exit 1; }
value=$(find /sys/devices/platform/gpio-sim.*/gpiochip*/sim_gpio3 -name value | head -n 1)
[ -e "$value" ] || { echo "failed: release: gpio-sim shows no line"; exit 1; }
# The half press keeps the presses apart: the simulated camera looks at the line now and then only.
press=('kind = "release"' 'full_press = { name = "release" }' 'half_press = { name = "focus" }' 'full_press_s = 1.0' '[camera.frames]')
# camera COMMAND…: a camera that takes a picture, number N, for every press that it sees.
camera() { local last=0 v n=0; while :; do v=$(<"$value"); [ "$v$last" = 10 ] && { n=$((n + 1)); "$@" $n; }; last=$v; sleep 0.02; done; }
fresh() { rm -rf /mnt/card /mnt/out; mkdir /mnt/card /mnt/out; }

# Files in a watched folder.
# picture N FILE
picture() { numbered "$1" "${frames[$1 % ${#frames[@]}]}" >"$2"; }
to_card() { picture "$1" /mnt/part; cp /mnt/part /mnt/card/part; mv /mnt/card/part "/mnt/card/IMG_$(printf %04d "$1").JPG"; }
config "${press[@]}" 'kind = "folder"' 'path = "/mnt/card"' 'delete = true'
fresh; camera to_card & sim_camera=$!
status=0
for k in 1 2 3 4 5; do
    DEADLINE=5 SHOTS=1 shoot || status=1
    picture $k /mnt/expected; cmp -s /mnt/out/shot-000 /mnt/expected || status=1
done
[ -z "$(ls /mnt/card)" ] || status=1
verdict $status "release: 5 presses of a GPIO line, 5 frames from the watched folder, unchanged, then deleted there"
kill $sim_camera; wait $sim_camera 2>/dev/null
DEADLINE=1 SHOTS=1 shoot; grep -q 'release was pressed and no frame came' /mnt/lines; verdict $? "release: a shot without a frame is named"

# A video device that delivers a burst for each press. The loopback device's first buffers are no frames: it
# mixes up its buffers when a reader comes.
load_loopback || echo "failed: release: v4l2loopback does not load"
start_feed MJPG "once 1000"
show() { echo "once $1" >/mnt/control; }
fresh; camera show & sim_camera=$!
config "${press[@]}" 'kind = "v4l"' 'card = "wing"' 'format = "MJPG"' "width = $width" "height = $height" 'settle_frames = 3'
DEADLINE=8 SHOTS=6 shoot; status=$?
# What was shown before the first press must not be among them.
mapfile -t got < <(find /mnt/out -name 'shot-*' | sort)
[ ${#got[@]} = 6 ] && all_as_sent "${got[@]}" && ! grep -qxF "$(head -n 1 /mnt/sent)" <<<"$(sha256sum "${got[@]}" | cut -d' ' -f1)" || status=1
[ $status = 0 ] || { cut -c1-8 /mnt/sent | tr '\n' ' '; sha256sum "${got[@]}" | cut -c1-8 | tr '\n' ' '; }
verdict $status "release: 6 shots of a GPIO line, 6 frames through V4L2, unchanged, no two alike"
kill $sim_camera; wait $sim_camera 2>/dev/null; stop_feed

# A still camera on USB: it takes the picture for the line's press, and announces it.
export IOLIBS=$G_iolibs VCAMERADIR=/mnt/usb/card VCAMERA_SHOTS=/mnt/usb/shots VCAMERA_STATE=/mnt/usb/state
mkdir -p /mnt/usb/{card/DCIM,shots,state}
for i in 0 1 2 3 4; do cp "${frames[i]}" "/mnt/usb/shots/0$i.jpg"; done; cp "${frames[0]}" /mnt/usb/card/dummy.jpg
release_usb() { echo press >/mnt/usb/state/fault; }
fresh; camera release_usb & sim_camera=$!
config "${press[@]}" 'kind = "gphoto"' 'open_s = 20.0'
DEADLINE=8 SHOTS=5 shoot; status=$?
for k in 0 1 2 3 4; do cmp -s /mnt/out/shot-00$k "${frames[k]}" || status=1; done
[ -z "$(find /mnt/usb/card/DCIM -name '*.JPG')" ] || status=1
verdict $status "release: 5 presses of a GPIO line, 5 frames over USB (PTP), unchanged, then deleted on the card"
kill $sim_camera; wait $sim_camera 2>/dev/null
DEADLINE=2 SHOTS=1 shoot; grep -q 'release was pressed and no frame came' /mnt/lines; verdict $? "release: a press that the camera on USB does not follow is named"

# The line is held by somebody else, in the midst of a recording.
fresh; camera to_card & sim_camera=$!
# Three shots take more than a second; between the series the line is free to be taken.
recorder_config 'interval = "2s"\nshots = 20\ngap = "50ms"\nshot_deadline = "3s"\nretries = 0' \
    'kind = "release"' 'full_press = { name = "release" }' 'full_press_s = 0.3' '[camera.frames]' 'kind = "folder"' 'path = "/mnt/card"' 'delete = true'
sed 's/^shots = .*/shots = 3/' -i /mnt/wingd.toml
mkdir /mnt/other /mnt/held
printf '%s\n' '[camera]' "${press[@]}" 'kind = "folder"' 'path = "/mnt/other"' >/mnt/holder.toml
holder=
hold_line() { kill -0 "$holder" 2>/dev/null || { "$wingd" check --camera 1 --config /mnt/holder.toml --deadline 60 --attempts 100 --output /mnt/held >/dev/null 2>&1 & holder=$!; }; }
let_go() { kill $holder; wait $holder 2>/dev/null; holder=; }
campaign release "a line that another program holds" hold_line let_go
grep -q 'line release is held by' /mnt/log; verdict $? "release: the holder of the line is named"
kill $sim_camera
true
