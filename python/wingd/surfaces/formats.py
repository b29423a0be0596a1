"""Files of surfaces: read with the numbers and parts of the file, written with moved nodes and nothing else changed.

STL, node lists, Nastran's bulk data and SU2 are read here, because numbers of nodes, solids and other cards of the
file must be kept; VTK, PLY, OBJ and others by meshio, which keeps the order of the nodes.
"""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from wingd import WingdError
from wingd.surfaces.deformation import Array
from wingd.surfaces.meshes import (
    MESHIO_ENDINGS,
    grid_cards,
    import_meshio,
    mesh_triangles,
    read_bdf,
    read_meshio,
    read_su2,
    read_vtp,
    written_by,
)
from wingd.surfaces.model import EXPORT, UNITS, IntArray, Surface
from wingd.textfiles import excerpt, fault, parse_number, read_bytes, read_table, read_text

_NODE_HEADER = "id,x_m,y_m,z_m (or x_mm, x_cm, x_in, x_ft)"
_MAX_GRID_ID = 99_999_999


def read_surface(name: Path | str, unit: str | None = None, id_column: str = "id") -> Surface:
    """Read a surface.

    Parameters
    ----------
    name
        ``wing.stl``, ``nodes.csv``, ``model.bdf``, ``mesh.su2:MARKER,MARKER``, or a mesh that meshio reads.
    unit
        Unit of the coordinates, default m; a list of nodes names its own in its header.
    id_column
        Column with the numbers of the nodes in a list.

    Raises
    ------
    WingdError
        The file is not a surface; the message has file, line and remedy.
    """
    file, _, tags = str(name).partition(":") if ".su2:" in str(name).lower() else (str(name), "", "")
    path = Path(file)
    if unit is not None and unit not in UNITS:
        raise WingdError(f"unit {unit!r} is not known; give one of {', '.join(UNITS)}")
    ending = path.suffix.lower()
    if ending == ".csv":
        surface = _read_nodes(path, unit, id_column)
    else:
        readers = {".stl": _read_stl, ".bdf": read_bdf, ".nas": read_bdf, ".dat": read_bdf, ".vtp": read_vtp}
        if ending == ".su2":
            surface = read_su2(path, [tag.strip() for tag in tags.split(",") if tag.strip()])
        elif ending in readers:
            surface = readers[ending](path)
        elif ending in MESHIO_ENDINGS:
            surface = read_meshio(path)
        else:
            known = ", ".join([".csv", ".su2", *readers, *MESHIO_ENDINGS])
            raise fault(path, "has no ending of a surface that keeps its nodes", f"give one of {known}")
        surface = replace(surface, unit=unit or "m")
    if not len(surface.points):
        raise fault(path, "has no node", EXPORT)
    finite = np.isfinite(surface.points).all(axis=1)
    if not finite.all():
        place = f"node {np.argmin(finite) + 1}"
        raise fault(path, "has a coordinate that is not a finite number", EXPORT, key=place)
    return surface


def as_surface(mesh: Any, unit: str | None = None) -> Surface:
    """Return a surface of a file, of a mesh of meshio or pyvista, or of an array of points, shape (nodes, 3).

    Raises
    ------
    WingdError
        The object has no points in three dimensions.
    """
    if isinstance(mesh, Surface):
        return mesh
    if isinstance(mesh, str | Path):
        return read_surface(mesh, unit)
    try:
        points = np.asarray(getattr(mesh, "points", mesh), float)
    except (TypeError, ValueError):
        points = np.zeros(0)
    if points.ndim != 2 or points.shape[1] != 3 or not np.isfinite(points).all():
        raise WingdError(
            f"{type(mesh).__name__} has no finite points of three coordinates; give a file, a mesh or an array"
        )
    if hasattr(mesh, "cells") and isinstance(mesh.cells, list):
        triangles = mesh_triangles(mesh)
    else:
        # Polygons of pyvista; a volume has no facets of its own.
        triangles = mesh.triangulate().regular_faces if type(mesh).__name__ == "PolyData" else np.zeros((0, 3))
    return Surface(type(mesh).__name__, points, unit or "m", None, np.asarray(triangles, np.int64), mesh=mesh)


