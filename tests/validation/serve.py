#!/usr/bin/env python3
"""Figures of the page: a download against nginx, a thousand series, attacks. Needs nginx and curl.

    tests/validation/serve.py target/release/wingd [--work DIR] [--part download]
"""

import argparse
import os
import re
import shutil
import signal
import socket
import subprocess
import tempfile
import time
from pathlib import Path

import stores


def measure_child(command):
    """Seconds of processor time and MB of memory of a command."""
    with tempfile.TemporaryFile() as out:
        child = subprocess.Popen([str(c) for c in command], stdout=out, stderr=out)
        _, status, usage = os.wait4(child.pid, 0)
        out.seek(0)
        if status:
            print(out.read().decode(errors="replace"))
    return usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1000


class Server:
    def __init__(self, wingd, store, port):
        self.url = f"http://127.0.0.1:{port}"
        self.child = subprocess.Popen([wingd, "serve", str(store), "--listen", f"127.0.0.1:{port}"],
                                      stderr=subprocess.DEVNULL)
        for _ in range(100):
            try:
                socket.create_connection(("127.0.0.1", port), 1).close()
                return
            except OSError:
                time.sleep(0.05)
        raise SystemExit("the server does not answer")

    def cpu_s(self):
        fields = Path(f"/proc/{self.child.pid}/stat").read_text().rsplit(")", 1)[1].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    def peak_mb(self):
        status = Path(f"/proc/{self.child.pid}/status").read_text()
        return int(re.search(r"VmHWM:\s+(\d+)", status).group(1)) / 1000

    def stop(self):
        begun = time.monotonic()
        self.child.send_signal(signal.SIGTERM)
        self.child.wait(20)
        return time.monotonic() - begun


def fetch_s(url, more=()):
    begun = time.monotonic()
    subprocess.run(["curl", "-sSf", "-o", "/dev/null", *more, url], check=True)
    return time.monotonic() - begun


def nginx(work, folder, port):
    config = work / "nginx.conf"
    config.write_text(f"daemon off; pid {work}/nginx.pid; error_log stderr; user root;"
                      "events {} http { access_log off; sendfile on; server {"
                      f"listen 127.0.0.1:{port}; root {folder}; }} }}")
    child = subprocess.Popen(["nginx", "-c", config], stderr=subprocess.DEVNULL)
    time.sleep(0.5)
    return child


def download(wingd, work):
    store = work / "big"
    if not store.exists():
        stores.make(wingd, store, 40, 36, stores.bundled_frames())
    server = Server(wingd, store, 18081)
    served = work / "served"
    served.mkdir(exist_ok=True)
    tar = served / "f0001.tar"
    subprocess.run(["curl", "-sSf", "-o", tar, f"{server.url}/tar/f0001.tar"], check=True)
    print(f"archive: {tar.stat().st_size / 1e9:.2f} GB; server's peak memory {server.peak_mb():.1f} MB")
    peer = nginx(work, served, 18082)
    ours, theirs = [], []
    for _ in range(7):
        ours.append(fetch_s(f"{server.url}/tar/f0001.tar"))
        theirs.append(fetch_s("http://127.0.0.1:18082/f0001.tar"))
    peer.terminate()
    size = tar.stat().st_size / 1e6
    rates = (size / min(ours), size / min(theirs))
    medians = (size / sorted(ours)[3], size / sorted(theirs)[3])
    print(f"wingd {rates[0]:.0f} MB/s, nginx {rates[1]:.0f} MB/s, ratio {rates[0] / rates[1]:.2f} "
          f"(medians {medians[0]:.0f}, {medians[1]:.0f}, ratio {medians[0] / medians[1]:.2f})")
    broken = work / "broken.tar"
    broken.unlink(missing_ok=True)
    for cut in range(1, 31):
        length = tar.stat().st_size * cut // 31
        have = broken.stat().st_size if broken.exists() else 0
        with subprocess.Popen(["curl", "-sS", "-C", "-", "-o", broken, f"{server.url}/tar/f0001.tar"],
                              stderr=subprocess.DEVNULL) as child:
            while broken.stat().st_size < max(length, have + 1) if broken.exists() else True:
                if child.poll() is not None:
                    break
                time.sleep(0.0005)
            child.kill()
    subprocess.run(["curl", "-sSf", "-C", "-", "-o", broken, f"{server.url}/tar/f0001.tar"], check=True)
    same = subprocess.run(["cmp", tar, broken]).returncode == 0
    print(f"broken off 30 times and resumed: {'equal' if same else 'NOT EQUAL'}; "
          f"server's peak memory {server.peak_mb():.1f} MB, stop {server.stop():.2f} s")
    unpacked = work / "unpacked"
    shutil.rmtree(unpacked, ignore_errors=True)
    unpacked.mkdir()
    subprocess.run(["tar", "-xf", broken, "-C", unpacked], check=True)
    broken.unlink()
    cpu, _ = measure_child([wingd, "verify", unpacked])
    begun = time.monotonic()
    subprocess.run(["sha256sum", "-c", "--quiet", "SHA256SUMS"], cwd=unpacked / "flights/f0001", check=True)
    print(f"verify of the unpacked store: {cpu:.1f} s of processor time; sha256sum {time.monotonic() - begun:.1f} s")
    verified = subprocess.run([wingd, "verify", unpacked], capture_output=True, text=True)
    print(verified.stdout.strip())


