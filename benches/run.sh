#!/bin/sh
# The figures of docs/performance.md: our benches and their peers, one after the other, one thread.
set -eu
cd "$(dirname "$0")/.."
export RAYON_NUM_THREADS=1
${CARGO:-cargo} bench --locked
if ! python3 -c 'import cv2, scipy' 2>/dev/null; then
    peers=target/peers
    [ -x "$peers/bin/python" ] || python3 -m venv "$peers"
    "$peers/bin/pip" install --quiet opencv-python-headless scipy
    PATH="$PWD/$peers/bin:$PATH"
fi
python3 benches/opencv_peer.py fixtures/dev/frames/flight-1.jpg
python3 benches/scipy_peer.py
