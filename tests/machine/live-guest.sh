# In the guest: live mode with a V4L2 camera. Prints `passed:` and `failed:` lines.
# shellcheck shell=bash disable=SC2154
. "${G_script%/*}/guest-lib.sh"
load_loopback || { echo "failed: live: v4l2loopback does not load"; exit 1; }
cp -r "$G_installation" /mnt/installation; chmod -R u+w /mnt/installation
export INSTALLATION=/mnt/installation
export MALLOC_ARENA_MAX=2 MALLOC_TRIM_THRESHOLD_=131072 # as the service does
"$wingd" orient --installation /mnt/installation "$G_frames"/ground*.jpg >/mnt/lines 2>&1; verdict $? "live: the ground frame orients the camera"

# live_config RATE_HZ CAMERA_LINES…: every raw frame is kept, so that a result can be joined to the picture that was sent.
# INTERVAL: from series to series.
live_config() {
    local rate=$1; shift
    recorder_config "interval = '${INTERVAL:-6s}'\nshots = 2\ngap = '50ms'\nshot_deadline = '4s'\nretries = 10" "$@"
    printf '%s\n' '[live]' "rate_hz = $rate" 'socket = "/mnt/live.sock"' '[live.keep]' 'every = 1' 'ring_mb = 0' >>/mnt/wingd.toml
}
# A number of live mode's status; 0 where no recorder answers.
live() { "$wingd" status --config /mnt/wingd.toml --json 2>/dev/null | sed -n 's/.*"live":{\([^}]*\)}.*/\1/p' | tr ',' '\n' | sed -n "s/^\"$1\":\([0-9]*\).*/\1/p" | grep . || echo 0; }
results() { live results; }
failed_shots() { live failed_shots; }
rows() { "$wingd" export "$1" --format csv --table live 2>/dev/null; }
# Of the series by the timetable every shot has a frame.
shots_whole() { [ "$(durable)" -gt 2 ] && ! grep -q 'shot without a frame' /mnt/log; }

# rss FIELD: of the recorder, kB.
rss() { sed -n "s/^$1:[[:space:]]*\([0-9]*\) kB/\1/p" "/proc/$recorder/status"; }

# What tells the instants of the frames stored.
sources() { cat /mnt/store/flights/*/*/series.json | sed -n 's/.*"exposure_source": *"\([a-z_]*\)".*/\1/p' | sort -u | tr '\n' ' ' | sed 's/ $//'; }

