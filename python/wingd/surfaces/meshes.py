"""Meshes of SU2, Nastran and those that meshio reads, with the numbers of their nodes."""

from __future__ import annotations

import io
import re
import tempfile
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from typing import Any

import numpy as np

from wingd import WingdError
from wingd.surfaces.deformation import Array
from wingd.surfaces.model import EXPORT, IntArray, Surface
from wingd.textfiles import excerpt, fault, parse_number, read_bytes, read_text

#: Formats of meshio without numbers of nodes; in others meshio would renumber them.
MESHIO_ENDINGS = (".vtk", ".vtu", ".ply", ".obj", ".off", ".xdmf")
_TYPES = {"triangle": 3, "quad": 4}


def read_su2(path: Path, wanted: list[str]) -> Surface:
    """Read the markers of a mesh: nodes of the boundary elements with these tags, numbered as in the mesh from 0."""
    lines = read_text(path).split("\n")
    kept = [(k + 1, text) for k, line in enumerate(lines) if (text := line.split("%")[0].strip())]
    points: Array | None = None
    corners: list[list[int]] = []
    tags: list[str] = []
    k, skips = 0, False
    while k < len(kept):
        line, text = kept[k]
        key, is_key, value = (part.strip() for part in text.partition("="))
        k += 1
        if not is_key:
            if not skips:
                problem = f"belongs to no section ({excerpt(text)})"
                raise fault(path, problem, "correct the count of the section before it", line=line)
            continue
        skips = False
        if key in ("NELEM", "NPOIN", "MARKER_ELEMS"):
            section = _su2_section(path, kept, k, key, value, line)
            k += len(section)
            if key == "NPOIN":
                if points is not None:
                    raise fault(path, "repeats the points", EXPORT, line=line)
                points = np.array([_su2_point(path, *row) for row in section]).reshape(-1, 3)
            elif key == "MARKER_ELEMS" and tags and tags[-1] in wanted:
                corners += [_su2_element(path, *row) for row in section]
        elif key == "MARKER_TAG":
            if value in wanted and value in tags:
                raise fault(path, f"repeats the marker {value}", "give each marker one tag", line=line)
            tags.append(value)
        elif key == "NDIME" and value != "3":
            raise fault(path, f"is a mesh of {excerpt(value)} dimensions", "give a mesh of three", line=line)
        elif key == "NZONE" and value != "1":
            raise fault(path, "is a mesh of several zones", "give each zone as a file", line=line)
        else:
            skips = key not in ("NDIME", "NZONE", "NMARK")
    return _su2_surface(path, points, corners, tags, wanted)


def _su2_surface(
    path: Path, points: Array | None, corners: list[list[int]], tags: list[str], wanted: list[str]
) -> Surface:
    if points is None:
        raise fault(path, "has no points (NPOIN)", "the file is truncated; " + EXPORT)
    missing = [tag for tag in wanted if tag not in tags]
    if missing or not wanted:
        problem = f"has no marker {missing[0]}" if missing else "needs the markers of the wing"
        raise fault(path, problem, f"name some of {', '.join(tags[:20])}: mesh.su2:MARKER,MARKER")
    if not corners:
        raise fault(path, f"has no element of {', '.join(wanted)}", "name another marker")
    triangles = np.array([t for c in corners for t in ([c[:3], [c[0], *c[2:]]] if len(c) == 4 else [c])], np.int64)
    if triangles.max() >= len(points):
        problem = f"names node {triangles.max()}, but the mesh has {len(points)} points, from 0"
        raise fault(path, problem, EXPORT)
    ids, inverse = np.unique(triangles, return_inverse=True)

    def write(moved: Array) -> tuple[str, bytes]:
        rows = ("{} {!r} {!r} {!r}\n".format(i, *map(float, p)) for i, p in zip(ids, moved, strict=True))
        return "surface_positions.dat", "".join(rows).encode()

    return Surface(path, points[ids], "m", ids, inverse.reshape(-1, 3), write=write)


def _su2_section(
    path: Path, kept: list[tuple[int, str]], begin: int, key: str, value: str, line: int
) -> list[tuple[int, str]]:
    count = value.split()[0] if value.split() else ""
    if not re.fullmatch(r"\d{1,18}", count, re.ASCII):
        raise fault(path, f"has no count ({excerpt(value)})", EXPORT, line=line, key=key)
    section = kept[begin : begin + int(count)]
    stop = next((k for k, (_, text) in enumerate(section) if "=" in text), len(section))
    if stop < int(count):
        where = section[stop][0] if stop < len(section) else kept[-1][0]
        problem = f"announces {int(count)} lines and {stop} follow, up to line {where}"
        raise fault(path, problem, "the file is truncated; " + EXPORT, line=line, key=key)
    return section


