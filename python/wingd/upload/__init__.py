"""Upload of flights to an object store, S3 or a directory: create-only, resumable, an inventory first.

Each flight is verified by ``wingd verify`` and announced by its manifest; results of all flights follow, then frames. A completion
object, written last, shows that a stage is complete, and readers use completed stages alone. An interrupted upload continues with
the missing objects.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from dataclasses import dataclass, field
from pathlib import Path

from .. import WingdError
from . import bundle as _bundle
from .bundle import StoreError
from .manifest import STAGES, Labels, Manifest, Object
from .pace import Pace
from .target import Failed, Target

__all__ = ["Counts", "Labels", "Outcome", "StoreError", "Target", "upload_flights"]


@dataclass
class Counts:
    """Objects of an uploaded flight.

    Attributes
    ----------
    objects, bytes
        All objects, with manifest and completion objects, and their length.
    sent, sent_bytes
        Those put by this call.
    repaired
        Those that replaced damaged ones.
    expired
        Frames that had arrived and were deleted by a rule of the bucket.
    """

    objects: int = 0
    bytes: int = 0
    sent: int = 0
    sent_bytes: int = 0
    repaired: int = 0
    expired: int = 0

    def add(self, length: int, *, sent: bool) -> None:
        """Count an object of `length` bytes."""
        self.objects += 1
        self.bytes += length
        self.sent += sent
        self.sent_bytes += length if sent else 0


@dataclass
class Outcome:
    """What became of a flight: `manifest` and `counts`, or `error`."""

    flight: str
    counts: Counts = field(default_factory=Counts)
    manifest: Manifest | None = None
    error: WingdError | None = None


@dataclass
class _Flight:
    """A flight whose manifest is published."""

    manifest: Manifest
    objects: list[Object]
    outcome: Outcome


class _Stopped(WingdError):
    """Another flight met an error that concerns all."""

    def __init__(self) -> None:
        super().__init__("was not tried; run the command again to continue")


def upload_flights(
    root: Path,
    flights: list[str],
    target: Target,
    labels: Labels | None = None,
    *,
    repair: bool = False,
    progress: Callable[[int], None] = lambda length: None,
) -> list[Outcome]:
    """Upload flights of a store, stage by stage.

    Parameters
    ----------
    root
        The store.
    flights
        Names of flights in it, as from :func:`wingd.upload.bundle.flights`.
    target
        Where they go.
    labels
        Aircraft and wing.
    repair
        Replace objects that were changed or damaged at the target, and restore missing ones.
    progress
        Receives the length of each object that is there, bytes.

    Returns
    -------
    list of Outcome
        One for each flight, in order.
    """
    upload = _Upload(root, target, labels or Labels(), repair, progress)
    outcomes = [Outcome(name) for name in flights]
    published: list[_Flight] = []

    def attempt(outcome: Outcome, work: Callable[[], None]) -> None:
        if any(isinstance(one.error, Failed) for one in outcomes):
            outcome.error = _Stopped()
            return
        try:
            work()
        except WingdError as error:
            outcome.error = error

    with ThreadPoolExecutor(target.jobs) as pool:
        upload.pool = pool
        for outcome in outcomes:
            attempt(outcome, lambda outcome=outcome: published.append(upload.announce(outcome)))
        for stage in STAGES:
            for flight in published:
                if flight.outcome.error is None:
                    attempt(flight.outcome, lambda flight=flight, stage=stage: upload.send_stage(flight, stage))
    return outcomes


class _Upload:
    """Upload of flights of one store to a target."""

    pool: ThreadPoolExecutor

    def __init__(self, root: Path, target: Target, labels: Labels, repair: bool, progress: Callable[[int], None]):
        self.root, self.target, self.labels, self.repair, self.progress = root, target, labels, repair, progress
        self.pace = Pace(target.jobs, time.monotonic())
        self.reached = False

    def announce(self, outcome: Outcome) -> _Flight:
        """Verify a flight and publish its manifest, so that it is known before its data arrive."""
        if not self.reached:
            # Before reading gigabytes.
            self.target.sizes(f"manifests/recorder={_bundle.store_id(self.root)}")
            self.reached = True
        _bundle.verify(self.root, outcome.flight)
        bundle = _bundle.bundle(self.root, outcome.flight)
        manifest, counts = Manifest.of(bundle, self.labels), outcome.counts
        there = self.target.get(manifest.key)
        if there is not None:
            known = Manifest.parse(there)
            if known is not None:
                manifest = self._agreed(manifest, known)
            elif not self.repair:
                raise self._different(manifest.key)
        text = manifest.text
        if there is None:
            self._create(manifest.key, text, counts)
        elif there == text:
            counts.add(len(text), sent=False)
        else:
            self._replace(manifest.key, text, counts)
        outcome.manifest = manifest
        return _Flight(manifest, manifest.objects(bundle), outcome)

    def _agreed(self, manifest: Manifest, there: Manifest) -> Manifest:
        """Return the manifest with the labels of the published one, which must describe the same state of the flight."""
        agreed = manifest.labelled(there, self.labels)
        if agreed is None:
            aircraft, kind, wing = (there.fields.get(key) or "none" for key in ("aircraft", "aircraft_type", "wing"))
            raise WingdError(
                f"{self.target.shown(manifest.key)}: already published as aircraft {aircraft}, type {kind}, wing {wing}; "
                "upload cannot change the aircraft. Use `wingd-fleet correct`, or omit the options"
            )
        if agreed != there:
            raise self._different(manifest.key)
        return agreed

    def send_stage(self, flight: _Flight, stage: str) -> None:
        """Send all objects of a stage, then the object that shows that it is complete."""
        target, counts = self.target, flight.outcome.counts
        there = self._sizes(flight)
        own = {one.key for one in flight.objects}
        if foreign := sorted(set(there) - own):
            raise WingdError(
                f"{target.shown(foreign[0])}: is not a file of this flight; move it away, or upload below another prefix"
            )
        objects = [one for one in flight.objects if one.stage == stage]
        self._compare([one for one in objects if one.key in there], there, counts)
        missing = [one for one in objects if one.key not in there]
        key, text = flight.manifest.completion(stage)
        # Frames that had arrived and are missing were deleted by a rule of the bucket.
        if stage == "frames" and missing and not self.repair and target.get(key) is not None:
            counts.expired, missing = len(missing), []
        if missing:
            self._send(missing, counts)
            now = self._sizes(flight)
            for one in objects:
                if now.get(one.key) != one.length:
                    raise Failed(
                        f"{target.shown(one.key)}: was uploaded, but is not there with its length; run the command again"
                    )
        self._create(key, text, counts)

    def _sizes(self, flight: _Flight) -> dict[str, int]:
        found: dict[str, int] = {}
        for prefix in flight.manifest.prefixes():
            found |= self.target.sizes(prefix)
        return found

    def _compare(self, objects: list[Object], there: dict[str, int], counts: Counts) -> None:
        """Compare existing objects with the flight's digests; a difference is an error, or is repaired."""

        def same(one: Object) -> bool:
            return there[one.key] == one.length and self.target.has(one.key, one.length, one.sha256)

        for one, equal in zip(objects, self.pool.map(same, objects), strict=True):
            if equal:
                counts.add(one.length, sent=False)
            elif self.repair:
                self._replace(one.key, one.read(), counts)
            else:
                raise self._different(one.key)
            self.progress(one.length)

    def _send(self, objects: list[Object], counts: Counts) -> None:
        """Send missing objects, as many at a time as the measured rate permits."""
        waiting, running = list(reversed(objects)), dict[Future, Object]()
        try:
            while waiting or running:
                while waiting and len(running) < self.pace.concurrent(waiting[-1].length):
                    one = waiting.pop()
                    running[self.pool.submit(self._put, one)] = one
                for done in wait(running, return_when=FIRST_COMPLETED).done:
                    one = running.pop(done)
                    sent = done.result()
                    self.pace.record(one.length, time.monotonic())
                    counts.add(one.length, sent=sent)
                    self.progress(one.length)
        finally:
            for future in running:
                future.cancel()

    def _put(self, one: Object) -> bool:
        sent = self.target.create(one.key, one.read())
        if sent is None:
            raise self._different(one.key)
        return sent

    def _create(self, key: str, text: bytes, counts: Counts) -> None:
        """Create a record, which `repair` replaces if it is damaged."""
        sent = self.target.create(key, text)
        if sent is not None:
            counts.add(len(text), sent=sent)
        elif self.repair:
            self._replace(key, text, counts)
        else:
            raise self._different(key)

    def _replace(self, key: str, data: bytes, counts: Counts) -> None:
        self.target.replace(key, data)
        counts.add(len(data), sent=True)
        counts.repaired += 1

    def _different(self, key: str) -> WingdError:
        return WingdError(
            f"{self.target.shown(key)}: already exists with different content and is not overwritten; a published flight "
            "does not change: publish later results as tables (docs/fleet.md), and another state of the flight below another "
            "prefix; if the object was changed or damaged there, `--repair` restores it"
        )
