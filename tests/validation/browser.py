#!/usr/bin/env python3
"""The page in a headless Chromium: on a desk and on a phone, light and dark, by keyboard; two stores at one address.

    apt install chromium; pip install websocket-client
    tests/validation/browser.py target/release/wingd STORE [SCREENSHOTS]
"""

import atexit
import base64
import hashlib
import json
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import urllib.request
from pathlib import Path

import websocket

PORT, DEBUG = 18095, 18096
PAGES = {"index": "/", "flight": "/flights/f0001", "series": "/flights/f0001/s000001",
         "frame": "/frames/f0001/s000001/0001.jpg"}

# The least contrast of a text against the nearest background behind it (WCAG 2), drawings' texts included.
CONTRAST = """(() => {
  const channel = v => (v /= 255) <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4;
  const parse = c => { const m = c.match(/[\\d.]+/g).map(Number); return m.length < 4 ? [...m, 1] : m; };
  const luminance = ([r, g, b]) => 0.2126 * channel(r) + 0.7152 * channel(g) + 0.0722 * channel(b);
  const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  let worst = [99, ""];
  while (walker.nextNode()) {
    const element = walker.currentNode.parentElement, text = walker.currentNode.textContent.trim();
    if (!text || !element.checkVisibility() || element.closest(".photo, title, style, .skip")) continue;
    const style = getComputedStyle(element), svg = element.closest("svg");
    let ground = element, colour = [255, 255, 255, 1];
    while (ground) {
      const found = parse(getComputedStyle(ground).backgroundColor);
      if (found[3] > 0.5) { colour = found; break; }
      ground = ground.parentElement;
    }
    // Dark pages invert their figures, which are drawn on white.
    if (svg && getComputedStyle(svg).filter !== "none") colour = colour.map(v => 255 - v);
    const [a, b] = [luminance(parse(svg ? style.fill : style.color)), luminance(colour)].sort((x, y) => y - x);
    const ratio = (a + 0.05) / (b + 0.05);
    if (ratio < worst[0]) worst = [ratio, text.slice(0, 30)];
  }
  return worst;
})()"""