def _su2_point(path: Path, line: int, text: str) -> list[float]:
    numbers = [parse_number(word) for word in text.split()[:3]]
    if len(numbers) < 3 or None in numbers:
        raise fault(path, f"is not a point ({excerpt(text)})", EXPORT, line=line)
    return [float(v) for v in numbers if v is not None]


def _su2_element(path: Path, line: int, text: str) -> list[int]:
    kind, *rest = text.split()
    count = {"5": 3, "9": 4}.get(kind, 0)
    corners = [int(w) for w in rest[:count] if re.fullmatch(r"\d{1,18}", w, re.ASCII)]
    if not count or len(corners) < count:
        problem = f"is not a triangle (5) or quadrilateral (9) with its nodes ({excerpt(text)})"
        raise fault(path, problem, EXPORT, line=line)
    return corners


def read_bdf(path: Path) -> Surface:
    """Read the GRID cards of bulk data; all other cards stay as they are."""
    lines = read_text(path).split("\n")
    cards: list[tuple[int, int, list[str]]] = []
    k = 0
    while k < len(lines):
        if lines[k][:4].upper() != "GRID" or lines[k][4:5] not in ("", " ", "*", ",", "\t"):
            k += 1
            continue
        begin, fields = k, _fields(lines[k])
        while k + 1 < len(lines) and lines[k + 1][:1] in ("*", "+") and len(fields) < 9:
            k += 1
            fields += _fields(lines[k])[1:]
        k += 1
        cards.append((begin, k, [*fields, *[""] * 9][:9]))
    points, ids, seen = [], [], {}
    for begin, _, fields in cards:
        number, system, place = fields[1], fields[2], [_nastran_number(f) for f in fields[3:6]]
        if not re.fullmatch(r"\d{1,8}", number, re.ASCII) or None in place:
            raise fault(path, f"is not a GRID card ({excerpt(lines[begin])})", EXPORT, line=begin + 1)
        if system not in ("", "0"):
            problem = f"has coordinates in the system {system}, which is not read"
            raise fault(path, problem, "give the basic system (CP = 0)", line=begin + 1, key=f"GRID {number}")
        if number in seen:
            problem = f"repeats node {number} of line {seen[number]}"
            raise fault(path, problem, "give each node one number", line=begin + 1)
        seen[number] = begin + 1
        ids.append(int(number))
        points.append(place)
    if not points:
        raise fault(path, "has no GRID card", "name the file with the nodes")

    def write(moved: Array) -> tuple[str, bytes]:
        out, at = [], 0
        for (begin, end, fields), before, point in zip(cards, points, moved, strict=True):
            out += lines[at:begin]
            same = list(map(float, point)) == before
            out += lines[begin:end] if same else _grid_card(fields, point).split("\n")
            at = end
        return "surface.bdf", "\n".join(out + lines[at:]).encode()

    return Surface(path, np.array(points, float).reshape(-1, 3), "m", np.array(ids, np.int64), write=write)


def _fields(line: str) -> list[str]:
    text = line.split("$")[0].rstrip().expandtabs(8)
    if "," in text:
        return [f.strip() for f in text.split(",")][:9]
    width = 16 if text[:8].rstrip().endswith("*") or text[:1] == "*" else 8
    count = 4 if width == 16 else 8
    return [text[:8].strip(), *(text[8 + width * k : 8 + width * (k + 1)].strip() for k in range(count))]


def _nastran_number(text: str) -> float | None:
    """Return a real number of Nastran: ``1.5``, ``1.5+3``, ``1.5D3``; an empty field is 0."""
    if not text:
        return 0.0
    return parse_number(re.sub(r"(?<=[\d.])[dD]?([+-]\d+)$", r"e\1", text).replace("D", "E").replace("d", "e"))


def _large_field(value: float) -> str:
    # A third digit of the exponent has no room in 16 characters.
    return f"{0.0 if abs(value) < 1e-99 else value:.9E}"


def _grid_card(fields: list[str], point: Array) -> str:
    x, y, z = (_large_field(float(v)) for v in point)
    rest = "".join(f"{f:>16}" for f in fields[6:9]).rstrip()
    return f"{'GRID*':<8}{fields[1]:>16}{fields[2]:>16}{x:>16}{y:>16}*\n{'*':<8}{z:>16}{rest}"


