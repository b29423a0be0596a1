# A campaign of faults against one running recorder; for the host and for the guest. Needs: $wingd, $rounds,
# $W (a working directory), verdict STATUS TEXT, and a configuration in $W/wingd.toml with its store in $W/store.
# shellcheck shell=bash disable=SC2154
export NO_COLOR=1
RANDOM=7 # the same moments every time
now_ms() { echo $(($(date +%s%N) / 1000000)); }
# grep -c prints 0 and fails where there is none.
durable() { grep -c 'frame is durable' "$W/log"; }
failures() { grep -c ' kind="' "$W/log"; }
# wait_more COUNTER VALUE SECONDS: until the count is above the value.
wait_more() {
    local end=$(($(now_ms) + $3 * 1000))
    while [ "$("$1")" -le "$2" ]; do [ "$(now_ms)" -lt "$end" ] || return 1; sleep 0.05; done
}
start_recorder() {
    rm -rf "$W/store"; : >"$W/log"
    "$wingd" run --config "$W/wingd.toml" >"$W/log" 2>&1 & recorder=$!
    wait_more durable 0 60
}
# stop_recorder: 0 where it lived to the end and stopped as asked.
stop_recorder() {
    kill -0 "$recorder" 2>/dev/null || { say "the recorder is down"; return 1; }
    kill -TERM "$recorder"; wait "$recorder"
}
# Every frame that was promised is in the store, which is sound; every shot has a frame or a reason.
nothing_stored_lost() {
    "$wingd" verify "$W/store" >"$W/verify" 2>&1 || { tail -n 3 "$W/verify"; return 1; }
    find "$W/store/flights" -type f -exec sha256sum {} + | cut -d' ' -f1 >"$W/stored"
    local hash
    for hash in $(sed -n 's/.*frame is durable.* sha256="*\([0-9a-f]*\).*/\1/p' "$W/log"); do
        grep -q "$hash" "$W/stored" || { say "$hash is lost"; return 1; }
    done
}
kinds() { sed -n 's/.* kind="\([a-z_]*\)".*/\1/p' "$W/log" | sort | uniq -c | awk '{printf "%s%s %s", (NR > 1 ? ", " : ""), $1, $2}'; }
# campaign PART NAME INJECT [DEFLECTION]: the fault at `rounds` random moments. INJECT brings it on, and is asked
# again until it has struck; DEFLECTION takes it away a moment later. Recovery counts from there to the next frame. After
# two bad rounds no more are asked for.
campaign() {
    local part=$1 name=$2 inject=$3 deflection=${4:-true} round bad=0 longest=0 sum=0 took before struck begin end
    start_recorder || { verdict 1 "$part: $name: no frame at the beginning"; stop_recorder; return; }
    for ((round = 0; round < rounds && bad < 2; round++)); do
        sleep "0.$(printf %03d $((RANDOM % 1000)))"
        before=$(failures); struck=1; end=$(($(now_ms) + 60000))
        while [ "$(now_ms)" -lt $end ]; do
            "$inject"
            wait_more failures "$before" 2 && { struck=0; break; }
            # Not always at the same moment of the recorder's second.
            sleep "0.$(printf %03d $((RANDOM % 1000)))"
        done
        [ $struck = 0 ] || { say "$name did not strike"; bad=$((bad + 1)); }
        sleep "0.$(printf %03d $((RANDOM % 500)))"
        "$deflection"
        begin=$(now_ms)
        wait_more durable "$(durable)" 60 || { say "$name: no frame afterwards"; bad=$((bad + 1)); }
        took=$(($(now_ms) - begin)); sum=$((sum + took)); [ $took -le $longest ] || longest=$took
    done
    stop_recorder || bad=$((bad + 1))
    nothing_stored_lost || bad=$((bad + 1))
    verdict $bad "$part: $name, $rounds times: $(durable) shots completed, $(grep -c 'shot without a frame' "$W/log") recorded as failed ($(kinds)); next frame after $((sum / round)) ms, at most $longest ms; nothing stored lost, recorder never down"
    # One reason of each kind, as it is in the store.
    sed -n 's/.* \(kind="[a-z_]*" reason=".*\)$/    \1/p' "$W/log" | sort -u -k1,1 | cut -c1-240
}
