#!/bin/sh
# The figures of docs/performance.md: our benches and their peers, one after the other, one thread.
set -eu
cd "$(dirname "$0")/.."
export RAYON_NUM_THREADS=1
python=$(sh benches/peers.sh)
${CARGO:-cargo} bench --locked
"$python" benches/opencv_peer.py fixtures/dev/frames/flight-1.jpg
"$python" benches/scipy_peer.py
