# In the booted Debian: the service as a technician's machine has it. Prints `passed:` and `failed:` lines.
# shellcheck shell=bash
exec >/dev/console 2>&1
verdict() { if [ "$1" = 0 ]; then echo "passed: boot: $2"; else echo "failed: boot: $2"; journalctl -u wingd -n 6 -o cat --no-pager | sed 's/^/    /'; fi; }
property() { systemctl show -p "$1" --value "${2:-wingd}"; }
answer() { wingd status --json --socket /run/wingd/wingd.sock 2>/dev/null; }
field() { answer | tr ',{}' '\n\n\n' | sed -n "s/^ *\"$1\": *\([0-9]*\).*/\1/p" | head -n 1; }
# until_true SECONDS COMMAND…: whether it comes true in time; how long it took is in $waited_ms.
until_true() {
    local limit=$1 begin; shift
    begin=$(date +%s%N)
    until "$@"; do
        waited_ms=$((($(date +%s%N) - begin) / 1000000))
        [ "$waited_ms" -lt $((limit * 1000)) ] || return 1
        sleep 0.1
    done
    waited_ms=$((($(date +%s%N) - begin) / 1000000))
}
frames_at_least() { [ "$(field frames)" -ge "$1" ] 2>/dev/null; }
restarts_at_least() { [ "$(property NRestarts)" -ge "$1" ] && [ "$(property ActiveState)" = active ]; }
solved_all() { [ "$(field to_solve)" = 0 ] && [ "$(field solved)" -ge "${1:-1}" ]; } 2>/dev/null
rss_kb() { sed -n 's/^VmRSS:[^0-9]*\([0-9]*\).*/\1/p' "/proc/$(property MainPID)/status"; }
ticks() { local s; s=$(<"/proc/$(property MainPID)/stat"); set -- ${s##*) }; echo $((${12} + ${13})); }

# 1. Ready, in its own time, and the first frame.
until_true 60 frames_at_least 1; status=$?
ready_ms=$(($(property ActiveEnterTimestampMonotonic) / 1000))
first=$(journalctl -u wingd -o short-monotonic --no-pager | sed -n 's/^\[ *\([0-9.]*\)\].*frame is durable.*/\1/p' | head -n 1)
[ -n "$first" ] || status=1
verdict $status "ready (Type=notify) $ready_ms ms after boot, first frame durable after ${first:-no} s"
promises() { journalctl -u wingd -o cat --output-fields=F_SHA256 --no-pager | grep -x '[0-9a-f]\{64\}'; }
[ -n "$(promises)" ]; verdict $? "the journal has fields"

# 2. The sandbox: what the running service has, and what a program in the same unit can do.
pid=$(property MainPID)
state=$(cat "/proc/$pid/status")
grep -q '^Seccomp:.*2' <<<"$state" && grep -q '^NoNewPrivs:.*1' <<<"$state" && grep -q '^CapEff:.*0000000000000000' <<<"$state" \
    && grep -q '^CapBnd:.*0000000000000000' <<<"$state" && [ "$(stat -c %U "/proc/$pid")" = wingd ]
verdict $? "own user, no capability, no new privileges, system calls filtered"
for place in /etc /usr /home /root /var/tmp /var/log /boot; do mkdir -p "$place"; chmod 777 "$place"; done
echo secret >/home/secret; chmod 666 /home/secret /dev/ubda /dev/kmsg
systemctl start probe.service; journalctl -u probe -o cat --no-pager | grep '^\(passed\|failed\):'
[ "$(property Result probe)" = success ]; verdict $? "the probe of the sandbox ran to its end"
[ -z "$(find /etc /usr /home /root /var/tmp /var/log /boot -name 'probe-*' -not -path '*systemd-private*' 2>/dev/null)" ]
verdict $? "nothing was written outside the state directory"

# 3. Idle cost, once the first series is taken and solved.
until_true 120 frames_at_least 10 && until_true 180 solved_all 10; verdict $? "10 frames taken and solved after ${waited_ms} ms more"
sleep 5
before=$(ticks); sleep 30; after=$(ticks)
rss=$(rss_kb); grep -E '^Rss' "/proc/$(property MainPID)/status" | sed 's/^/    /'; peak=$(sed -n 's/^VmHWM:[^0-9]*\([0-9]*\).*/\1/p' "/proc/$(property MainPID)/status")
[ "$rss" -le 30720 ]; verdict $? "idle: $rss kB resident (at most 30720)"
[ $((after - before)) -le 15 ]; verdict $? "idle: $((after - before)) ticks of 10 ms in 30 s (at most 15, 0.5 % of a core)"
[ "$peak" -le 204800 ]; verdict $? "peak: $peak kB while taking and solving 12 MP (at most 204800)"

# 4. Progress stops: the watchdog kills, systemd starts again, nothing stored is lost.
seen=0
stopped() { # WHAT COMMAND…
    local what=$1 old new; shift
    old=$(property MainPID)
    "$@"
    until_true $((WATCHDOG_S * 4 + 20)) restarts_at_least $((seen + 1)); local status=$? took=$waited_ms
    seen=$(property NRestarts)
    new=$(property MainPID)
    [ "$old" != "$new" ] || status=1
    # The interrupted series' slot is not taken again; an extra series shows that it records.
    wingd trigger --socket /run/wingd/wingd.sock >/dev/null
    until_true 60 frames_at_least 1 || status=1
    verdict $status "$what: killed by the watchdog (${WATCHDOG_S} s) and ready again after $took ms, a frame $waited_ms ms later"
}
# shellcheck disable=SC2329
hold_thread() { # NAME: stops one thread of the service; the others go on
    local task
    for task in "/proc/$(property MainPID)/task"/*; do
        [ "$(cat "$task/comm")" = "$1" ] && { setsid hold "${task##*/}" & }
    done
}
stopped "the daemon stopped (SIGSTOP)" kill -STOP "$(property MainPID)"
stopped "its recorder stands still, the rest goes on" hold_thread recorder
until_true 120 frames_at_least 10
stopped "its processing stands still with frames to solve" hold_thread processing
[ "$(journalctl -u wingd --no-pager | grep -c 'Watchdog timeout')" = 3 ]; verdict $? "the journal names the watchdog each time"

# 5. The end: stopped cleanly, every frame that was promised is there.
until_true 240 solved_all 1
systemctl stop wingd; [ "$(property Result)" = success ]; verdict $? "stops on SIGTERM with status 0"
wingd verify /var/lib/wingd/store >/tmp/verify 2>&1; verdict $? "the store verifies after three kills: $(tail -n 1 /tmp/verify)"
find /var/lib/wingd/store/flights -name '*.jpg' -exec sha256sum {} + | cut -d' ' -f1 >/tmp/stored
missing=0 promised=0
for hash in $(promises); do
    promised=$((promised + 1)); grep -q "$hash" /tmp/stored || missing=$((missing + 1))
done
[ "$promised" -gt 20 ] && [ $missing = 0 ]; verdict $? "$promised frames promised in the journal, $missing of them missing"
echo "boot: end"
