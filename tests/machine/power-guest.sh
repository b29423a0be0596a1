# In the guest: a simulated GPIO line says that the supply fails, and that it is back.
# shellcheck shell=bash disable=SC2154
. "${G_script%/*}/guest-lib.sh"
load gpio-sim 2>/dev/null
sim=/sys/kernel/config/gpio-sim/supply
mkdir -p $sim/bank0 && echo 8 >$sim/bank0/num_lines && mkdir $sim/bank0/line5 && echo supply >$sim/bank0/line5/name && echo 1 >$sim/live \
    || { echo "failed: power: gpio-sim is missing"; exit 1; }
pull=$(find /sys/devices/platform/gpio-sim.*/gpiochip*/sim_gpio5 -name pull | head -n 1)
# The line is high while there is power.
echo pull-up >"$pull"
mkdir /mnt/frames; for k in 0 1 2 3 4 5; do numbered $k "${frames[k % ${#frames[@]}]}" >/mnt/frames/$k.jpg; done
# The second shot hangs.
recorder_config 'interval = "1s"\nshots = 3\ngap = "100ms"\nshot_deadline = "1h"' 'kind = "replay"' 'folder = "/mnt/frames"' \
    '[[camera.fault]]' 'shot = 2' 'kind = "hang"'
printf '%s\n' '[power]' 'hold_up = "4s"' 'line = { name = "supply", active_low = true }' >>/mnt/wingd.toml
NO_COLOR=1 "$wingd" run --config /mnt/wingd.toml >/mnt/log 2>&1 & recorder=$!
says() { local _; for _ in $(seq 200); do [ "$(grep -c "$1" /mnt/log)" -ge "${2:-1}" ] && return 0; sleep 0.1; done; return 1; }
since() { sed -n "/$1/s/^\([^ ]*\)Z.*/\1/p" /mnt/log | head -n 1; }
says 'frame is durable'; sleep 3; echo pull-down >"$pull"
says 'the power fails' && says 'abandoned because' && says 'series closed'; status=$?
took=$(awk -v a="$(date -d "$(since 'the power fails')" +%s.%N)" -v b="$(date -d "$(since 'series closed')" +%s.%N)" 'BEGIN { print b - a }')
"$wingd" verify /mnt/store >/mnt/lines 2>/mnt/errors || status=1
[ -z "$(ls /mnt/store/incoming)" ] || status=1
awk -v t="$took" 'BEGIN { exit !(t > 0 && t < 4) }' || status=1
verdict $status "power: a GPIO line says that the power fails: a shot that hangs is given up, all is durable $took s later (limit 4 s)"
sleep 2; begun=$(grep -c 'series begins' /mnt/log); echo pull-up >"$pull"
says 'the power is back' && says 'series begins' $((begun + 1)) && [ "$begun" = 1 ]; verdict $? "power: nothing begins without power; when it is back recording goes on"
kill -TERM $recorder; wait $recorder; verdict $? "power: stopped in good order"
