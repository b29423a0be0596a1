#!/bin/bash
# The package for aarch64, cross-built: what it depends on, its installation, and the frames of the demonstration, solved in
# an emulator of the processor with the results that the program here has.
. "$(dirname "$0")/common.sh"
set +e
export NO_COLOR=1
WINGD=${WINGD:-$ROOT/target/release/wingd}
work=$(mktemp -d); trap 'rm -rf "$work"' EXIT
log=$work/log
verdict() { if [ "$1" = 0 ]; then echo "passed: aarch64: $2"; else echo "failed: aarch64: $2"; tail -n 5 "$log"; fi; }
cd "$ROOT" || exit 1

begin=$SECONDS
package=$(packaging/aarch64.sh 2>"$log"); status=$?; verdict $status "cross-built and packaged in $((SECONDS - begin)) s"
[ $status = 0 ] || exit 1
system=$(packaging/aarch64-root.sh)
dpkg-deb -x "$package" "$work/files"
binary=$work/files/usr/bin/wingd
emulated() { "$system/usr/bin/qemu-aarch64-static" -L "$system" "$binary" "$@"; }

[ "$(dpkg-deb -f "$package" Architecture)" = arm64 ] && readelf -h "$binary" | grep -q 'Machine: *AArch64'
verdict $? "architecture arm64, a program for AArch64"
depends=$(dpkg-deb -f "$package" Depends); libraries=0; missing=
for library in $(objdump -p "$binary" | sed -n 's/^ *NEEDED *//p'); do
    owner=$(dpkg-query "--admindir=$system/var/lib/dpkg" -S "*/$library" 2>>"$log" | sed -n 's/:arm64: .*//p' | head -n 1)
    grep -qE "(^|, )${owner:-none}( |,|\$)" <<<"$depends" || missing="$missing $library"
    libraries=$((libraries + 1))
done
[ "$libraries" -ge 3 ] && [ -z "$missing" ]; verdict $? "depends on the packages of its $libraries libraries${missing:+, not of$missing}: $depends"
packaging/aarch64-run.sh sh -ec "dpkg -i $package; id -nG wingd | grep -w video; qemu-aarch64-static /usr/bin/wingd --version
    dpkg -P wingd; ! [ -e /usr/bin/wingd ]" >"$log" 2>&1
verdict $? "installs as a foreign package with its dependencies, runs, and purges"

# alike STATUS WORD…: that exit status, and the same words as here.
alike() {
    local expected=$1 here there; shift
    "$WINGD" "$@" >"$work/here" 2>&1; here=$?
    emulated "$@" >"$log" 2>&1; there=$?
    [ $here = "$expected" ] && [ $there = "$expected" ] && cmp "$work/here" "$log"
}
alike 0 --version; verdict $? "wingd --version: $(head -n 1 "$log")"
alike 78 check --config config/wingd.toml; verdict $? "wingd check of the shipped configuration: its one fault, as here"

# measured FILE COMMAND…: its exit status; `took` (s) and `peak` (MB resident).
measured() {
    local out=$1 begin=$SECONDS pid kb; shift
    "$@" >"$out" 2>"$log" & pid=$!
    peak=0
    while kill -0 $pid 2>/dev/null; do
        kb=$(sed -n 's/^VmHWM:[[:space:]]*\([0-9]*\).*/\1/p' /proc/$pid/status 2>/dev/null); [ "${kb:-0}" -le "$peak" ] || peak=$kb
        sleep 0.1
    done
    peak=$((peak / 1024)) took=$((SECONDS - begin))
    wait $pid
}
measured "$work/here" "$WINGD" demo --output "$work/x86"; verdict $? "the demonstration here: $took s, peak memory $peak MB"
cp -a "$work/x86" "$work/arm"
# Other standard deviations: results of the same inputs are in the store already.
"$WINGD" solve "$work/x86/store" --sigma prior --json >"$work/here" 2>"$log"; verdict $? "its frames solved again here"
measured "$work/there" "$system/usr/bin/qemu-aarch64-static" -L "$system" "$binary" solve "$work/arm/store" --sigma prior --json
verdict $? "the same in the emulator: $took s, peak memory of program and emulator $peak MB"
solved=$(grep -c '"status":"ok"' "$work/there")
[ "$solved" = 10 ]; verdict $? "$solved of 10 frames solved"
emulated verify "$work/arm/store" >"$log" 2>&1 && "$WINGD" verify "$work/arm/store" >>"$log" 2>&1
verdict $? "wingd verify of its store, there and here"
printf 'installation = "arm/input/installation"\n[camera]\nkind = "replay"\nfolder = "arm/input/frames"\n[store]\npath = "arm/store"
[status]\nsocket = "wingd.sock"\n' >"$work/wingd.toml"
alike 0 check --config "$work/wingd.toml"; verdict $? "wingd check of its store and installation finds no fault, as here"

"$WINGD" export "$work/x86/store" --format csv --table markers >"$work/x86.csv" 2>"$log"
"$WINGD" export "$work/arm/store" --format csv --table markers >"$work/arm.csv" 2>>"$log"
compared=$(awk -f "$MACHINE/compare.awk" "$work/x86.csv" "$work/arm.csv" 2>>"$log"); verdict $? "results: $compared"
