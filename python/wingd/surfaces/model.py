"""Surface as it is in a file."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from wingd.surfaces.deformation import Array

#: Units of length, m.
UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254, "ft": 0.3048}
EXPORT = "export or copy the file again"

IntArray = np.ndarray[Any, np.dtype[np.int64]]


@dataclass(frozen=True)
class Surface:
    """Surface as in its file.

    Attributes
    ----------
    file
        Path of the file.
    points
        Nodes in the unit and the axes of the file, shape (nodes, 3).
    unit
        Unit of the coordinates, a key of :data:`UNITS`.
    ids
        Numbers of the nodes in the file; None if the file has none: they are not invented.
    triangles
        Corners of the facets, as indices of nodes, shape (triangles, 3); empty in a list of nodes.
    notes
        Remarks on what was not read.
    write
        Writes the file's own format with other points: name of the output and its bytes.
    mesh
        Mesh of meshio or pyvista, or array of points, from which the surface was made.
    """

    file: Path | str
    points: Array
    unit: str
    ids: IntArray | None = None
    triangles: IntArray = field(default_factory=lambda: np.zeros((0, 3), np.int64))
    notes: tuple[str, ...] = ()
    write: Callable[[Array], tuple[str, bytes]] | None = None
    mesh: Any = None

    @property
    def metres(self) -> Array:
        """Nodes in m, shape (nodes, 3)."""
        return self.points * UNITS[self.unit]
