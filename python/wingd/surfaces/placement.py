"""Position of a surface relative to the wing: refused unless the surveyed markers lie on it; then moved."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import permutations, product
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from wingd import WingdError
from wingd.surfaces.deformation import Array, Deformation
from wingd.surfaces.formats import as_surface
from wingd.surfaces.meshes import import_meshio
from wingd.surfaces.model import UNITS, IntArray, Surface
from wingd.textfiles import fault

#: Median distance of the surveyed markers from the surface over the length of the axis, above which it is refused. The
#: right surface of a wing of 33 m has 0.19 m, one in other axes or another unit 19 m.
MAX_MARKER_FRACTION = 0.02
#: Fewest markers within the span of the surface that decide.
MIN_MARKERS = 3
#: Distance from the axis over its length beyond which a node belongs to another part: no node is a chord from it.
FAR_FRACTION = 0.4
#: Arc length over the length of the axis beyond which a node belongs to another part: winglets end at 1.1.
END_FRACTION = 1.25
#: Largest number of triangles or nodes that are tried in other units and axes.
_TRIED = 4000
#: Pairs of points and triangles that are compared at once, which bounds the memory.
_PAIRS = 2_000_000
#: Largest number of sampled surfaces.
MAX_DRAWS = 1000


@dataclass(frozen=True, repr=False)
class Moved:
    """Surface in flight.

    Attributes
    ----------
    surface
        Surface as in its file.
    points
        Nodes in flight, in the unit and the axes of the file, shape (nodes, 3).
    displacement_m, sigma_m
        Displacement and its standard deviation, m, axes of the file, shape (nodes, 3); sigma is NaN inboard of the root.
    arc_m
        Arc length of the section of each node, m, shape (nodes,).
    marker_distance_m
        Median distance of the surveyed markers from the surface, m.
    draws
        Sampled surfaces, each with one error of every source.
    notes
        Remarks on nodes whose motion is less certain than it looks.
    folded
        Number of facets that the motion turns over.
    """

    surface: Surface
    points: Array
    displacement_m: Array
    sigma_m: Array
    arc_m: Array
    marker_distance_m: float
    draws: tuple[Moved, ...] = field(default=(), repr=False)
    notes: tuple[str, ...] = ()
    folded: int = 0

    def __repr__(self) -> str:
        length = np.linalg.norm(self.displacement_m, axis=1)
        lines = [f"<wingd.Moved {self.surface.file}: {len(length)} nodes, moved by at most {length.max():.3f} m>"]
        return "\n".join([*lines, *self.notes])

    def to_meshio(self) -> Any:
        """Return a mesh of meshio with ``displacement_m`` and ``sigma_displacement_m`` at its points."""
        triangles, count = self.surface.triangles, len(self.points)
        cells = [("triangle", triangles)] if len(triangles) else [("vertex", np.arange(count)[:, None])]
        data = {"displacement_m": self.displacement_m, "sigma_displacement_m": self.sigma_m}
        data |= {} if self.surface.ids is None else {"id": self.surface.ids}
        return import_meshio().Mesh(self.points, cells, point_data=data)

    @property
    def mesh(self) -> Any:
        """Mesh or array as it was given, with moved points; of a file, a mesh of meshio."""
        given = self.surface.mesh
        if given is None:
            return self.to_meshio()
        if isinstance(given, np.ndarray) or not hasattr(given, "points"):
            return self.points
        moved = given.copy()
        moved.points = self.points
        return moved


class Target:
    """Surface to which distances are measured: its facets, or its nodes if it has none.

    Parameters
    ----------
    nodes, triangles
        Nodes, shape (nodes, 3), and corners of the facets, shape (triangles, 3).
    """

    def __init__(self, nodes: Array, triangles: IntArray) -> None:
        self.nodes = nodes[np.unique(triangles)] if len(triangles) else nodes
        self.tree = cKDTree(self.nodes)
        self.corners = nodes[triangles]
        self.centre = self.corners.mean(axis=1) if len(triangles) else self.nodes[:0]
        self.radius = np.linalg.norm(self.corners - self.centre[:, None], axis=2).max(axis=1, initial=0)
        #: Median distance of neighbouring nodes in a list without facets, else 0.
        self.gap = 0.0
        if not len(triangles) and len(nodes) > 1:
            some = self.nodes[:: max(1, len(nodes) // _TRIED)]
            self.gap = float(np.median(self.tree.query(some, k=2)[0][:, 1]))

    def distance(self, points: Array) -> Array:
        """Return the distances of points, shape (points,)."""
        out = np.asarray(self.tree.query(points)[0], float)
        step = max(1, _PAIRS // max(len(self.centre), 1))
        for begin in range(0, len(points) if len(self.corners) else 0, step):
            some = points[begin : begin + step]
            away = np.linalg.norm(self.centre - some[:, None], axis=2)
            which, near = np.nonzero(away - self.radius <= out[begin : begin + step, None])
            distances = _triangle_distances(some[which], self.corners[near])
            np.minimum.at(out, begin + which, distances)
        return out

    def median_distance(self, markers: Array, limit: float) -> tuple[float, bool]:
        """Return the median distance of the markers beside the surface, and whether they lie on it, within a limit.

        A surface may be a part of the wing: markers beyond its ends along its longest side do not count. In a list of
        nodes, gaps between the nodes add to the limit.
        """
        limit += self.gap
        low, high = self.nodes.min(axis=0) - limit, self.nodes.max(axis=0) + limit
        along = int(np.argmax(high - low))
        beside = markers[(markers[:, along] >= low[along]) & (markers[:, along] <= high[along])]
        is_enough = len(beside) >= MIN_MARKERS
        beside = beside if is_enough else markers
        nearest = float(np.median(self.tree.query(beside)[0]))
        if nearest - 2 * self.radius.max(initial=0) > limit:
            return nearest, False
        median = float(np.median(self.distance(beside)))
        return median, is_enough and median <= limit


def _triangle_distances(points: Array, corners: Array) -> Array:
    """Return the distance of each point from its triangle, shape (points,); corners have the shape (points, 3, 3)."""
    best = np.full(len(corners), np.inf)
    for k in range(3):
        start, edge = corners[:, k], corners[:, (k + 1) % 3] - corners[:, k]
        length2 = np.maximum(np.einsum("ti,ti->t", edge, edge), 1e-300)
        t = np.clip(np.einsum("ti,ti->t", points - start, edge) / length2, 0, 1)
        best = np.minimum(best, np.linalg.norm(start + edge * t[:, None] - points, axis=1))
    a, b, c = corners.transpose(1, 0, 2)
    normal = np.cross(b - a, c - a)
    norm = np.linalg.norm(normal, axis=1)
    unit = normal / np.maximum(norm, 1e-300)[:, None]
    height = np.einsum("ti,ti->t", points - a, unit)
    foot = points - unit * height[:, None]
    sides = [np.einsum("ti,ti->t", np.cross(q - p, foot - p), unit) for p, q in ((a, b), (b, c), (c, a))]
    inside = (np.min(sides, axis=0) >= 0) & (norm > 0)
    return np.where(inside, np.minimum(best, np.abs(height)), best)


def _cad_transform(shape: xr.Dataset) -> tuple[float, Rotation, Array] | None:
    """Return scale, rotation and translation (m) of the CAD axes from the survey."""
    if "cad_from_survey" not in shape:
        return None
    matrix = shape["cad_from_survey"].values
    scale = float(np.cbrt(np.linalg.det(matrix[:3, :3])))
    return scale, Rotation.from_matrix(matrix[:3, :3] / scale), matrix[:3, 3]


def check_placement(surface: Surface, shape: xr.Dataset, axes: str = "survey") -> float:
    """Check that the surveyed markers lie on a surface.

    Parameters
    ----------
    surface
        Surface, in its unit.
    shape
        Exported shape with ``marker_ground_position`` (m, survey axes).
    axes
        Axes of the surface: ``survey`` or ``cad``.

    Returns
    -------
    float
        Median distance of the markers from the surface, m.

    Raises
    ------
    WingdError
        The markers do not lie on the surface; names the axes and the unit in which they would.
    """
    if "marker_ground_position" not in shape:
        raise WingdError("the shape has no marker_ground_position; write it with `wingd export --table shape`")
    cad = _cad_transform(shape)
    if axes == "cad" and cad is None:
        raise WingdError("the installation has no [cad]; give cad.tie_points, or the surface in the axes of the survey")
    markers = {"survey": shape["marker_ground_position"].values}
    if cad is not None:
        scale, rotation, translation = cad
        markers["cad"] = scale * rotation.apply(markers["survey"]) + translation
    limit = MAX_MARKER_FRACTION * float(shape["arc_length"].values[-1])
    target = Target(surface.metres, surface.triangles)
    distance, fits = target.median_distance(markers[axes], limit)
    if fits:
        return distance
    problem = (
        f"the surveyed markers are {distance:.3g} m from the surface (median), not within {limit + target.gap:.2g} m"
    )
    raise fault(surface.file, problem, _find_remedy(surface, markers, axes, limit))


def _find_remedy(surface: Surface, markers: dict[str, Array], axes: str, limit_m: float) -> str:
    """Name the axes and the unit in which the markers lie on the surface."""
    triangles = surface.triangles[:: -(-len(surface.triangles) // _TRIED) or 1]
    step = 1 if len(triangles) else -(-len(surface.points) // _TRIED)
    target, found = Target(surface.points[::step], triangles), []
    turns = [(order, signs) for order in permutations(range(3)) for signs in product((1, -1), repeat=3)]
    for unit, metres in UNITS.items():
        # Distances in the unit of the file: the target is made once.
        tried = [(name, "", own) for name, own in markers.items()]
        for order, signs in turns[1:]:
            text = ", ".join(f"{'-' if s < 0 else ''}{'xyz'[k]}" for k, s in zip(order, signs, strict=True))
            tried.append(("survey", text, markers["survey"][:, order] * signs))
        for name, text, own in tried:
            # A few markers show most wrong axes.
            if target.median_distance(own[::6] / metres, limit_m / metres)[0] * metres > 3 * (
                limit_m + target.gap * metres
            ):
                continue
            distance, fits = target.median_distance(own / metres, limit_m / metres)
            if fits:
                found.append((bool(text), distance * metres, name, unit, text))
    if not found:
        return "give the surface of the measured wing in the axes of the survey, or of the CAD model with --axes cad"
    _, _, name, unit, turned = min(found)
    remedies = []
    if unit != surface.unit:
        # A list of nodes has its unit in its header.
        own = (
            f"write x_{unit},y_{unit},z_{unit} in its header"
            if Path(surface.file).suffix.lower() == ".csv"
            else f"add --unit {unit}"
        )
        remedies.append(f"its coordinates are in {unit}, not {surface.unit}: {own}")
    if turned:
        remedies.append(f"its axes are {turned} of the survey: turn it, or give cad.tie_points and --axes cad")
    elif name != axes:
        remedies.append(f"its axes are those of the {'CAD model' if name == 'cad' else 'survey'}: use --axes {name}")
    return "; ".join(remedies)


def deform(
    shape: xr.Dataset,
    mesh: Any,
    frame: str | None = None,
    axes: str = "survey",
    unit: str | None = None,
    thermal: bool = True,
    draws: int = 0,
    seed: int = 1,
) -> Moved:
    """Move a surface by the measured shape of the wing.

    Parameters
    ----------
    shape
        Shape of a store or an exported file (``wingd export --table shape``).
    mesh
        File, mesh of meshio or pyvista, array of points (nodes, 3), or result of :func:`read_surface`.
    frame
        Frame, such as ``s000001/0001.jpg``; default the mean over the frames.
    axes
        Axes of the surface: ``survey``, or ``cad`` by the tie points of the installation.
    unit
        Unit of the coordinates, default m.
    thermal
        False moves the wing without its contraction by temperature.
    draws
        Number of sampled surfaces, each with one error of every source.
    seed
        Seed of the samples.

    Returns
    -------
    Moved
        Nodes in flight with standard deviations.

    Raises
    ------
    WingdError
        The surveyed markers do not lie on the surface, or the shape is not usable.
    """
    if axes not in ("survey", "cad"):
        raise WingdError(f"axes {axes!r} are not known; give survey or cad")
    if not 0 <= draws <= MAX_DRAWS:
        raise WingdError(f"draws = {draws} is not between 0 and {MAX_DRAWS}; sample fewer surfaces")
    surface = as_surface(mesh, unit)
    marker_distance_m = check_placement(surface, shape, axes)
    wing = Deformation.from_dataset(shape, frame, thermal)
    cad = _cad_transform(shape) if axes == "cad" else None
    ground = surface.metres
    scale, rotation, translation = cad or (1.0, Rotation.identity(), np.zeros(3))
    in_survey = rotation.inv().apply(ground - translation) / scale
    arc, away = wing.find_feet(in_survey)

    def moved_by(one: Deformation, with_sigma: bool) -> Moved:
        moved, sigma = one.move(in_survey, with_sigma, rotation.as_matrix())
        displacement = scale * rotation.apply(moved)
        points = surface.points + displacement / UNITS[surface.unit]
        return Moved(surface, points, displacement, scale * sigma, arc, marker_distance_m)

    mean = moved_by(wing, True)
    random = np.random.default_rng(seed)
    sampled = tuple(moved_by(wing.sample(random), False) for _ in range(draws))
    far = (arc > 0) & ((away > FAR_FRACTION * wing.length_m) | (arc > END_FRACTION * wing.length_m))
    outermost = wing.find_feet(shape["marker_ground_position"].values)[0].max()
    beyond = ~far & (arc > outermost + 1e-3)
    notes = list(surface.notes)
    if beyond.any():
        notes.append(
            f"{beyond.sum()} of {len(arc)} nodes are beyond the outermost marker: their motion is extrapolated"
        )
    if far.any():
        notes.append(
            f"{far.sum()} of {len(arc)} nodes are farther from the bending axis than any chord, but moved with its "
            "sections: give the wing without other parts"
        )
    folded = _count_folded(surface.points, mean.points, surface.triangles)
    if folded:
        notes.append(f"{folded} facets are turned over: the surface cannot be used there")
    if not (arc > 0).any():
        raise fault(surface.file, "has no node outboard of the bending root", "give the surface of the wing")
    return Moved(
        surface, mean.points, mean.displacement_m, mean.sigma_m, arc, marker_distance_m, sampled, tuple(notes), folded
    )


def _count_folded(before: Array, after: Array, triangles: IntArray) -> int:
    def normal(points: Array) -> Array:
        a, b, c = points[triangles].transpose(1, 0, 2)
        return np.cross(b - a, c - a)

    if not len(triangles):
        return 0
    return int((np.einsum("ti,ti->t", normal(before), normal(after)) < 0).sum())