def unpacked(wingd, work):
    """The demonstration's archive, unpacked: all that works on a store works on it."""
    demo, folder = work / "demo/store", work / "unpacked-demo"
    if not demo.exists():
        stores.demo(wingd, work)
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    server = Server(wingd, demo, 18085)
    subprocess.run(f"curl -sSf {server.url}/tar/f0001.tar | tar -x -C {folder}", shell=True, check=True)
    server.stop()
    for command in [["verify", folder], ["report", folder, "--output", work / "report.html"],
                    ["solve", folder, "--method", "profile"], ["verify", folder], ["compare", folder]]:
        done = subprocess.run([wingd, *command], capture_output=True, text=True)
        print(f"{command[0]}: exit {done.returncode}; {done.stdout.strip().splitlines()[-1]}")


def thousand(wingd, work):
    store = work / "thousand"
    if not store.exists():
        small = b"\xff\xd8" + b"\0" * 100 + b"\xff\xd9"
        demo, template = stores.demo(wingd, work)
        stores.make(wingd, store, 1000, 10, [small], template, next((demo / "installations").iterdir()))
    lines = sum(p.stat().st_size for p in store.glob("flights/*/*/results.jsonl"))
    print(f"1000 series, 10000 frames, {lines / 1e6:.0f} MB of results")
    for path in ["/", "/flights/f0001", "/flights/f0001/s000500", "/status.json"]:
        server = Server(wingd, store, 18083)
        # The first request warms the page cache of the machine, not the server: each has a server of its own.
        before = server.cpu_s()
        wall = fetch_s(server.url + path)
        print(f"{path}: {server.cpu_s() - before:.2f} s of processor time, {wall:.2f} s, {server.peak_mb():.0f} MB")
        server.stop()
    for name, command in {
        "report": ["report", store, "--output", work / "report.html"],
        "export csv": ["export", store, "--format", "csv", "--output", work / "export.csv"],
        "export parquet": ["export", store, "--format", "parquet", "--output", work / "export.parquet"],
        "export jsonl": ["export", store, "--format", "jsonl", "--output", work / "export.jsonl"],
    }.items():
        cpu, memory = measure_child([wingd, *command])
        print(f"{name}: {cpu:.1f} s of processor time, {memory:.0f} MB")


def attacks(wingd, work):
    folder = work / "attacked"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    (folder / "token").write_text("correct-horse-battery")
    (folder / "wingd.toml").write_text(f"""
[camera]
kind = "replay"
folder = "{stores.REPOSITORY}/fixtures/dev/frames"
[store]
path = "store"
reserve_mb = 0
[status]
socket = "wingd.sock"
[series]
interval = "1s"
shots = 2
gap = "20ms"
stale_window = 1
[serve]
listen = "127.0.0.1:18084"
token_file = "token"
""")
    daemon = subprocess.Popen([wingd, "run", "--config", folder / "wingd.toml"], stderr=subprocess.DEVNULL)
    time.sleep(8)
    stages = {"alone": [], "attacked": []}
    begins = lambda: sorted(p.name for p in (folder / "store/flights/f0001").glob("s*"))
    quiet = len(begins())
    slow = []
    begun = time.monotonic()
    while time.monotonic() - begun < 20:
        for _ in range(1000 - len(slow)):
            try:
                one = socket.create_connection(("127.0.0.1", 18084), 0.2)
                one.sendall(b"GET /tar/f0001.tar HTTP/1.1\r\nHost: localhost\r\nX: ")
                slow.append(one)
            except OSError:
                break
        for one in list(slow):
            try:
                one.sendall(b"a")
            except OSError:
                slow.remove(one)
        for bad in [b"GET /files/f0001/../../../etc/passwd HTTP/1.1\r\nHost: localhost\r\n\r\n",
                    b"GET / HTTP/1.1\r\nHost: evil.example\r\n\r\n",
                    b"GET / HTTP/1.1\r\nHost: localhost\r\nA: " + b"a" * 100_000 + b"\r\n\r\n",
                    b"GET /tar/f0001.tar HTTP/1.1\r\nHost: localhost\r\nRange: bytes=9-1,0-,x\r\n\r\n"]:
            try:
                with socket.create_connection(("127.0.0.1", 18084), 0.2) as one:
                    one.sendall(bad)
            except OSError:
                pass
        time.sleep(0.2)
    attacked = begins()[quiet:]
    begun = time.monotonic()
    daemon.send_signal(signal.SIGTERM)
    daemon.wait(30)
    stop_s = time.monotonic() - begun
    import json
    moments = []
    for name in begins():
        manifest = json.loads((folder / f"store/flights/f0001/{name}/series.json").read_text())
        moments.append((name, manifest["started"]["since_boot_s"]))
    first = moments[0][1]
    late = lambda names: max(abs((m - first) - round(m - first)) for n, m in moments if n in names)
    print(f"series begun off their second by at most {1e3 * late(begins()[:quiet]):.0f} ms alone, "
          f"{1e3 * late(attacked):.0f} ms under attack ({len(attacked)} series in 20 s); stop {stop_s:.2f} s")
    checked = subprocess.run([wingd, "verify", folder / "store"], capture_output=True, text=True)
    print(checked.stdout.strip())


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("wingd", type=Path)
    parser.add_argument("--work", type=Path, default=Path(tempfile.gettempdir()) / "wingd-validation")
    parser.add_argument("--part", action="append", dest="parts", choices=["download", "unpacked", "thousand", "attacks"])
    arguments = parser.parse_args()
    arguments.work.mkdir(parents=True, exist_ok=True)
    wingd = arguments.wingd.resolve()
    for name, part in {"download": download, "unpacked": unpacked, "thousand": thousand, "attacks": attacks}.items():
        if not arguments.parts or name in arguments.parts:
            print(f"-- {name}")
            part(wingd, arguments.work)


if __name__ == "__main__":
    main()
