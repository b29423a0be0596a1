"""Synthetic exports of format 2 with sampled errors of known covariance."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import xarray as xr

KINDS = {"lasting": 6, "shared": 5, "own": 4}
#: Size of the errors of each kind at the tip, m.
SIZES = {"lasting": 0.008, "shared": 0.004, "own": 0.002}
QUANTITIES = ("displacement", "slope", "twist")


@dataclass
class Wing:
    """A wing with its installation: stations, and factors as smooth functions of the arc length."""

    name: str = "L1"
    side: str = "left"
    length_m: float = 30.0
    outermost_m: float = 29.0
    root_error_m: float = 0.0
    stations: int = 21
    seed: int = 1
    recorder: str = "R1"
    lasting: dict = field(default_factory=dict)

    @property
    def arc(self) -> np.ndarray:
        return np.linspace(0.0, self.length_m, self.stations)


def bend(arc: np.ndarray, tip_m: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return displacement, slope and twist of the true wing of 30 m at places from its root."""
    x = arc / 30.0
    return tip_m * (1.5 * x**2 - 0.5 * x**3), tip_m / 30 * (3 * x - 1.5 * x**2), 0.01 * tip_m * x


def _factors(rng: np.random.Generator, arc: np.ndarray, sources: int, size: float) -> dict[str, np.ndarray]:
    """Return factors of displacement z, slope and twist that belong to one smooth curve."""
    x = arc / 30.0
    powers = np.arange(2, 2 + sources)
    weights = rng.normal(size=(sources, sources)) * 0.6 ** np.arange(sources) / np.sqrt(sources)
    z = size * (x[:, None] ** powers) @ weights
    slope = size / 30 * (powers * x[:, None] ** (powers - 1)) @ weights
    twist = (
        0.1 * size * (x[:, None] ** np.arange(1, 1 + sources)) @ rng.normal(size=(sources, sources)) / np.sqrt(sources)
    )
    return {"displacement": z, "slope": slope, "twist": twist}