def grid_cards(ids: IntArray, moved: Array, unit: str) -> bytes:
    """Return GRID cards in large fields, to include instead of those of the model."""
    cards = [_grid_card(["", str(i), "", "", "", "", "", "", ""], p) for i, p in zip(ids, moved, strict=True)]
    return "\n".join([f"$ Wing in flight, unit of the input: {unit}", *cards, ""]).encode()


def import_meshio() -> Any:
    """Import meshio, or say how to install it."""
    try:
        import meshio
    except ImportError:
        raise WingdError("meshes need meshio; install it: pip install 'wingd[surfaces]'") from None
    return meshio


def read_meshio(path: Path) -> Surface:
    """Read a mesh of a format without numbers of nodes by meshio."""
    meshio = import_meshio()
    _check_counts(path)
    printed = io.StringIO()
    try:
        with redirect_stdout(printed), redirect_stderr(printed), np.errstate(all="ignore"):
            mesh = meshio.read(path)
    except (Exception, SystemExit) as error:
        said = printed.getvalue() if isinstance(error, SystemExit) else str(error)
        cause = " ".join(said.split())[:100] or type(error).__name__
        raise fault(path, f"cannot be read by meshio ({cause})", EXPORT) from None
    points = np.asarray(mesh.points, float)
    if points.ndim != 2 or points.shape[1] != 3:
        raise fault(path, "has no points in three dimensions", EXPORT)
    corners = np.concatenate(
        [np.asarray(block.data, np.int64).ravel() for block in mesh.cells] or [np.zeros(0, np.int64)]
    )
    if len(corners) and not 0 <= corners.min() <= corners.max() < len(points):
        raise fault(path, f"names node {corners.max()}, but has {len(points)} points, from 0", EXPORT)

    def write(moved: Array) -> tuple[str, bytes]:
        out = mesh.copy()
        out.points = moved
        return f"surface{path.suffix.lower()}", written_by(lambda name: meshio.write(name, out), path.suffix.lower())

    return Surface(path, points, "m", None, mesh_triangles(mesh), write=write)


def mesh_triangles(mesh: Any) -> IntArray:
    """Return the triangles of a mesh of meshio; quadrilaterals become two."""
    facets = [block.data[:, :n] for block in mesh.cells if (n := _TYPES.get(block.type))]
    triangles = [f if f.shape[1] == 3 else np.vstack([f[:, :3], f[:, [0, 2, 3]]]) for f in facets]
    return np.concatenate([np.zeros((0, 3), np.int64), *triangles]).astype(np.int64)


def _check_counts(path: Path) -> None:
    """Refuse a count that the file cannot hold, before memory is reserved for it."""
    size = len(read_bytes(path))
    with path.open("rb") as opened:
        head = opened.read(1 << 16).decode("latin-1")
    pattern = r"(?:POINTS|POLYGONS|CELLS|element\s+\w+|NumberOf\w+=\"|Dimensions=\"|OFF\s+)\s*(\d+)"
    for found in re.finditer(pattern, head, re.I):
        if int(found[1]) > size:
            problem = f"announces {found[1]} values, but has {size} bytes"
            raise fault(path, problem, EXPORT, line=head[: found.start()].count("\n") + 1)


def written_by(write: Callable[[str], Any], ending: str) -> bytes:
    """Return the bytes that a library writes to a named file."""
    with tempfile.TemporaryDirectory() as folder, redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()):
        name = Path(folder) / f"surface{ending}"
        write(str(name))
        return name.read_bytes()


def read_vtp(path: Path) -> Surface:
    """Read polygons of VTK by pyvista."""
    try:
        import pyvista
    except ImportError:
        raise WingdError("files of .vtp need pyvista; install it: pip install 'wingd[surfaces]'") from None
    _check_counts(path)
    try:
        mesh = pyvista.read(path)
        triangles = mesh.triangulate().regular_faces if mesh.n_cells else np.zeros((0, 3))
    except (Exception, SystemExit) as error:
        raise fault(path, f"cannot be read by pyvista ({' '.join(str(error).split())[:100]})", EXPORT) from None

    def write(moved: Array) -> tuple[str, bytes]:
        out = mesh.copy()
        out.points = moved
        return "surface.vtp", written_by(out.save, ".vtp")

    return Surface(path, np.array(mesh.points, float), "m", None, np.asarray(triangles, np.int64), write=write)
