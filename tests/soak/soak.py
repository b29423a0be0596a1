"""The recorder under everything at once, with the limits of its service; see README.md.

Ends with the figures, and with status 1 if the recorder was killed, missed a series, needed too much memory, or left a store
that does not verify.
"""

import argparse
import html.parser
import json
import os
import pathlib
import re
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
import urllib.error
import urllib.parse
import urllib.request

MEMORY_MAX = 512 * 1000 * 1000
MEMORY_GOAL = 400 * 1000 * 1000
TASKS_MAX = 128
INTERVAL_S = 60
SHOTS = 3
RESERVE_MB = 400
DISK_MB = 6000
SLOW_READERS = 250
# More than the recorder serves at once.
EVENT_STREAMS = 20
# Time between two calls of the camera that hang, s.
HANG_EVERY_S = 45
VCAMERA = pathlib.Path(__file__).parent.parent / "machine/vcamera.sh"
FLOOD_PER_S = 1000

CONFIGURATION = """
installation = {installation}
[camera]
kind = "gphoto"
[camera.settings]
focusmode = "Manual"
[series]
interval = "{interval}s"
shots = {shots}
gap = "1s"
shot_deadline = "2s"
stale_window = 1
[store]
path = "store"
reserve_mb = {reserve}
[status]
socket = "wingd.sock"
[serve]
listen = "127.0.0.1:{page}"
[live]
rate_hz = 10
socket = "live.sock"
[live.keep]
every = 100
[live.aircraft_data]
udp = "127.0.0.1:{feed}"
"""


def free_port(kind):
    with socket.socket(socket.AF_INET, kind) as one:
        one.bind(("127.0.0.1", 0))
        return one.getsockname()[1]


class Limits:
    """Memory and tasks of the recorder: a control group if one can be made, otherwise only watched."""

    def __init__(self):
        self.groups = []
        name = f"wingd-soak-{os.getpid()}"
        v2 = pathlib.Path("/sys/fs/cgroup")
        try:
            if (v2 / "cgroup.controllers").exists():
                self.make(v2 / name, {"memory.max": MEMORY_MAX, "pids.max": TASKS_MAX})
            else:
                self.make(v2 / "memory" / name, {"memory.limit_in_bytes": MEMORY_MAX})
                self.make(v2 / "pids" / name, {"pids.max": TASKS_MAX})
        except OSError as error:
            print(f"no control group ({error}): memory and tasks are watched, not limited")
            self.remove()

    def make(self, group, values):
        group.mkdir()
        self.groups.append(group)
        for file, value in values.items():
            (group / file).write_text(str(value))

    def enter(self):
        for group in self.groups:
            (group / "cgroup.procs").write_text(str(os.getpid()))

    def peak(self):
        for group in self.groups:
            for file in ("memory.peak", "memory.max_usage_in_bytes"):
                if (group / file).exists():
                    return int((group / file).read_text())
        return None

    def remove(self):
        for group in self.groups:
            try:
                group.rmdir()
            except OSError:
                pass
        self.groups = []


class Disk:
    """A disk of its own for the store, if one can be mounted."""

    def __init__(self, folder):
        self.folder, self.mounted = folder, False
        image = folder.parent / "disk.img"
        with open(image, "wb") as file:
            file.truncate(DISK_MB * 1_000_000)
        made = subprocess.run(["mkfs.ext4", "-q", "-m", "0", image], capture_output=True).returncode == 0
        if made and subprocess.run(["mount", "-o", "loop", image, folder], capture_output=True).returncode == 0:
            self.mounted = True
        else:
            print("no disk can be mounted: the disk is not filled")

    def free(self):
        return shutil.disk_usage(self.folder).free

    def fill(self):
        """Leaves between the reserve and twice the reserve: series go on, events and feed must not."""
        spare = int(1.5 * RESERVE_MB * 1_000_000)
        if self.mounted and self.free() > spare:
            subprocess.run(["fallocate", "-l", str(self.free() - spare), self.folder / "filler"], check=True)

    def empty(self):
        (self.folder / "filler").unlink(missing_ok=True)

    def remove(self):
        if self.mounted:
            subprocess.run(["umount", self.folder], check=False)


class VirtualCamera:
    """libgphoto2's virtual camera with the frames as views; one call after the other hangs."""

    def __init__(self, folder, frames):
        self.folder, self.over = folder, threading.Event()
        for part in ("card/DCIM", "shots", "state"):
            (folder / part).mkdir(parents=True)
        views = sorted(frames.glob("*.jpg"))
        for number, view in enumerate(views):
            shutil.copy(view, folder / f"shots/{number:02}.jpg")
        shutil.copy(views[0], folder / "card/dummy.jpg")
        drivers = subprocess.run(["bash", VCAMERA], check=True, capture_output=True, text=True).stdout.strip()
        self.environment = {
            "IOLIBS": drivers, "VCAMERADIR": str(folder / "card"), "VCAMERA_SHOTS": str(folder / "shots"),
            "VCAMERA_STATE": str(folder / "state"), "VCAMERA_VIEWS": str(len(views)),
        }
        threading.Thread(target=self.hang, daemon=True).start()

    def hang(self):
        while not self.over.wait(HANG_EVERY_S):
            (self.folder / "state/fault").write_text("hang\n")

    def hung(self):
        return (self.folder / "state/log").read_text().count("fault hang")


