"""Interior orientation, and the formats of its files."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

FORMATS = {"wingd": "camera.toml", "opencv": "OpenCV", "ros": "ROS camera_info", "kalibr": "Kalibr camchain",
           "mrcal": "mrcal cameramodel"}  # fmt: skip
PARAMETERS = ["fx", "fy", "cx", "cy", "k1", "k2", "k3", "p1", "p2"]


@dataclass(frozen=True)
class Camera:
    """Interior orientation: size and parameters in px, distortion without unit."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    k1: float = 0.0
    k2: float = 0.0
    p1: float = 0.0
    p2: float = 0.0
    k3: float = 0.0
    k4: float = 0.0
    k5: float = 0.0
    k6: float = 0.0

    @property
    def is_rational(self) -> bool:
        """True if the denominator of the distortion is not 1."""
        return (self.k4, self.k5, self.k6) != (0.0, 0.0, 0.0)

    @property
    def terms(self) -> list[float]:
        """Distortion in OpenCV's order: 5 terms, or 8 of a rational lens."""
        terms = [self.k1, self.k2, self.p1, self.p2, self.k3, self.k4, self.k5, self.k6]
        return terms if self.is_rational else terms[:5]

    def distort(self, x: float, y: float) -> tuple[float, float, float, float, float]:
        """Distort a direction x, y; returns it, and the elements xx, xy, yy of the symmetric Jacobian."""
        r2 = x * x + y * y
        above = 1 + r2 * (self.k1 + r2 * (self.k2 + r2 * self.k3))
        below = 1 + r2 * (self.k4 + r2 * (self.k5 + r2 * self.k6))
        radial = above / below if below > 0 else math.nan
        rise = (
            self.k1 + r2 * (2 * self.k2 + 3 * r2 * self.k3) - radial * (self.k4 + r2 * (2 * self.k5 + 3 * r2 * self.k6))
        )
        slope = 2 * rise / below if below > 0 else math.nan
        xd = x * radial + 2 * self.p1 * x * y + self.p2 * (r2 + 2 * x * x)
        yd = y * radial + self.p1 * (r2 + 2 * y * y) + 2 * self.p2 * x * y
        xx = radial + slope * x * x + 2 * self.p1 * y + 6 * self.p2 * x
        yy = radial + slope * y * y + 6 * self.p1 * y + 2 * self.p2 * x
        return xd, yd, xx, slope * x * y + 2 * self.p1 * x + 2 * self.p2 * y, yy

    def has_ray(self, u: float, v: float) -> bool:
        """Return whether a ray belongs to a pixel: the distortion is invertible there."""
        tx, ty = (u - self.cx) / self.fx, (v - self.cy) / self.fy
        x, y = tx, ty
        for _ in range(50):
            xd, yd, xx, xy, yy = self.distort(x, y)
            off, det = math.hypot(tx - xd, ty - yd), xx * yy - xy * xy
            if not math.isfinite(off + det):
                return False
            if off < 1e-12:
                return det > 0 and xx + yy > 0
            if det == 0:
                return False
            step = ((yy * (tx - xd) - xy * (ty - yd)) / det, (xx * (ty - yd) - xy * (tx - xd)) / det)
            scale = 1.0
            while True:
                xd, yd, *_ = self.distort(x + step[0] * scale, y + step[1] * scale)
                if math.hypot(tx - xd, ty - yd) < off:
                    x, y = x + step[0] * scale, y + step[1] * scale
                    break
                scale *= 0.5
                if scale < 1e-6:
                    return off < 1e-11 and det > 0
        return False

    def pixel_without_ray(self) -> tuple[float, float] | None:
        """Return a pixel of the edge of the image, from its corner, to which no ray belongs."""
        w, h, steps = self.width, self.height, [k / 20 for k in range(21)]
        edge = [p for t in steps for p in ((t * w, 0), (t * w, h), (0, t * h), (w, t * h))]
        return next(((u, v) for u, v in edge if not self.has_ray(u - 0.5, v - 0.5)), None)


def format_of_name(file: Path | str) -> tuple[str | None, str | None]:
    """Return format and syntax that a file's name implies; the format only if it is unambiguous."""
    name = Path(file).name.lower()
    ending = name.rpartition(".")[2] if "." in name else ""
    if ending in ("yaml", "yml", "json"):
        named = "kalibr" if "camchain" in name else "ros" if "camera_info" in name else None
        return named, "json" if ending == "json" else "yaml"
    return {"toml": ("wingd", None), "cameramodel": ("mrcal", "literal"), "xml": ("opencv", "xml")}.get(
        ending, (None, None)
    )
