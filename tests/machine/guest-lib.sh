# What the guest's scripts share.
# shellcheck shell=bash disable=SC2154
wingd=$G_wingd feed=$G_feed rounds=$G_rounds W=/mnt
mapfile -t frames < <(find "$G_frames" -name 'flight*.jpg' | sort)
say() { printf '%s\n' "$*"; }
verdict() { if [ "$1" = 0 ]; then echo "passed: $2"; else echo "failed: $2"; tail -n 5 /mnt/feed.log /mnt/errors /mnt/lines /mnt/log 2>/dev/null | cut -c1-300 | sed 's/^/    /'; fi; }
config() { printf '%s\n' '[camera]' "$@" >/mnt/wingd.toml; }
shoot() { "$wingd" check --camera "${SHOTS:-1}" --config /mnt/wingd.toml --deadline "${DEADLINE:-8}" --output /mnt/out "$@" >/mnt/lines 2>/mnt/errors; }
# recorder_config SERIES_LINES CAMERA_LINES…: a whole recorder's; the store on the guest's own memory.
recorder_config() {
    local series=$1; shift
    {
        [ -z "${INSTALLATION:-}" ] || echo "installation = \"$INSTALLATION\""
        printf '%s\n' '[camera]' "$@" '[series]'
        printf '%b\n' "$series"
        printf '%s\n' '[store]' 'path = "store"' 'reserve_mb = 0' '[status]' 'socket = "/mnt/wingd.sock"'
    } >/mnt/wingd.toml
}
size() { sed -n 's/.*'"$1"' *= *\([0-9]*\).*/\1/p' "$G_installation/camera.toml" | head -n 1; }
width=$(size width) height=$(size height)
. "${G_script%/*}/faults.sh"
. "${G_script%/*}/pictures.sh"

# A camera on the video loopback device: start_feed FORMAT WHAT; see feed.rs.
load_loopback() { load v4l2loopback max_width=8192 max_height=8192 card_label=wing exclusive_caps=0; }
start_feed() {
    rm -f /mnt/sent; echo "$2" >/mnt/control
    "$feed" /dev/video0 "$1" /mnt/control /mnt/sent "${frames[@]}" 2>/mnt/feed.log & feeder=$!
    for _ in $(seq 300); do [ -s /mnt/sent ] && break; sleep 0.1; done; sleep 0.3
}
stop_feed() { kill -CONT "$feeder"; echo stop >/mnt/control; wait "$feeder"; }
all_as_sent() { # FILES…: each is one of the pictures shown, and no two are the same
    local hashes; hashes=$(sha256sum "$@" | cut -d' ' -f1)
    [ "$(sort -u <<<"$hashes" | wc -l)" = $# ] && [ "$(grep -cxFf /mnt/sent <<<"$hashes")" = $# ]
}

# The driver's virtual camera, vivid: what it needs, once; load_vivid NUMBER, as that video device; which one it is; press
# CONTROL, a button (vivid's own numbers).
load_for_vivid() {
    local m
    for m in v4l2-tpg videobuf2-common videobuf2-memops videobuf2-v4l2 videobuf2-vmalloc videobuf2-dma-contig cfbcopyarea cfbfillrect cfbimgblt font; do load $m; done
}
load_vivid() { load vivid n_devs=1 node_types=0x1 input_types=0xff num_inputs=1 vid_cap_nr="$1"; }
node() { basename "$(dirname "$(grep -l vivid /sys/class/video4linux/video*/name | head -n 1)")"; }
press() { "$feed" set "/dev/$(node)" "$1" 1 2>>/mnt/feed.log; }
# A number of all series' manifests, added up.
counted() { cat /mnt/store/flights/*/*/series.json | tr ',{}' '\n\n\n' | sed -n 's/^ *"'"$1"'": *\([0-9]*\).*/\1/p' | awk '{sum += $1} END {print sum + 0}'; }