class Links(html.parser.HTMLParser):
    def __init__(self):
        super().__init__()
        self.found = []

    def handle_starttag(self, _, attributes):
        self.found += [value for name, value in attributes if name in ("href", "src") and value]


class Load:
    """Everything that disturbs the recorder, on threads of its own."""

    def __init__(self, page, feed):
        self.page, self.feed, self.over = f"http://127.0.0.1:{page}", feed, threading.Event()
        self.port, self.answers, self.sent, self.read = page, {}, 0, 0
        self.lock = threading.Lock()
        self.events = 0
        works = [self.flood, self.slow, *[self.walk] * 6, *[self.watch] * EVENT_STREAMS]
        self.threads = [threading.Thread(target=work, daemon=True) for work in works]
        for thread in self.threads:
            thread.start()

    def count(self, status):
        with self.lock:
            self.answers[status] = self.answers.get(status, 0) + 1

    def flood(self):
        out = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        junk, begun, lines = b"x\n" * 700, time.monotonic(), 0
        while not self.over.is_set():
            due = int((time.monotonic() - begun) * FLOOD_PER_S)
            for _ in range(min(due - self.sent, 200)):
                out.sendto(junk, ("127.0.0.1", self.feed))
                self.sent += 1
            if time.monotonic() - begun > lines:
                now = time.strftime("%Y-%m-%dT%H:%M:%S", time.gmtime())
                out.sendto(f"IWG1,{now},1,2\r\n".encode(), ("127.0.0.1", self.feed))
                lines += 1
            time.sleep(0.01)

    def walk(self):
        """Follows all links, as a browser that opens each page with its pictures."""
        seen, waiting = set(), ["/"]
        while not self.over.is_set():
            if not waiting:
                seen, waiting = set(), ["/"]
            path = waiting.pop()
            if path in seen or path.startswith(("/tar", "/live/events")):
                continue
            seen.add(path)
            try:
                with urllib.request.urlopen(self.page + path, timeout=60) as answer:
                    body = answer.read()
                    self.count(answer.status)
                    if "html" in answer.headers.get("content-type", ""):
                        links = Links()
                        links.feed(body.decode())
                        found = [urllib.parse.urljoin(path, link) for link in links.found]
                        waiting += [link for link in found if link.startswith("/")]
            except urllib.error.HTTPError as error:
                self.count(error.code)
            except OSError:
                self.count("no answer")
                time.sleep(0.2)

    def watch(self):
        """Reads the events of the live page, and asks again when it is told that others watch."""
        while not self.over.is_set():
            try:
                with urllib.request.urlopen(self.page + "/live/events", timeout=20) as answer:
                    for line in answer:
                        self.events += line.startswith(b"data:")
                        if self.over.is_set():
                            return
            except OSError:
                pass
            time.sleep(5)

    def slow(self):
        """Readers that take 1 kB a second of the largest files."""
        readers = []
        while not self.over.is_set():
            path = self.large_file()
            while path and len(readers) < SLOW_READERS:
                try:
                    one = socket.create_connection(("127.0.0.1", self.port), timeout=5)
                    one.sendall(f"GET {path} HTTP/1.1\r\nHost: localhost\r\n\r\n".encode())
                    one.setblocking(False)
                    readers.append(one)
                except OSError:
                    break
            for one in list(readers):
                try:
                    got = one.recv(1000)
                    self.read += len(got)
                    if not got:
                        raise ConnectionError
                except BlockingIOError:
                    pass
                except OSError:
                    readers.remove(one)
                    one.close()
            time.sleep(1)

    def large_file(self):
        try:
            with urllib.request.urlopen(self.page + "/status.json", timeout=20) as answer:
                state = json.load(answer)
        except (OSError, ValueError):
            return None
        series = state.get("last_series")
        return series and f"/files/{state['flight']}/{series}/0001.jpg"


def process_figures(pid):
    """Memory (bytes) and threads of the recorder with the process of its camera."""
    children = pathlib.Path(f"/proc/{pid}/task").glob("*/children")
    texts = [pathlib.Path(f"/proc/{pid}/status").read_text()]
    for child in {child for file in children for child in file.read_text().split()}:
        try:
            texts.append(pathlib.Path(f"/proc/{child}/status").read_text())
        except OSError:
            pass
    number = lambda text, key: int(re.search(rf"{key}:\s+(\d+)", text + f"{key}: 0").group(1))
    return sum(number(text, "VmRSS") for text in texts) * 1024, sum(number(text, "Threads") for text in texts)


