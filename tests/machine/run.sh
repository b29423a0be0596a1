#!/bin/bash
[ -n "${BASH_VERSION:-}" ] || exec bash "$0" "$@"
# The hardware paths in virtual machines; see README.md. Ends with a line `N passed, N failed`.
. "$(dirname "$0")/common.sh"
set +e
WINGD=${WINGD:-$ROOT/target/release/wingd}; export WINGD
FRAMES=${FRAMES:-$ROOT/fixtures/dev/frames}; export FRAMES
FEED=${FEED:-$ROOT/target/release/examples/feed}
FAULT_ROUNDS=${FAULT_ROUNDS:-20}; export FAULT_ROUNDS
[ -x "$WINGD" ] || die "$WINGD is missing; run make build"
[ -x "$FEED" ] || (cd "$ROOT" && "${CARGO:-cargo}" build --release --locked --example feed) || die "the feed does not build"
lines=$(mktemp); trap 'rm -f "$lines"' EXIT

"$MACHINE/unit.sh" 2>&1 | tee -a "$lines"
"$MACHINE/gphoto.sh" 2>&1 | grep -v '^[0-9,]*: No such file' | tee -a "$lines"
"$MACHINE/uml.sh" "$MACHINE/v4l-guest.sh" "wingd=$WINGD" "feed=$FEED" "frames=$FRAMES" "rounds=$FAULT_ROUNDS" \
    "installation=$FRAMES/../installation/camera.toml" 2>&1 | tee -a "$lines"
"$MACHINE/daemon.sh" 2>&1 | grep -v "^[0-9,]*: No such file" | tee -a "$lines"
"$MACHINE/package.sh" 2>&1 | tee -a "$lines"

passed=$(grep -c '^passed: ' "$lines"); failed=$(grep -c '^failed: ' "$lines")
# Every part must have spoken: silence is a failure.
for part in unit: gphoto: v4l: release: daemon: package:; do
    grep -q "^\(passed\|failed\): $part" "$lines" || { echo "failed: $part said nothing"; failed=$((failed + 1)); }
done
echo "$passed passed, $failed failed"
[ "$failed" = 0 ]
