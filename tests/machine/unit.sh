#!/bin/bash
# The service file: clean, and closed as far as it can be.
. "$(dirname "$0")/common.sh"
need systemd-analyze systemd
work=$(mktemp -d); trap 'rm -rf "$work"' EXIT
sed 's#/usr/bin/wingd#/bin/true#' "$ROOT/systemd/wingd.service" >"$work/wingd.service"
complaints=$(systemd-analyze verify "$work/wingd.service" 2>&1)
if [ -z "$complaints" ]; then echo "passed: unit: verified without a word"; else echo "failed: unit: $complaints"; fi
if level=$(systemd-analyze security --offline=true --threshold=20 "$work/wingd.service" | tail -n 1); then
    echo "passed: unit: ${level#* }"
else
    echo "failed: unit: $level, at most 2.0"
fi