# Between asking and delivery lie 5.2 s at most (the deadline and what a call may take longer): sigma below 1.6 s.
# cruise FORMAT: frames of the fixture, one after the other: each result is joined by its instant to the raw frame that was kept, that by
# its hash to the picture sent (what the loopback device overwrites while it is read is no picture that was sent), and its tip's deflection is held against that of `wingd solve` of the same picture.
cruise() {
    local format=$1 status=0 most=0 mapped=0 now listener
    live_config 2 'kind = "v4l"' 'card = "wing"' "format = \"$format\"" "width = $width" "height = $height" 'settle_frames = 1'
    start_feed "$format" slow
    start_recorder || status=1
    "$feed" lines /mnt/live.sock >/mnt/live.jsonl & listener=$!
    for _ in $(seq 20); do
        sleep 1; now=$(rss VmRSS); [ "${now:-0}" -le $most ] || { most=$now; mapped=$(rss RssFile); }
    done
    stop_recorder || status=1; wait "$listener"; stop_feed; nothing_stored_lost || status=1; [ $((most - mapped)) -le 200000 ] || status=1
    verdict $status "live: $format, 12 MP: recorder lives, store verifies, $((most - mapped)) kB of memory, and $mapped kB of the driver's buffers and the program's file"
    shots_whole; verdict $? "live: $format: series beside it have all their shots, $(durable)"
    rows /mnt/store >/mnt/live.csv
    awk -F, 'NR == 1 { for (i = 1; i <= NF; i++) c[$i] = i; next }
        { n++; ok += $c["solved"]; t = $c["since_boot_s"]; s = $c["exposure_sigma_s"]; l = $c["latency_ms"]; k = $c["skipped"]
          if (t <= last || s <= 0 || s > 1.6 || l < 0 || k < skipped) bad++
          if (s > high) high = s; last = t; skipped = k }
        END { printf "%d results, %d with numbers, %d skipped and counted, sigma of the instant at most %.4f s, %d out of order or out of bounds\n", n, ok, skipped, high, bad; exit !(n >= 5 && ok && !bad) }' /mnt/live.csv >/mnt/said
    verdict $? "live: $format: $(cat /mnt/said)"
    # Number and tip of each line, and of the row with this number.
    sed -n 's/^{"number":\([0-9]*\),.*"tip":{"marker":"[^"]*","deflection_m":\([0-9.e-]*\).*/\1 \2/p' /mnt/live.jsonl >/mnt/given
    awk -F'[ ,]' 'FILENAME ~ /given$/ { tip[$1] = $2; next } FNR == 1 { for (i = 1; i <= NF; i++) c[$i] = i; next }
        $c["solved"] == 1 { k = $c["number"]; if (!(k in tip)) { unheard++; next } n++; d = tip[k] - $c["tip_deflection_m"]; if (d * d > 1e-12) other++ }
        END { printf "%d lines at the socket as in the store, %d others, %d rows without a line", n, other, unheard; exit !(n >= 5 && !other && unheard <= 3) }' \
        /mnt/given /mnt/live.csv >/mnt/said
    verdict $? "live: $format: $(cat /mnt/said)"
    # Hash and instant of the frames that were kept.
    cat /mnt/store/flights/*/*/series.json | tr ',{}' '\n\n\n' | awk -F'"' '/"shot":/ { h = ""; t = "" }
        /"sha256":/ { h = $4 } /"exposure_since_boot_s":/ { split($0, p, ": *"); t = p[2] + 0 }
        h != "" && t != "" { printf "%s %.4f\n", h, t; h = t = "" }' >/mnt/kept
    [ -s /mnt/want ] || for f in "${frames[@]}"; do
        "$wingd" solve --installation /mnt/installation --json "$f" 2>/dev/null | sed -n 's/.*"tip":{"marker":"[^"]*","deflection_m":\([0-9.e-]*\),"sigma_deflection_m":\([0-9.e-]*\).*/\1 \2/p'
    done >/mnt/want
    awk -v files="${#frames[@]}" 'FILENAME ~ /want$/ { deflection[n + 0] = $1; sigma[n++] = $2; next }
        FILENAME ~ /sent$/ { number[$1] = ++sent; next }
        FILENAME ~ /kept$/ { if ($1 in number) file[$2] = number[$1] % files; else torn++; next }
        FNR == 1 { split($0, name, ","); for (i in name) c[name[i]] = i; next }
        { split($0, v, ","); t = sprintf("%.4f", v[c["since_boot_s"]]); if (!(t in file)) next
          if (!v[c["solved"]]) { without++; next }
          d = (v[c["tip_deflection_m"]] - deflection[file[t]]) / sigma[file[t]]; sum += d * d; m++; if (d < 0) d = -d; if (d > most) most = d }
        END { printf "%d results joined to the picture sent (%d frames were overwritten by the device), %d of whole pictures without numbers, tip against wingd solve at most %.2f standard deviations, rms %.2f\n", m, torn, without, most, m ? sqrt(sum / m) : -1; exit !(m >= 5 && !without && most <= 3 && n == files) }' \
        /mnt/want /mnt/sent /mnt/kept /mnt/live.csv >/mnt/said
    status=$?; sed -n 's/.*"status":"failed","reason":"\([^"]*\)".*/without numbers: \1/p' /mnt/live.jsonl >/mnt/errors
    verdict $status "live: $format: $(cat /mnt/said)"; rm -f /mnt/errors
    [ "$(sources)" = asked_and_delivered ]
    verdict $? "live: $format: a driver that does not say which clock it stamps by: $(sources) tells the instants"
}
cruise MJPG
cruise GREY