def status(binary, folder):
    asked = subprocess.run([binary, "status", "--json", "--socket", folder / "wingd.sock"], capture_output=True, text=True)
    try:
        return json.loads(asked.stdout)
    except ValueError:
        return None


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--binary", type=pathlib.Path, default=pathlib.Path("target/release/wingd"))
    parser.add_argument("--minutes", type=float, default=30)
    parser.add_argument("--frames", type=pathlib.Path, default=pathlib.Path("fixtures/dev/frames"))
    parser.add_argument("--installation", type=pathlib.Path, default=pathlib.Path("fixtures/dev/installation"))
    parser.add_argument("--log", type=pathlib.Path, help="file for the recorder's log, which is deleted otherwise")
    arguments = parser.parse_args()
    binary = arguments.binary.resolve()
    with tempfile.TemporaryDirectory(prefix="wingd-soak-") as below:
        folder = pathlib.Path(below) / "flight"
        folder.mkdir()
        disk, limits = Disk(folder), Limits()
        try:
            good = soak(arguments, binary, folder, disk, limits)
        finally:
            limits.remove()
            disk.remove()
    sys.exit(0 if good else 1)


def soak(arguments, binary, folder, disk, limits):
    installation = folder / "installation"
    shutil.copytree(arguments.installation, installation)
    if not (installation / "orientation.toml").exists():
        ground = next(arguments.frames.glob("ground*"))
        subprocess.run([binary, "orient", "--installation", installation, ground], check=True, capture_output=True)
    seconds = 60 * arguments.minutes
    camera = VirtualCamera(folder.parent / "camera", arguments.frames)
    page, feed = free_port(socket.SOCK_STREAM), free_port(socket.SOCK_DGRAM)
    (folder / "wingd.toml").write_text(
        CONFIGURATION.format(
            installation=json.dumps(str(installation)), interval=INTERVAL_S, shots=SHOTS, reserve=RESERVE_MB, page=page, feed=feed,
        )
    )
    log = open(arguments.log or folder.parent / "log", "w")
    environment = {**os.environ, "MALLOC_ARENA_MAX": "2", "MALLOC_TRIM_THRESHOLD_": "131072", **camera.environment}
    command = [binary, "run", "--config", folder / "wingd.toml"]
    recorder = subprocess.Popen(command, stderr=log, env=environment, preexec_fn=limits.enter)
    time.sleep(5)
    load = Load(page, feed)
    begun, rss_max, threads_max, last, filled = time.monotonic(), 0, 0, None, False
    while recorder.poll() is None and time.monotonic() - begun < seconds:
        time.sleep(1)
        past = (time.monotonic() - begun) / seconds
        if not filled and past > 0.4:
            disk.fill()
            filled = True
        if past > 0.6:
            disk.empty()
        try:
            rss, threads = process_figures(recorder.pid)
        except (OSError, AttributeError):
            continue
        rss_max, threads_max = max(rss_max, rss), max(threads_max, threads)
        last = status(binary, folder) or last
    alive = recorder.poll() is None
    load.over.set()
    camera.over.set()
    recorder.send_signal(signal.SIGTERM)
    code = recorder.wait(timeout=60)
    log.close()
    verified = subprocess.run([binary, "verify", folder / "store"], capture_output=True, text=True)
    return report(dict(alive=alive, code=code, rss=rss_max, threads=threads_max, group=limits.peak(), hung=camera.hung()), last, load, verified, seconds)


def report(process, last, load, verified, seconds):
    counts, live, aircraft = last["counts"], last["live"], last["aircraft"]
    taken = counts["series_complete"] + counts["series_interrupted"]
    due = int(seconds // INTERVAL_S)
    megabytes = lambda value: "unknown" if value is None else f"{value / 1e6:.0f} MB"
    print(f"ran {seconds / 60:.0f} min; alive {process['alive']}, exit status {process['code']}")
    print(f"memory at most {megabytes(process['rss'])} (group with cache: {megabytes(process['group'])}), threads at most {process['threads']}")
    print(f"series: {taken} taken of {due} due, {counts['series_refused']} refused, {counts['failed_shots']} shots failed, {process['hung']} camera calls hung")
    print(f"live: {live['frames']} frames, {live['results']} results, {live['skipped']} skipped, {live['stored']} stored, {live['dropped']} dropped, median {live['latency_median_ms']} ms")
    print(f"events: {live['events']}, {live['kept_frames']} raw frames kept, {live['lost_frames']} lost")
    print(f"feed: {load.sent} datagrams sent; {aircraft['recorded']} lines recorded, {aircraft['read']} read, {aircraft['lost']} lost")
    print(f"event streams: {load.events} events to {EVENT_STREAMS} browsers")
    print(f"page: answers {load.answers}; slow readers took {load.read / 1e6:.1f} MB")
    print(f"health at the end: {last['health']} {last['reasons']}")
    print(f"store: {verified.stdout.strip().splitlines()[-1]}")
    wrong = [
        text
        for text, good in [
            ("the recorder ended", process["alive"] and process["code"] == 0),
            ("the camera did not hang", process["hung"] > 0),
            ("series are missing", taken >= due - 1 and counts["series_refused"] == 0),
            ("too much memory", process["rss"] < MEMORY_GOAL),
            ("too many threads", process["threads"] < TASKS_MAX),
            ("the store does not verify", verified.returncode == 0),
        ]
        if not good
    ]
    print("FAILED: " + "; ".join(wrong) if wrong else "passed")
    return not wrong


main()
