#!/usr/bin/env python3
"""The clock's page in a headless Chromium, turned and blurred as a camera sees a screen, its screenshots replayed by the
recorder and read by `wingd time-check`: each time read lies between the moments before and after its screenshot.

    apt install chromium
    tests/validation/time_check.py target/release/wingd
"""

import datetime
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

SHOTS = 5
SIZES = [(1000, 562), (1500, 843), (1200, 900)]
SEEN = """<body style="margin:0;background:#222;overflow:hidden"><iframe src="clock.html" style="border:0;position:absolute;
left:50px;top:40px;width:{0}px;height:{1}px;transform:perspective(2000px) rotateY({2}deg) rotateZ({3}deg);
filter:blur(0.8px)"></iframe></body>"""
LATENCY_S = 0.03 + 0.5 / 60


def screenshot(folder, k):
    page, file = folder / "seen.html", folder / "pictures" / f"{k}.png"
    page.write_text(SEEN.format(*SIZES[k % len(SIZES)], 8 * (k % 3), 1.5 * k - 3))
    before = time.time()
    subprocess.run(
        ["chromium", "--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", "--window-size=1600,1000",
         f"--screenshot={file}", page.as_uri()], check=True, stderr=subprocess.DEVNULL)
    return before, time.time()


def main():
    wingd, folder = Path(sys.argv[1]).resolve(), Path(tempfile.mkdtemp())
    subprocess.run([wingd, "time-check", "--page", folder / "clock.html"], check=True, stdout=subprocess.DEVNULL)
    (folder / "pictures").mkdir()
    taken = [screenshot(folder, k) for k in range(SHOTS)]
    (folder / "wingd.toml").write_text(
        f'[store]\npath = "{folder}/store"\nreserve_mb = 0\n[camera]\nkind = "replay"\nfolder = "{folder}/pictures"\n'
        f'[series]\nshots = {SHOTS}\ngap = "100ms"\n[status]\nsocket = "{folder}/socket"\n')
    recorder = subprocess.Popen([wingd, "run", "--config", folder / "wingd.toml"], stderr=subprocess.DEVNULL)
    for _ in range(100):
        time.sleep(0.2)
        if list(folder.glob("store/flights/*/*/series.json")):
            break
    recorder.terminate()
    recorder.wait()
    answer = subprocess.run([wingd, "time-check", folder / "store", "--json"], stdout=subprocess.PIPE, text=True)
    lines = [json.loads(line) for line in answer.stdout.splitlines()]
    off = 0
    for line, (before, after) in zip(lines, taken):
        if line["status"] != "ok":
            print(line["image"], line["reason"])
            off += 1
            continue
        told = datetime.datetime.fromisoformat(line["shown_time"]).timestamp() - LATENCY_S
        right = before < told < after
        off += not right
        print(f"{line['image']}: {told - before:+.3f} s after the call, {after - told:.3f} s before its end",
              "" if right else "WRONG")
    print(json.dumps(lines[-1]))
    sys.exit(off > 0 or len(lines) != SHOTS + 1)


main()