# strike NAME INJECT DEFLECTION: strikes once frames come, and they come again by themselves.
strike() {
    local name=$1 inject=$2 deflection=$3 status=0 before begin
    start_recorder && wait_more results 2 60 || status=1
    before=$(failed_shots)
    for _ in $(seq 40); do "$inject"; wait_more failed_shots "$before" 6 && break; done
    [ "$(failed_shots)" -gt "$before" ] || { status=1; say "$name did not strike"; }
    "$deflection"; begin=$(now_ms)
    wait_more results "$(results)" 60 || status=1
    begin=$(($(now_ms) - begin))
    wait_more durable "$(durable)" 30 || status=1
    local counted; counted=$(($(failed_shots) - before))
    stop_recorder && nothing_stored_lost || status=1
    verdict $status "live: $name: $counted live frames failed and were counted, the next result after $begin ms, series go on, store verifies"
}
start_feed MJPG auto
# A series of a camera that stalls takes 10 s: with less between them no time would be left for live frames.
INTERVAL=20s live_config 2 'kind = "v4l"' 'card = "wing"' 'format = "MJPG"' "width = $width" "height = $height" 'settle_frames = 1'
stall() { kill -STOP "$feeder"; }
go_on() { kill -CONT "$feeder"; }
strike "a camera that stalls" stall go_on

# Killed as by a power cut: results of the last 5 s at most are lost. What status counted, and when, is held against the rows.
count_rows() { rows /mnt/store | awk -F, -v until="$1" 'NR == 1 { for (i = 1; i <= NF; i++) c[$i] = i; next } $c["since_boot_s"] < until { n++ } END { print n + 0 }'; }
: >/mnt/counted
start_recorder; status=$?
wait_more results 5 60 || status=1
for _ in $(seq 25); do echo "$(cut -d' ' -f1 /proc/uptime) $(results)" >>/mnt/counted; sleep 0.2; done
killed=$(cut -d' ' -f1 /proc/uptime); kill -KILL "$recorder"; wait "$recorder" 2>/dev/null
"$wingd" verify /mnt/store >/mnt/lines 2>&1 || status=1
"$wingd" run --config /mnt/wingd.toml >/mnt/log 2>&1 & recorder=$!
wait_more results 0 60; stop_recorder && nothing_stored_lost || status=1
awk -v stored="$(count_rows "$killed")" -v killed="$killed" '{ known = $2; if ($2 > stored && !since) since = $1 }
    END { age = since ? killed - since : 0; printf "%d results counted, %d in the store, those of the last %.1f s lost", known, stored, age; exit !(known >= 5 && stored > 0 && age <= 5) }' /mnt/counted >/mnt/said || status=1
verdict $status "live: killed: verified; $(cat /mnt/said)"
stop_feed
rmmod v4l2loopback

load_for_vivid
load_vivid 0 || { echo "failed: live: vivid does not load"; exit 1; }
card=$(cat "/sys/class/video4linux/$(node)/name")
small=('kind = "v4l"' "card = \"$card\"" 'format = "GREY"' 'width = 640' 'height = 360' 'settle_frames = 1' '[camera.controls]' '0x00f0f000 = 21')
live_config 5 "${small[@]}"
disconnect() { press 0xf0f041; }
fatal() { press 0xf0f046; }
unplug() { disconnect; for _ in $(seq 200); do rmmod vivid 2>/dev/null && return; sleep 0.02; done; }
replug() { load_vivid 3; }
strike "unplugged" disconnect true
strike "streaming broken off by the driver" fatal true
strike "unplugged and back under another number" unplug replug

# Damaged and dropped buffers are passed over.
start_recorder; status=$?
for ((i = 0; i < 20; i++)); do sleep 0.2; press 0xf0f042; done
wait_more results "$(results)" 30 || status=1
lost=$(failed_shots); stop_recorder && nothing_stored_lost && [ "$lost" = 0 ] || status=1
damaged=$(counted damaged_frames)
[ "$damaged" -gt 0 ] || status=1
verdict $status "live: 20 buffers flagged as damaged: $damaged passed over and counted, $lost live frames failed"
[ "$(sources)" = end_of_frame ]; verdict $? "live: vivid's stamp tells the instants: $(sources)"
live_config 5 "${small[@]}" '0x00f0f040 = 30'
start_recorder; status=$?
wait_more results 20 60 || status=1
lost=$(failed_shots); stop_recorder && nothing_stored_lost && [ "$lost" = 0 ] || status=1
verdict $status "live: 30 % of the buffers dropped by the driver: live goes on, $lost live frames failed"
true
