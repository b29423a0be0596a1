#!/bin/bash
[ -n "${BASH_VERSION:-}" ] || exec bash "$0" "$@"
# The hardware paths in virtual machines; see README.md. Ends with a line `N passed, N failed`.
#   run.sh [--cached] [PART…] (`live` only where it is named); --cached: the parts that need a kernel or a Debian of their own only where it is there.
. "$(dirname "$0")/common.sh"
set +e
WINGD=${WINGD:-$ROOT/target/release/wingd}; export WINGD
FRAMES=${FRAMES:-$ROOT/fixtures/dev/frames}; export FRAMES
FEED=${FEED:-$ROOT/target/release/examples/feed}; export FEED
FAULT_ROUNDS=${FAULT_ROUNDS:-2}; export FAULT_ROUNDS
[ -x "$WINGD" ] || die "$WINGD is missing; run make build"
[ -x "$BOARD" ] || die "$BOARD is missing; run make build-board"
cached=; [ "${1:-}" != --cached ] || { cached=yes; shift; }
[ $# -gt 0 ] || set -- unit gphoto daemon package start v4l release power boot aarch64
lines=$(mktemp); trap 'rm -f "$lines"' EXIT

fed() { # what plays pictures
    [ -x "$FEED" ] || (cd "$ROOT" && "${CARGO:-cargo}" build --release --locked --example feed)
}
guest() { # SCRIPT: in the virtual machine, with what it needs
    fed || return 1
    "$MACHINE/uml.sh" "$MACHINE/$1-guest.sh" "wingd=$WINGD" "feed=$FEED" "frames=$FRAMES" "rounds=$FAULT_ROUNDS" \
        "installation=$(dirname "$FRAMES")/installation" "iolibs=$("$MACHINE/vcamera.sh")"
}
skipped= uncrossed=
for part in "$@"; do
    begin=$SECONDS
    case $part in
        start | v4l | live | release | power | boot)
            if [ -n "$cached" ] && ! "$MACHINE/kernel.sh" --cached >/dev/null 2>&1; then
                skipped="$skipped $part"; continue
            fi ;;
        aarch64)
            if [ -n "$cached" ] && ! "$ROOT/packaging/aarch64.sh" --cached >/dev/null 2>&1; then
                uncrossed=yes; continue
            fi ;;
    esac
    case $part in
        start | v4l | live | release | power) guest "$part" 2>&1 | tee -a "$lines" ;;
        # The virtual camera's library looks for files that need not be there.
        *) "$MACHINE/$part.sh" 2>&1 | grep --line-buffered -v '^[0-9,]*: No such file' | tee -a "$lines" ;;
    esac
    # Every part must have spoken: silence is a failure.
    grep -q "^\(passed\|failed\): $part:" "$lines" || echo "failed: $part: said nothing" | tee -a "$lines"
    say "$part: $((SECONDS - begin)) s"
done
passed=$(grep -c '^passed: ' "$lines"); failed=$(grep -c '^failed: ' "$lines")
grep '^failed: ' "$lines"
[ -z "$skipped" ] || echo "NOT RUN:$skipped: the virtual machine's kernel is not built here (10 to 25 minutes, once); run make test-machine"
[ -z "$uncrossed" ] || echo "NOT RUN: aarch64: this version is not cross-built here (10 to 40 minutes the first time, later a third of that); run make test-machine"
echo "$passed passed, $failed failed"
[ "$failed" = 0 ]