def fly(
    wing: Wing,
    tips: list[float],
    seed: int,
    flight: str = "f0001",
    lasting_error: np.ndarray | None = None,
    sampled: bool = True,
) -> xr.Dataset:
    """Return the frames of a flight in format 2, in memory; `lasting_error` are the errors of the installation."""
    rng, arc, n = np.random.default_rng(seed), wing.arc, len(tips)
    of = {"lasting": [_factors(np.random.default_rng(wing.seed), arc, KINDS["lasting"], SIZES["lasting"])] * n}
    of["shared"] = [_factors(np.random.default_rng(seed + 10_000), arc, KINDS["shared"], SIZES["shared"])] * n
    of["own"] = [_factors(rng, arc, KINDS["own"], SIZES["own"]) for _ in tips]
    errors = {k: np.zeros((n, size)) for k, size in KINDS.items()}
    if sampled:
        errors["lasting"][:] = (
            np.random.default_rng(wing.seed + 77).normal(size=KINDS["lasting"])
            if lasting_error is None
            else lasting_error
        )
        errors["shared"][:] = rng.normal(size=KINDS["shared"])
        errors["own"] = rng.normal(size=(n, KINDS["own"]))
    data: dict = {"arc_length": ("eta", arc)}
    for q, name in enumerate(QUANTITIES):
        dims = ("frame", "eta", "axis") if name == "displacement" else ("frame", "eta")
        truth = np.stack([bend(arc + wing.root_error_m, tip)[q] for tip in tips])
        values = truth + sum(np.einsum("fek,fk->fe", np.stack([f[name] for f in of[k]]), errors[k]) for k in KINDS)
        sigma = np.sqrt(sum((np.stack([f[name] for f in of[k]]) ** 2).sum(-1) for k in KINDS))
        unit = {"units": "m" if name == "displacement" else "rad", "long_name": f"{name}, relative to the survey"}

        def expand(a: np.ndarray, name: str = name) -> np.ndarray:
            if name != "displacement":
                return a
            out = np.zeros((*a.shape[:2], 3, *a.shape[2:]))
            out[:, :, 2] = a
            return out

        data[name] = dims, expand(values), unit
        data[f"sigma_{name}"] = dims, expand(sigma), unit
        for kind in KINDS:
            data[f"{name}_{kind}"] = (*dims, kind), expand(np.stack([f[name] for f in of[kind]])), unit
    data["ground_position"] = ("eta", "axis"), np.stack([0 * arc, arc, 0 * arc], axis=1)
    frames = np.arange(n)
    data["lasting_sources"] = "frame", [wing.name] * n
    data["shared_sources"] = "frame", [f"{wing.name}-{flight}-{seed}"] * n
    data["own_sources"] = "frame", [f"{wing.name}-{flight}-{seed}-{k}" for k in frames]
    data["inputs"] = "frame", [f"{wing.name}{flight}{seed}"] * n
    data["flight"] = "frame", [flight] * n
    data["recorder_id"] = "frame", [wing.recorder] * n
    data["image"] = "frame", [f"s{1 + k // 2:06d}/{1 + k % 2:04d}.jpg" for k in frames]
    data["time"] = "frame", 10.0 * frames, {"units": "seconds since 2026-06-01 08:00:00"}
    data["jointly"] = "frame", np.ones(n)
    data["weight_kg"] = "frame", 60_000.0 - 1_000 * frames, {"units": "kg"}
    data["sigma_weight_kg"] = "frame", np.full(n, 300.0), {"units": "kg"}
    data["mach"] = "frame", 0.78 + 0.01 * frames
    data["sigma_mach"] = "frame", np.full(n, 0.002)
    data["thermal_scale"] = "frame", np.full(n, 0.998)
    attrs = {
        "format_version": 2,
        "side": wing.side,
        "length_to_tip_m": wing.length_m,
        "outermost_marker_m": wing.outermost_m,
        "root_offset_sigma_m": 0.3,
        "reference": "survey",
    }
    coords = {"eta": arc / wing.length_m, "axis": ["x", "y", "z"], "marker": ["M18", "M19"]}
    return xr.Dataset(data, coords, attrs)


def write(data: xr.Dataset, file) -> str:
    """Write a dataset as the program does."""
    data.to_netcdf(file, engine="scipy", format="NETCDF3_64BIT")
    return str(file)


def opened(data: xr.Dataset) -> xr.Dataset:
    """Return a dataset as :func:`wingd.backend.open_shape` would."""
    from wingd import shapes  # noqa: F401
    from wingd.backend import index_stations

    return index_stations(data)


def reduced(data: xr.Dataset, keep: int) -> xr.Dataset:
    """Return a dataset whose lasting factors are reduced to `keep` sources, with basis and rest."""
    out = data.drop_vars([f"{q}_lasting" for q in QUANTITIES])
    rows = [data[f"{q}_lasting"].isel(axis=2) if q == "displacement" else data[f"{q}_lasting"] for q in QUANTITIES]
    matrix = np.concatenate(
        [
            (r / np.where(data[f"sigma_{q}"].values.max(), data[f"sigma_{q}"].values.max(), 1)).values.reshape(
                -1, r.shape[-1]
            )
            for q, r in zip(QUANTITIES, rows, strict=True)
        ]
    )
    basis = np.linalg.svd(matrix, full_matrices=False)[2][:keep].T
    for q in QUANTITIES:
        full = data[f"{q}_lasting"]
        less = full.values @ basis
        rest = np.sqrt(((full.values - less @ basis.T) ** 2).sum(-1))
        out[f"{q}_lasting"] = full.dims, less.astype(np.float32)
        out[f"{q}_lasting_rest"] = full.dims[:-1], rest.astype(np.float32)
    out["lasting_basis"] = (
        ("frame", "lasting_source", "lasting"),
        np.repeat(basis[None], data.sizes["frame"], axis=0).astype(np.float32),
    )
    return out