class Browser:
    def __init__(self, profile):
        self.child = subprocess.Popen(
            ["chromium", "--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", f"--user-data-dir={profile}",
             f"--remote-debugging-port={DEBUG}", "--remote-allow-origins=*", "about:blank"],
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        atexit.register(self.child.kill)
        for _ in range(200):
            try:
                pages = json.load(urllib.request.urlopen(f"http://127.0.0.1:{DEBUG}/json"))
                self.socket = websocket.create_connection(
                    next(p for p in pages if p["type"] == "page")["webSocketDebuggerUrl"], timeout=60)
                break
            except (OSError, StopIteration):
                time.sleep(0.1)
        self.number = 0
        self.call("Page.enable")

    def call(self, method, **parameters):
        self.number += 1
        self.socket.send(json.dumps({"id": self.number, "method": method, "params": parameters}))
        while True:
            answer = json.loads(self.socket.recv())
            if answer.get("id") == self.number:
                return answer["result"]

    def evaluate(self, expression):
        return self.call("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)["result"].get("value")

    def open(self, path, width, dark=False):
        self.call("Emulation.setDeviceMetricsOverride", width=width, height=900, deviceScaleFactor=1, mobile=width < 500)
        scheme = [{"name": "prefers-color-scheme", "value": "dark" if dark else "light"}]
        self.call("Emulation.setEmulatedMedia", features=scheme)
        self.call("Page.navigate", url=path if ":" in path else f"http://127.0.0.1:{PORT}{path}")
        ready = "document.readyState == 'complete' && [...document.images].every(i => i.complete || i.loading == 'lazy')"
        for _ in range(200):
            time.sleep(0.05)
            if self.evaluate(ready):
                break
        self.evaluate("document.querySelectorAll('img').forEach(i => i.loading = 'eager')")
        for _ in range(200):
            if self.evaluate("[...document.images].every(i => i.complete && i.naturalWidth > 0)"):
                return
            time.sleep(0.05)
        raise AssertionError(f"{path}: a picture does not come")

    def screenshot(self, file):
        data = self.call("Page.captureScreenshot", captureBeyondViewport=True)["data"]
        file.write_bytes(base64.b64decode(data))

    def key(self, name, code):
        for kind in ["keyDown", "keyUp"]:
            self.call("Input.dispatchKeyEvent", type=kind, key=name, code=name, windowsVirtualKeyCode=code)

    def close(self):
        self.socket.close()
        self.child.terminate()
        self.child.wait(20)


def serve(wingd, store):
    child = subprocess.Popen([wingd, "serve", store, "--listen", f"127.0.0.1:{PORT}"], stderr=subprocess.DEVNULL)
    atexit.register(child.kill)
    for _ in range(100):
        try:
            urllib.request.urlopen(f"http://127.0.0.1:{PORT}/status.json")
            return child
        except OSError:
            time.sleep(0.05)
    raise SystemExit("the server does not answer")


def stop(child):
    child.send_signal(signal.SIGTERM)
    child.wait(10)


def look(wingd, store, folder):
    server, profile = serve(wingd, store), tempfile.mkdtemp()
    browser = Browser(profile)
    report = (folder / "report.html").resolve()
    subprocess.run([wingd, "report", store, "--output", report], check=True, stdout=subprocess.DEVNULL)
    for name, path in {**PAGES, "report": report.as_uri()}.items():
        for width in [1400, 390]:
            for dark in [False, True]:
                browser.open(path, width, dark)
                over = browser.evaluate("document.documentElement.scrollWidth - innerWidth")
                ratio, text = browser.evaluate(CONTRAST)
                outside = browser.evaluate(
                    "performance.getEntriesByType('resource').filter(e => !e.name.startsWith(location.origin) && !e.name.startsWith('data:')).length")
                browser.screenshot(folder / f"{name}-{width}{'-dark' if dark else ''}.png")
                print(f"{name} at {width}{' dark' if dark else ''}: {over} px too wide, least contrast {ratio:.1f} ({text}), {outside} from outside")
                assert over <= 0 and ratio >= 4.5 and outside == 0, name
    browser.open("/flights/f0001", 1400)
    links = browser.evaluate("[...document.querySelectorAll('a[href]')].length")
    reached = set()
    for _ in range(3 * links):
        browser.key("Tab", 9)
        reached.add(browser.evaluate("document.activeElement.href || document.activeElement.tagName"))
    wanted = set(browser.evaluate("[...document.querySelectorAll('a[href]')].map(a => a.href)"))
    assert wanted <= reached, wanted - reached
    print(f"keyboard: all {len(wanted)} links of a flight's page are reached by Tab")
    browser.close()
    stop(server)


def two_stores(wingd, store, folder):
    """The same address shows one store, then another: each its own frames, in one browser with one cache."""
    other = folder / "other-store"
    shutil.rmtree(other, ignore_errors=True)
    shutil.copytree(store, other)
    # The other store's first frame is its second one's picture: same names, same moments, other bytes.
    series = other / "flights/f0001/s000001"
    first, second = (series / "0001.jpg").read_bytes(), (series / "0002.jpg").read_bytes()
    (series / "0001.jpg").write_bytes(second)
    manifest = (series / "series.json").read_text()
    digest = lambda data: hashlib.sha256(data).hexdigest()
    manifest = manifest.replace(digest(first), "x" * 64).replace(digest(second), digest(second)).replace("x" * 64, digest(second))
    manifest = manifest.replace(f'"bytes": {len(first)}', f'"bytes": {len(second)}')
    (series / "series.json").write_text(manifest)
    browser, seen = Browser(tempfile.mkdtemp()), []
    shown = """(async () => { const c = document.createElement('canvas'), i = document.images[0];
        c.width = 200; c.height = 150; const g = c.getContext('2d'); g.drawImage(i, 0, 0, 200, 150);
        const d = g.getImageData(0, 0, 200, 150).data; let h = 0; for (const v of d) h = (h * 31 + v) | 0; return h; })()"""
    for one in [store, other, store, other]:
        server = serve(wingd, one)
        browser.open("/frames/f0001/s000001/0001.jpg", 1400)
        picture = browser.evaluate(shown)
        seen.append(picture)
        stop(server)
    browser.close()
    print(f"two stores in turn at one address: {seen}")
    assert seen[0] == seen[2] and seen[1] == seen[3] and seen[0] != seen[1]


def main():
    wingd, store = sys.argv[1], Path(sys.argv[2])
    folder = Path(sys.argv[3] if len(sys.argv) > 3 else tempfile.mkdtemp())
    folder.mkdir(parents=True, exist_ok=True)
    look(wingd, store, folder)
    two_stores(wingd, store, folder)


main()