def _read_nodes(path: Path, unit: str | None, id_column: str) -> Surface:
    header, rows = read_table(path, _NODE_HEADER)
    names = header.cells
    found = [u for u in UNITS if all(f"{axis}_{u}" in names for axis in "xyz")]
    if len(found) != 1:
        wrong = next(
            (n for n in names if n.lower() in {f"{a}_{u}" for a in "xyz" for u in UNITS} and n not in _axes()), ""
        )
        problem = "is not in lower case" if wrong else "has not three coordinates of one unit in its header"
        raise fault(path, problem, f"write the header {_NODE_HEADER}", line=header.line, key=wrong)
    own = found[0]
    if unit not in (None, own):
        raise fault(path, f"gives coordinates in {own}, not {unit}", "omit --unit", line=header.line)
    axes = [names.index(f"{axis}_{own}") for axis in "xyz"]
    ids = _node_numbers(path, header, rows, id_column)
    points = [[parse_number(row.cells[k]) for k in axes] for row in rows]
    for row, point in zip(rows, points, strict=True):
        if None in point:
            problem = f"has no three finite coordinates ({excerpt(','.join(row.cells))})"
            raise fault(path, problem, "give decimal numbers with a point, one node a line", line=row.line)
    unread = [n for k, n in enumerate(names) if k not in axes and n != id_column and n]
    notes = [f"columns not read: {', '.join(unread)}"] if unread else []
    if ids is None:
        notes.append("no column id: the nodes have no numbers, and no surface.bdf is written")
    usable = ids is not None and bool((ids >= 1).all() and (ids <= _MAX_GRID_ID).all())
    write = (lambda moved: ("surface.bdf", grid_cards(ids, moved, own))) if usable else None
    return Surface(path, np.array(points, float).reshape(-1, 3), own, ids, notes=tuple(notes), write=write)


def _axes() -> set[str]:
    return {f"{axis}_{unit}" for axis in "xyz" for unit in UNITS}


def _node_numbers(path: Path, header: Any, rows: list[Any], id_column: str) -> IntArray | None:
    names = header.cells
    if id_column not in names:
        if id_column != "id":
            raise fault(path, "is not a column", f"the header has {', '.join(names)}", line=header.line, key=id_column)
        looks = next((n for n in names if re.sub(r"[^a-z]", "", n.lower()) in _NUMBER_NAMES), None)
        if looks:
            problem = "looks like the numbers of the nodes, but is not called id"
            raise fault(path, problem, f"rename it to id, or give --id {looks}", line=header.line, key=looks)
        return None
    k, ids, lines = names.index(id_column), [], {}
    for row in rows:
        if not re.fullmatch(r"\d{1,18}", row.cells[k], re.ASCII):
            problem = f"has a number that is not whole ({excerpt(row.cells[k])})"
            raise fault(path, problem, f"number the nodes, or delete the column {id_column}", line=row.line)
        number = int(row.cells[k])
        if number in lines:
            problem = f"repeats node {number} of line {lines[number]}"
            raise fault(path, problem, "give each node one number", line=row.line)
        lines[number] = row.line
        ids.append(number)
    return np.array(ids, np.int64)


#: Names of a column of node numbers, in lower case and letters alone.
_NUMBER_NAMES = {"id", "node", "nodeid", "nodes", "nid", "grid", "gridid", "gid", "number", "no", "nr", "num", "eid", "label",
                 "nodenumber", "nodeno", "nodelabel", "point", "pointid"}  # fmt: skip


def _read_stl(path: Path) -> Surface:
    content = read_bytes(path)
    count = int.from_bytes(content[80:84], "little") if len(content) >= 84 else None
    record = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    if count is not None and 84 + 50 * count == len(content):
        facets = np.frombuffer(content, record, count, 84)
        points, triangles = _unique_nodes(facets["corners"].astype(float).reshape(-1, 3))

        def write_binary(moved: Array) -> tuple[str, bytes]:
            out = facets.copy()
            out["corners"] = moved[triangles]
            out["normal"] = _normals(moved, triangles)
            return "surface.stl", content[:84] + out.tobytes()

        return _with_facets(path, points, triangles, write_binary)
    if not content.lstrip()[:5].lower() == b"solid":
        expected = "" if count is None else f", but {count} facets, as its header says, need {84 + 50 * count}"
        raise fault(path, f"is not STL: it has {len(content)} bytes{expected}", EXPORT)
    lines = read_text(path).split("\n")
    corners, places, normals = _text_corners(path, lines)
    points, triangles = _unique_nodes(np.array(corners).reshape(-1, 3))

    def write_text(moved: Array) -> tuple[str, bytes]:
        out = list(lines)
        for k, place in enumerate(places):
            out[place] = "vertex {:.9e} {:.9e} {:.9e}".format(*moved[triangles.flat[k]])
        for place, normal in zip(normals, _normals(moved, triangles), strict=True):
            out[place] = "facet normal {:e} {:e} {:e}".format(*normal)
        return "surface.stl", "\n".join(out).encode()

    return _with_facets(path, points, triangles, write_text)


