#!/bin/sh
# Prints a Python that has OpenCV and SciPy, the peers of the benches: the system's, or one of target/peers, made once.
set -eu
cd "$(dirname "$0")/.."
if python3 -c 'import cv2, scipy' 2>/dev/null; then
    command -v python3
    exit
fi
peers=$PWD/target/peers
if [ ! -e "$peers/installed" ]; then
    python3 -m venv "$peers"
    "$peers/bin/pip" install --quiet --disable-pip-version-check opencv-python-headless scipy >&2
    touch "$peers/installed"
fi
echo "$peers/bin/python"
