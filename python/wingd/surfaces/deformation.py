"""Deformation of a wing: the rigid motion of its sections, applied to points.

Sections are normal to the bending axis on the ground. With the axis ``c(s)``, its displacement ``d(s)``, the rotation
``R(s)`` of the section and the thermal scale ``k``, the point ``p`` of the section at ``s`` moves to
``c(s) + d(s) + k R(s) (p - c(s))``. Between the given sections ``c``, ``d`` and the rotation vector are cubic with
continuous slopes. Inboard of the root nothing moves; outboard of it the motion rises with a weight from 0 to 1, with
slope and curvature 0 at both ends. Points beyond the last section move rigidly with it.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from scipy.interpolate import CubicHermiteSpline
from scipy.spatial.transform import Rotation

from wingd import WingdError
from wingd.values import FRAME, STATION
from wingd.values import _joint as joint_covariance

Array = np.ndarray[Any, np.dtype[np.float64]]

#: Fraction of the axis over which the motion rises from the root: without it a root that moves by 3 mm and 1 mrad within
#: its priors would tear a surface of 4 m chord by 5 mm.
BLEND_FRACTION = 0.05
#: Fewest stations of a shape that moves a surface: between them the motion is interpolated.
MIN_SECTIONS = 20
#: Largest rotation of a section, rad.
MAX_ROTATION_RAD = 1.5
_FOOT_TOLERANCE_M = 1e-10
_FOOT_STEPS = 40
#: Points that are moved at once, which bounds the memory.
_CHUNK = 5000


def _length(points: Array) -> Array:
    return np.linalg.norm(np.diff(points, axis=-2), axis=-1).sum(axis=-1)


class Deformation:
    """Motion of a wing between ground and flight, in the axes of its sections.

    Parameters
    ----------
    arc_m
        Arc length of each section from the bending root along the axis on the ground, m; shape (n,), the first 0.
    ground_m, displacement_m, rotation
        Point of the bending axis on the ground (m), its displacement (m), rotation vector of the section (rad);
        shape (n, 3).
    factor
        Factor of the covariance of displacement and rotation, shape (n, 6, sources); None: unknown.
    thermal
        False moves the wing with its length on the ground.

    Raises
    ------
    WingdError
        The sections describe no deformation.
    """

    def __init__(
        self,
        arc_m: Array,
        ground_m: Array,
        displacement_m: Array,
        rotation: Array,
        factor: Array | None = None,
        thermal: bool = True,
    ) -> None:
        arc_m, ground_m, rotation = (np.asarray(v, float) for v in (arc_m, ground_m, rotation))
        displacement_m = np.asarray(displacement_m, float)
        if len(arc_m) < 2:
            raise WingdError(f"{len(arc_m)} sections describe no deformation; at least 2 are needed")
        if abs(arc_m[0]) > 1e-9:
            raise WingdError(f"the first section is {arc_m[0]} m from the bending root; begin with the root")
        finite = np.isfinite(np.hstack([arc_m[:, None], ground_m, displacement_m, rotation])).all(axis=1)
        implausible = ~finite | (np.linalg.norm(rotation, axis=1) >= MAX_ROTATION_RAD)
        if implausible.any():
            raise WingdError(f"the pose of the section at {arc_m[implausible][0]} m is not plausible; export it again")
        step = np.diff(arc_m)
        wrong = (step <= 0) | (np.linalg.norm(np.diff(ground_m, axis=0), axis=1) <= 0.5 * step)
        if wrong.any():
            raise WingdError(
                f"the section at {arc_m[1:][wrong][0]} m does not lie outboard of the one before it; export it again"
            )
        on_ground = _length(ground_m)
        flight = ground_m + displacement_m
        tangents = np.diff(flight, axis=0)
        tangents /= np.linalg.norm(tangents, axis=1)[:, None]
        self.scale = float(_length(flight) / on_ground)
        self._scale_factor: Array = np.zeros(0)
        if factor is not None:
            factor = np.array(factor, float)
            self._scale_factor = np.einsum("ni,nic->c", tangents, np.diff(factor[:, :3], axis=0)) / on_ground
        if not thermal:
            away = (flight - flight[0]) / self.scale
            displacement_m = flight[0] + away - ground_m
            if factor is not None:
                moved = factor[:, :3]
                by_scale = away[:, :, None] * (self._scale_factor / self.scale)
                factor[:, :3] = moved[:1] + (moved - moved[:1]) / self.scale - by_scale
                self._scale_factor = np.zeros_like(self._scale_factor)
            self.scale = float(_length(ground_m + displacement_m) / on_ground)
        self.arc_m, self.factor = arc_m, factor
        self._values = np.hstack([ground_m, displacement_m, rotation])
        # Slopes of the parabola through each section and its neighbours.
        by_value = np.gradient(np.eye(len(arc_m)), arc_m, axis=0, edge_order=min(len(arc_m) - 1, 2))
        self._slopes = by_value @ self._values
        self._curve = CubicHermiteSpline(arc_m, self._values, self._slopes)
        self._weights = CubicHermiteSpline(arc_m, np.eye(len(arc_m)), by_value)

    @classmethod
    def from_dataset(cls, shape: xr.Dataset, frame: str | None = None, thermal: bool = True) -> Deformation:
        """Create the deformation of a frame, or of the mean over the frames.

        Errors that the frames share do not become smaller by averaging.

        Raises
        ------
        WingdError
            The frame does not exist, the shape has no poses, or the common errors of its frames are unknown.
        """
        missing = [name for name in ("ground_position", "displacement", "rotation", "arc_length") if name not in shape]
        if missing or STATION not in shape.dims:
            what = missing[0] if missing else f"dimension {STATION}"
            raise WingdError(
                f"the shape has no {what}; open a store or a file of `wingd export --table shape` with wingd.open"
            )
        if shape.sizes[STATION] < MIN_SECTIONS:
            raise WingdError(
                f"the shape has {shape.sizes[STATION]} stations, too few to move a surface; export it without --eta"
            )
        names = frame_names(shape)
        if frame is not None and frame not in names:
            raise WingdError(f"there is no frame {frame}; available: {', '.join(names)}")
        if FRAME in shape.dims:
            shape = shape.wingd.mean() if frame is None else shape.isel(frame=names.index(frame))
        parts = [shape.wingd.values(name).transpose(STATION, "axis") for name in ("displacement", "rotation")]
        if not np.isfinite(parts[0].value.values).all():
            raise WingdError(f"{frame or 'the frame'} has no shape; choose another frame")
        values, covariance = joint_covariance(parts)
        n = shape.sizes[STATION]
        variances, vectors = np.linalg.eigh(covariance)
        kept = variances > 1e-16 * variances[-1]
        factor = (vectors[:, kept] * np.sqrt(variances[kept])).reshape(2, n, 3, -1)
        displacement, rotation = values.reshape(2, n, 3)
        ground = shape["ground_position"].transpose(STATION, "axis").values
        joined = np.concatenate(list(factor), axis=1)
        return cls(shape["arc_length"].values, ground, displacement, rotation, joined, thermal)

    @property
    def length_m(self) -> float:
        """Arc length of the last section, m."""
        return float(self.arc_m[-1])

    def sample(self, random: np.random.Generator) -> Deformation:
        """Return a whole wing with one error of every source."""
        if self.factor is None:
            raise WingdError("the shape has no factors of its covariance; export it with `--table shape`")
        return self.with_errors(random.standard_normal(self.factor.shape[2]))

    def with_errors(self, errors: Array) -> Deformation:
        """Return the wing with these errors of its sources, in standard deviations; shape (sources,)."""
        assert self.factor is not None
        moved = self.factor @ errors
        ground, displacement, rotation = np.split(self._values, 3, axis=1)
        return Deformation(self.arc_m, ground, displacement + moved[:, :3], rotation + moved[:, 3:])

    def find_feet(self, points_m: Array) -> tuple[Array, Array]:
        """Find the section through each point.

        Parameters
        ----------
        points_m
            Points on the ground, m; shape (points, 3).

        Returns
        -------
        tuple
            Arc length of the section (m; negative inboard of the root, above the length beyond the last section) and
            distance from the axis (m), which continues straight beyond its ends; shape (points,) each.
        """
        parts = [self._find_feet(p) for p in _chunks(points_m)]
        return np.concatenate([p[0] for p in parts]), np.concatenate([p[1] for p in parts])

    def _find_feet(self, points: Array) -> tuple[Array, Array]:
        tangents = _unit(self._slopes[:, :3])
        outboard = points @ tangents.T - np.einsum("ki,ki->k", self._values[:, :3], tangents)
        passed = outboard > 0
        inboard = np.where(passed.all(axis=1), len(self.arc_m), np.argmin(passed, axis=1))
        low = np.maximum(inboard, 1) - 1
        high = np.minimum(inboard, len(self.arc_m) - 1)
        arc, values, slopes = self.arc_m[low].copy(), self._values[low].copy(), self._slopes[low].copy()
        active = np.flatnonzero(low != high)
        for _ in range(_FOOT_STEPS):
            tangent = slopes[active, :3]
            norm = np.linalg.norm(tangent, axis=1)
            ahead = np.einsum("pi,pi->p", points[active] - values[active, :3], tangent) / norm**2
            moved = np.clip(arc[active] + ahead, self.arc_m[low[active]], self.arc_m[high[active]])
            goes_on = np.abs(moved - arc[active]) >= _FOOT_TOLERANCE_M
            active, moved = active[goes_on], moved[goes_on]
            if not len(active):
                break
            arc[active] = moved
            values[active], slopes[active] = self._curve(moved), self._curve(moved, 1)
        tangent = _unit(slopes[:, :3])
        arm = points - values[:, :3]
        beyond = np.where(low == high, np.einsum("pi,pi->p", arm, tangent), 0.0)
        return arc + beyond, np.linalg.norm(arm - tangent * beyond[:, None], axis=1)

    def move(self, points_m: Array, with_sigma: bool = False, axes: Array | None = None) -> tuple[Array, Array]:
        """Move points from the ground to flight.

        Parameters
        ----------
        points_m
            Points on the ground, m; shape (points, 3).
        with_sigma
            Propagate the covariance of the sections.
        axes
            Rotation matrix of the axes of the standard deviations, shape (3, 3); default those of the sections.

        Returns
        -------
        tuple
            Displacements, m, and their standard deviations, m; shape (points, 3) each. The deviations are NaN without
            a factor, and inboard of the root, where nothing moves.
        """
        axes = np.eye(3) if axes is None else axes
        parts = [self._move(p, with_sigma and self.factor is not None, axes) for p in _chunks(points_m)]
        return np.concatenate([p[0] for p in parts]), np.concatenate([p[1] for p in parts])

    def _move(self, points: Array, with_sigma: bool, axes: Array) -> tuple[Array, Array]:
        moved, sigma = np.zeros_like(points), np.full_like(points, np.nan)
        arc, _ = self._find_feet(points)
        outboard = np.flatnonzero(arc > 0)
        if not len(outboard):
            return moved, sigma
        points, arc = points[outboard], arc[outboard]
        weight = _blend_weight(arc / (BLEND_FRACTION * self.length_m))[:, None]
        at = np.minimum(arc, self.length_m)
        values = self._curve(at)
        arm = points - values[:, :3]
        turn = values[:, 6:] * weight
        turned = Rotation.from_rotvec(turn).apply(arm)
        grown = 1 + (self.scale - 1) * weight
        moved[outboard] = values[:, :3] + values[:, 3:6] * weight + turned * grown - points
        if with_sigma and self.factor is not None:
            n, _, sources = self.factor.shape
            of_axis = (self._weights(at) @ self.factor.reshape(n, -1)).reshape(len(at), 6, sources)
            # Left Jacobian of the rotation: turned + d(turned) = turned + (J dturn) x turned.
            rotated = np.einsum("pij,pjc->pic", _left_jacobian(turn), of_axis[:, 3:])
            by_turn = np.cross(rotated, (turned * grown)[:, :, None], axis=1)
            errors = of_axis[:, :3] + by_turn + turned[:, :, None] * self._scale_factor
            sigma[outboard] = np.linalg.norm(axes @ errors, axis=2) * weight
        return moved, sigma


def frame_names(shape: xr.Dataset) -> list[str]:
    """Return the names of a shape's frames, such as ``s000001/0001.jpg``; none of a mean."""
    return [str(name) for name in np.ravel(shape["image"].values)] if "image" in shape.variables else []


def _chunks(points: Array) -> list[Array]:
    points = np.asarray(points, float)
    return [points[k : k + _CHUNK] for k in range(0, max(len(points), 1), _CHUNK)]


def _unit(vectors: Array) -> Array:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def _blend_weight(fraction: Array) -> Array:
    x = np.clip(fraction, 0, 1)
    return x**3 * (10 + x * (6 * x - 15))


def _left_jacobian(turn: Array) -> Array:
    """Return the left Jacobian of rotation vectors; shape (points, 3, 3)."""
    angle = np.linalg.norm(turn, axis=1)[:, None, None]
    small = angle < 1e-4
    safe = np.where(small, 1.0, angle)
    first = np.where(small, 0.5 - angle**2 / 24, (1 - np.cos(safe)) / safe**2)
    second = np.where(small, 1 / 6 - angle**2 / 120, (safe - np.sin(safe)) / safe**3)
    cross = np.zeros((len(turn), 3, 3))
    x, y, z = turn.T
    cross[:, 0, 1], cross[:, 0, 2], cross[:, 1, 2] = -z, y, -x
    cross -= cross.transpose(0, 2, 1)
    return np.eye(3) + first * cross + second * (cross @ cross)