def _text_corners(path: Path, lines: list[str]) -> tuple[list[list[float]], list[int], list[int]]:
    """Return the corners of an STL text, and the lines of corners and normals; solids and their names stay in the text."""
    corners: list[list[float]] = []
    places: list[int] = []
    normals: list[int] = []
    is_open, of_facet = False, 0
    for k, line in enumerate(lines):
        words = line.split()
        word = words[0].lower() if words else ""
        if word == "vertex" and is_open and of_facet < 3:
            numbers = [parse_number(w) for w in words[1:]]
            if len(numbers) != 3 or None in numbers:
                raise fault(path, f"is not a vertex ({excerpt(line.strip())})", EXPORT, line=k + 1)
            corners.append(numbers)
            places.append(k)
            of_facet += 1
        elif word == "facet" and is_open and of_facet == 0 and len(normals) * 3 == len(corners):
            normals.append(k)
        elif word == "endloop" and of_facet == 3 and len(normals) * 3 == len(corners):
            of_facet = 0
        elif word in ("vertex", "endloop"):
            raise fault(path, "has a facet that is not a triangle", "triangulate it", line=k + 1)
        elif word == "solid" and not is_open:
            is_open = True
        elif word == "endsolid" and is_open and of_facet == 0:
            is_open = False
        elif word and not (word in ("outer", "endfacet") and is_open and of_facet == 0):
            raise fault(path, f"does not belong here in STL ({excerpt(line.strip())})", EXPORT, line=k + 1)
    if is_open or not corners:
        problem = "the last solid has no end" if is_open else "has no facet"
        raise fault(path, problem, "the file is truncated; " + EXPORT, line=len(lines))
    return corners, places, normals


def _unique_nodes(corners: Array) -> tuple[Array, IntArray]:
    """Return each node once, in the order of the file, and the triangles."""
    # 0 and -0 are one place.
    points, first, inverse = np.unique(corners + 0.0, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first)
    rank = np.empty(len(order), np.int64)
    rank[order] = np.arange(len(order))
    return points[order], rank[inverse.reshape(-1)].reshape(-1, 3)


def _normals(points: Array, triangles: IntArray) -> Array:
    a, b, c = points[triangles].transpose(1, 0, 2)
    normal = np.cross(b - a, c - a)
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    return np.divide(normal, length, out=np.zeros_like(normal), where=length > 0)


def _with_facets(path: Path, points: Array, triangles: IntArray, write: Any) -> Surface:
    if not len(triangles):
        raise fault(path, "has no facet", EXPORT)
    return Surface(path, points, "m", None, triangles, write=write)


def write_files(moved: Any, folder: Path | str, name: str = "surface") -> list[Path]:
    """Write a moved surface: ``surface.csv``, ``surface.vtu`` for ParaView, and the format of the input.

    Parameters
    ----------
    moved
        Result of :func:`wingd.surfaces.deform`.
    folder
        Folder of the files, which is created.
    name
        Beginning of the names of the files.
    """
    folder = Path(folder)
    surface = moved.surface
    unit, factor = surface.unit, UNITS[surface.unit]
    columns: dict[str, Any] = {"index": np.arange(len(surface.points))} if surface.ids is None else {"id": surface.ids}
    for prefix, values in (
        ("", moved.points),
        ("d", moved.displacement_m / factor),
        ("sigma_d", moved.sigma_m / factor),
    ):
        columns |= {f"{prefix}{axis}_{unit}": values[:, k] for k, axis in enumerate("xyz")}
    meshio = import_meshio()
    mesh = moved.to_meshio()
    files = {f"{name}.csv": pd.DataFrame(columns).to_csv(index=False).encode()}
    files[f"{name}.vtu"] = written_by(lambda path: meshio.write(path, mesh), ".vtu")
    if surface.write is not None:
        own, content = surface.write(moved.points)
        files[own.replace("surface", name, 1)] = content
    folder.mkdir(parents=True, exist_ok=True)
    for file, content in files.items():
        (folder / file).write_bytes(content)
    return [folder / file for file in files]
