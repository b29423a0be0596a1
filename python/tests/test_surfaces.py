"""Promise: surfaces are moved as the program moved them, in their own numbers, parts and unit, or refused by name."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from scipy.spatial.transform import Rotation

from wingd import WingdError
from wingd.backend import open_shape
from wingd.commands.deform import main
from wingd.surfaces import Deformation, deform, read_surface, write_files
from wingd.surfaces.deformation import BLEND_FRACTION

DATA = Path(__file__).parent / "data" / "surfaces"


@pytest.fixture(scope="module")
def shape() -> xr.Dataset:
    return open_shape(DATA / "shape.nc").load()


class ProgramRandom:
    """Random numbers of the program (SplitMix64; Box and Muller), in the stream of its samples."""

    MASK = (1 << 64) - 1

    def __init__(self, seed: int = 1, purpose: int = 31) -> None:
        self.state = (seed ^ purpose * 0xD1B54A32D192ED03) & self.MASK
        self.state = self.bits()

    def bits(self) -> int:
        self.state = (self.state + 0x9E3779B97F4A7C15) & self.MASK
        x = self.state
        x = ((x ^ x >> 30) * 0xBF58476D1CE4E5B9) & self.MASK
        x = ((x ^ x >> 27) * 0x94D049BB133111EB) & self.MASK
        return x ^ x >> 31

    def unit(self) -> float:
        return (self.bits() >> 11) / (1 << 53)

    def normal(self) -> float:
        radius = math.sqrt(-2 * math.log(1 - self.unit()))
        return radius * math.cos(math.tau * self.unit())


def with_all_sources(shape: xr.Dataset) -> Deformation:
    """The deformation with its sources as the program has them, not compressed."""
    parts = [
        np.concatenate([shape[f"{q}_{kind}"].values[0] for q in ("displacement", "rotation")], axis=1)
        for kind in ("lasting", "shared", "own")
    ]
    pose = [shape[q].values[0] for q in ("displacement", "rotation")]
    return Deformation(
        shape.arc_length.values, shape.ground_position.values, *pose, factor=np.concatenate(parts, axis=2)
    )


AXES = [f"{prefix}{axis}_m" for prefix in ("", "d") for axis in "xyz"]
SIGMAS = [f"sigma_d{axis}_m" for axis in "xyz"]


def test_values_equal_those_of_the_program_to_1e_9(shape: xr.Dataset, tmp_path: Path) -> None:
    surface = read_surface(DATA / "points.csv")
    for file, thermal in (("golden-without-thermal.csv", False), ("golden.csv", True)):
        write_files(deform(shape, surface, "s000001/0001.jpg", thermal=thermal), tmp_path)
        golden, found = pd.read_csv(DATA / file), pd.read_csv(tmp_path / "surface.csv")
        assert list(golden.columns) == list(found.columns)
        np.testing.assert_allclose(found[["id", *AXES]], golden[["id", *AXES]], rtol=1e-9, atol=1e-13)
        assert (found[SIGMAS].isna() == golden[SIGMAS].isna()).all(axis=None)

    def cards(file: Path) -> list[list[float]]:
        """Numbers of the cards by their columns: number and two coordinates, or the third."""
        lines = [line for line in file.read_text().splitlines() if line.startswith(("GRID*", "*"))]
        return [[float(line[k : k + 16]) for k in (8, 40, 56) if line[k : k + 16].strip()] for line in lines]

    assert len(cards(tmp_path / "surface.bdf")) == 120 and cards(tmp_path / "surface.bdf") == cards(DATA / "golden.bdf")


def test_standard_deviations_and_samples_equal_those_of_the_program(shape: xr.Dataset) -> None:
    """With the program's 200 samples to 1e-9; the propagated ones differ from these by the error of 200 samples, 5 %."""
    points = read_surface(DATA / "points.csv").points
    wing, random = with_all_sources(shape), ProgramRandom()
    sources = wing.factor.shape[2]
    samples = [wing.with_errors(np.array([random.normal() for _ in range(sources)])) for _ in range(200)]
    moved = np.array([one.move(points)[0] for one in samples])
    golden, draw = pd.read_csv(DATA / "golden.csv"), pd.read_csv(DATA / "golden-draw.csv")
    np.testing.assert_allclose(points + moved[0], draw[AXES[:3]], rtol=1e-9)
    outboard = golden[SIGMAS].notna().all(axis=1).to_numpy()
    sigma = golden[SIGMAS].to_numpy()[outboard]
    sampled = moved.std(axis=0, ddof=1)[outboard]
    np.testing.assert_allclose(sampled, sigma, rtol=1e-9, atol=1e-13)
    propagated = deform(shape, read_surface(DATA / "points.csv")).sigma_m[outboard]
    ratio = (propagated / sigma)[sigma > 1e-4]
    assert len(ratio) > 100 and abs(np.log(ratio)).max() < 4 / math.sqrt(2 * 199), ratio


def test_propagated_standard_deviations_are_those_of_many_samples(shape: xr.Dataset) -> None:
    wing = Deformation.from_dataset(shape)
    cold = Deformation.from_dataset(shape, thermal=False)
    points = read_surface(DATA / "points.csv").points[5::9]
    random = np.random.default_rng(3)
    for one in (wing, cold):
        steps = np.eye(one.factor.shape[2]) * 1e-3
        jacobian = [(one.with_errors(e).move(points)[0] - one.with_errors(-e).move(points)[0]) / 2e-3 for e in steps]
        if one is wing:
            exact = np.linalg.norm(jacobian, axis=0)
            np.testing.assert_allclose(one.move(points, True)[1], exact, rtol=1e-5)
        else:
            # The length of the wing's axis does not depend on its errors: only the temperature changes it.
            assert abs(one.scale - 1) < 1e-12
            assert (one.move(points, True)[1] <= 1.001 * wing.move(points, True)[1] + 1e-4).all()
    sampled = np.array([wing.sample(random).move(points)[0] for _ in range(300)]).std(axis=0)
    assert abs(np.log(sampled / wing.move(points, True)[1])).max() < 4 / math.sqrt(2 * 299)


def test_surveyed_points_of_another_renderer_are_moved_to_their_true_positions() -> None:
    truth = pd.read_csv(DATA / "dev-truth.csv")
    surface = read_surface(DATA / "dev-truth.csv")
    assert surface.notes == ("columns not read: true_dx_m, true_dy_m, true_dz_m",)
    moved = deform(open_shape(DATA / "dev-shape.nc"), surface, "s000001/0005.jpg")
    error = moved.displacement_m - truth[[f"true_d{axis}_m" for axis in "xyz"]].to_numpy()
    rms_mm = 1e3 * math.sqrt((error**2).sum(axis=1).mean())
    normalised = math.sqrt(np.mean((error[:, 2] / moved.sigma_m[:, 2]) ** 2))
    print(f"rms {rms_mm:.1f} mm, {normalised:.2f} standard deviations")
    assert rms_mm < 8 and normalised < 1.3 and np.abs(moved.displacement_m).max() > 1.2


LENGTH, DIHEDRAL, CURVATURE, TWIST = 33.0, 0.09, 0.005, 0.03
ORIGIN = np.array([30.0, -40.0, 3.0])
TANGENT = np.array([0, math.cos(DIHEDRAL), math.sin(DIHEDRAL)])


def circle(arc: np.ndarray, scale: float = 1.0) -> tuple[np.ndarray, np.ndarray, Rotation]:
    """Ground, displacement and rotation of a wing with dihedral, bent to a circle and twisted linearly."""
    arc = np.atleast_1d(np.asarray(arc, float))
    angle, radius = CURVATURE * arc, scale / CURVATURE
    flight = np.stack(
        [0 * arc, np.sin(DIHEDRAL + angle) - math.sin(DIHEDRAL), math.cos(DIHEDRAL) - np.cos(DIHEDRAL + angle)], axis=1
    )
    ground = TANGENT * arc[:, None]
    turn = Rotation.from_rotvec(np.array([1.0, 0, 0]) * angle[:, None])
    twist = Rotation.from_rotvec(TANGENT * (TWIST * arc / LENGTH)[:, None])
    return ORIGIN + ground, flight * radius - ground, turn * twist


def circular_wing(sections: int = 61, scale: float = 1.0, thermal: bool = True) -> Deformation:
    arc = np.linspace(0, LENGTH, sections)
    ground, displacement, rotation = circle(arc, scale)
    return Deformation(arc, ground, displacement, rotation.as_rotvec(), thermal=thermal)


def on_section(arc: np.ndarray, chord: np.ndarray, up: np.ndarray) -> np.ndarray:
    arc, chord, up = np.broadcast_arrays(*(np.atleast_1d(np.asarray(v, float)) for v in (arc, chord, up)))
    across = np.array([0, -math.sin(DIHEDRAL), math.cos(DIHEDRAL)])
    return circle(arc)[0] + np.array([1.0, 0, 0]) * chord[:, None] + across * up[:, None]


@pytest.mark.parametrize("scale", [1.0, 0.9984])
def test_points_move_rigidly_with_their_section_of_a_circle(scale: float) -> None:
    wing, k = circular_wing(scale=scale), np.arange(300)
    arc = BLEND_FRACTION * LENGTH + k * 0.1047
    points = on_section(arc, 3.6 * np.sin(k * 1.3), 0.6 * np.cos(k * 0.7))
    feet, away = wing.find_feet(points)
    np.testing.assert_allclose(feet, arc, atol=1e-9)
    np.testing.assert_allclose(away, np.hypot(3.6 * np.sin(k * 1.3), 0.6 * np.cos(k * 0.7)), atol=1e-9)
    ground, displacement, rotation = circle(arc, scale)
    truth = ground + displacement + rotation.apply(points - ground) * scale
    assert np.linalg.norm(points + wing.move(points)[0] - truth, axis=1).max() < 2e-6
    assert abs(wing.scale - scale) < 1e-6
    line = on_section(np.arange(0, 35.0, 0.01), 0, 0)
    moved = line + wing.move(line)[0]
    length = np.linalg.norm(np.diff(moved, axis=0), axis=1).sum()
    assert abs(length / (34.99 * scale) - 1) < 1e-4


def test_a_wing_without_its_thermal_scale_is_the_one_at_the_temperature_of_the_ground() -> None:
    points = on_section([0.4, 12.3, 33.7], [1.0, -3.0, 0.5], 0.3)
    off = circular_wing(scale=0.9984, thermal=False).move(points)[0] - circular_wing().move(points)[0]
    # The scale follows from chords of the bent axis, which are shorter than it by 3.2e-7.
    assert np.linalg.norm(off, axis=1).max() < 4e-7 * LENGTH


def test_nothing_moves_inboard_of_the_root_and_slopes_have_no_steps() -> None:
    wing = circular_wing(scale=0.9984)
    assert (wing.move(on_section([-8.0, -3.0, 0.0], [2.0, 1.0, 0.5], 0.4))[0] == 0).all()
    h = 1e-3
    for chord, up in ((-3.6, 0.1), (0.0, 0.6), (3.6, -0.1)):
        arc = np.arange(-0.5, 32.9, 0.01)
        at = [(p := on_section(arc + step, chord, up)) + wing.move(p)[0] for step in (-h, 0, h)]
        assert (np.linalg.norm(at[0] - 2 * at[1] + at[2], axis=1) / h).max() < 3e-5


def test_a_rigid_rotation_and_the_tip_keep_all_distances() -> None:
    turn = Rotation.from_rotvec([0.02, 0.03, -0.01])
    arc = np.array([0.0, 10, 11, 33])
    ground = circle(arc)[0]
    wing = Deformation(arc, ground, turn.apply(ground) - ground, np.tile(turn.as_rotvec(), (4, 1)))
    points = on_section([2.0, 10.5, 32.0, 36.0], [1.0, -2.0, 0.3, 1.0], 0.2)
    np.testing.assert_allclose(points + wing.move(points)[0], turn.apply(points), atol=1e-9)


def test_sections_that_describe_no_deformation_are_refused() -> None:
    def wing(arc: list[float], break_it: float | None = None) -> Deformation:
        ground, displacement, rotation = circle(np.array(arc))
        turns = rotation.as_rotvec()
        if break_it is not None:
            turns[-1] = [break_it, 0, 0]
        return Deformation(np.array(arc), ground, displacement, turns)

    assert wing([0.0, 1.0]).length_m == 1
    for arc, words in (
        ([0.0], "1 sections"),
        ([0.5, 1.0], "0.5 m from the bending root"),
        ([0, 2.0, 2.0], "at 2.0 m does not lie"),
    ):
        with pytest.raises(WingdError, match=words):
            wing(arc)
    for value in (math.nan, 1.6):
        with pytest.raises(WingdError, match="section at 4.0 m is not plausible"):
            wing([0.0, 4.0], value)


def test_surfaces_of_other_programs_have_the_same_nodes_and_facets() -> None:
    first = read_surface(DATA / "vtk-binary.stl")
    for name in ("meshio-text", "numpy-stl-text", "numpy-stl-binary", "vtk-text"):
        surface = read_surface(DATA / f"{name}.stl")
        np.testing.assert_allclose(surface.points, first.points, atol=1e-6)
        assert surface.points.shape == (24, 3) and (surface.triangles == first.triangles).all(), name
        again, content = surface.write(surface.points)
        assert again == "surface.stl" and content[:5].lower() == (DATA / f"{name}.stl").read_bytes()[:5].lower()
    both, one = read_surface(f"{DATA / 'meshio.su2'}:1,2"), read_surface(f"{DATA / 'meshio.su2'}:2")
    assert (len(both.points), len(both.triangles), list(one.ids)) == (24, 24, list(range(12, 24)))
    name, content = one.write(one.points + 1)
    rows = [list(map(float, line.split())) for line in content.decode().splitlines()]
    assert (name, len(rows), rows[5][0]) == ("surface_positions.dat", 12, 17) and np.allclose(
        rows[5][1:], one.points[5] + 1
    )


def test_solids_keep_their_names_and_everything_but_the_vertices(tmp_path: Path) -> None:
    facet = "facet normal 0 0 1\nouter loop\nvertex 0 0 {0}\nvertex 1 0 {0}\nvertex 0 1 {0}\nendloop\nendfacet\n"
    text = "solid upper skin\n" + facet.format(0) + facet.format(1) + "endsolid upper skin\nsolid lower\nendsolid\n"
    text += "SOLID tip\n" + facet.format(2).upper() + "endsolid tip\n"
    (tmp_path / "wing.stl").write_text(text)
    surface = read_surface(tmp_path / "wing.stl")
    lines = surface.write(surface.points + [0, 0, 5])[1].decode().splitlines()
    kept = [line for line in lines if line.split()[0].lower() not in ("vertex", "facet")]
    assert kept == [line for line in text.splitlines() if line.split()[0].lower() not in ("vertex", "facet")]
    assert lines[3].split() == ["vertex", "0.000000000e+00", "0.000000000e+00", "5.000000000e+00"]


BDF = """$ model
CEND
BEGIN BULK
GRID,1001,,38.0,45.0,0.3
GRID        1002       0    39.5    46.0   3.0-1      12     345
GRID*               1003               0           40.25           47.75*
*                   -.25
GRID    7               0.      0.      0.
CQUAD4  1       1       1001    1002    1003    7
ENDDATA
"""


def test_bulk_data_keeps_its_numbers_and_all_other_cards(tmp_path: Path) -> None:
    (tmp_path / "model.bdf").write_text(BDF)
    surface = read_surface(tmp_path / "model.bdf")
    assert list(surface.ids) == [1001, 1002, 1003, 7]
    np.testing.assert_allclose(surface.points[1:3], [[39.5, 46, 0.3], [40.25, 47.75, -0.25]])
    assert surface.write(surface.points)[1].decode() == BDF, "at rest the file is the same"
    moved = surface.points.copy()
    moved[1] += [0.5, 0, 1e-3]
    lines = surface.write(moved)[1].decode().splitlines()
    assert lines[4] == f"GRID*   {1002:>16}{0:>16}{'4.000000000E+01':>16}{'4.600000000E+01':>16}*"
    assert lines[5] == f"*       {'3.010000000E-01':>16}{12:>16}{345:>16}"
    assert lines[:4] + lines[6:] == BDF.splitlines()[:4] + BDF.splitlines()[5:]
    for old, new, words in (
        ("GRID,1001,,", "GRID,1001,5,", "line 4, GRID 1001: has coordinates in the system 5"),
        ("GRID    7 ", "GRID    1003", "repeats node 1003 of line 6"),
        ("39.5 ", "nan  ", "line 5: is not a GRID card"),
    ):
        (tmp_path / "model.bdf").write_text(BDF.replace(old, new))
        with pytest.raises(WingdError, match=words):
            read_surface(tmp_path / "model.bdf")


def nodes(shape: xr.Dataset, unit: str = "m", scale: float = 1.0, id_name: str = "id") -> str:
    rows = (
        f"{k},{x * scale},{y * scale},{z * scale}\n"
        for k, (x, y, z) in enumerate(shape.marker_ground_position.values, 1001)
    )
    return f"{id_name},x_{unit},y_{unit},z_{unit}\n" + "".join(rows)


@pytest.mark.parametrize("name", ["node_id", "node", "NID", "grid", "nodeid", "number", "EID", "Id", "GRID"])
def test_numbers_of_nodes_are_never_invented(shape: xr.Dataset, tmp_path: Path, name: str) -> None:
    file = tmp_path / "nodes.csv"
    file.write_text(nodes(shape, id_name=name))
    with pytest.raises(WingdError, match=f"line 1, {name}: looks like the numbers of the nodes, but is not called id"):
        read_surface(file)
    assert list(read_surface(file, id_column=name).ids[:2]) == [1001, 1002]
    file.write_text("\n".join(",".join(line.split(",")[1:]) for line in nodes(shape).splitlines()))
    moved = deform(shape, read_surface(file))
    assert any("no column id" in note for note in moved.notes)
    written = [path.name for path in write_files(moved, tmp_path)]
    assert written == ["surface.csv", "surface.vtu"] and "id" not in pd.read_csv(tmp_path / "surface.csv")


def test_cells_are_read_by_rfc_4180(tmp_path: Path) -> None:
    file = tmp_path / "nodes.csv"
    file.write_text('id,part,x_m,y_m,z_m\n1,"rib, 40",35.35,42.91,0.3\n2,rib #2,"1","2",3\n')
    surface = read_surface(file)
    assert surface.points.tolist() == [[35.35, 42.91, 0.3], [1, 2, 3]] and surface.notes == ("columns not read: part",)
    for text, words in (
        ('id,x_mm,y_mm,z_mm\n1,"33,450.0",1,2\n', "line 2: has no three finite coordinates"),
        ("id,x_m,y_m,z_m\n1,2,3\n", "line 2: has 3 cells under a header of 4"),
        ("id,x_m,y_m,z_m\n1,2,3,4,5\n", "line 2: has 5 cells under a header of 4"),
        ("id,X_m,y_m,z_m\n1,2,3,4\n", "line 1, X_m: is not in lower case"),
        ("id,x_m,y_mm,z_m\n", "has not three coordinates of one unit"),
        ("id;x_m;y_m;z_m\n", "line 1: is separated by semicolons"),
        ("id,x_m,x_m,y_m,z_m\n", "x_m: occurs twice"),
        ("# a\nid,x_m,y_m,z_m\n\n1,2,3,nan\n", "line 4: has no three finite coordinates"),
        ("id,x_m,y_m,z_m\n1,2,3,1e999\n", "line 2: has no three finite coordinates"),
        ("id,x_m,y_m,z_m\n1,=A1*2,3,1\n", "line 2: has no three finite coordinates"),
        ("id,x_m,y_m,z_m\nLE1,2,3,4\n", "line 2: has a number that is not whole"),
        ("id,x_m,y_m,z_m\n7,2,3,4\n7,1,1,1\n", "line 3: repeats node 7 of line 2"),
        ('id,x_m,y_m,z_m\n1,2,3,"4\n', "line 2: a quote is not closed"),
        ("x_m,y_m,z_m\n", "has no node"),
        ("", "is empty"),
    ):
        file.write_text(text)
        with pytest.raises(WingdError) as error:
            read_surface(file)
        assert words in str(error.value) and "; " in str(error.value), error.value


FACET = "solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\n"
MALFORMED = [
    ("a.stl", b"PK\x03\x04", "is not STL: it has 4 bytes"),
    ("a.stl", b"solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 x 0\n", 'line 4: is not a vertex ("vertex 0 x 0")'),
    ("a.stl", b"solid a\nmesh\n", "line 2: does not belong here"),
    ("a.stl", FACET.encode(), "the last solid has no end"),
    ("a.stl", (FACET + "vertex 0 0 9\n").encode(), "line 7: has a facet that is not a triangle"),
    ("a.stl", bytes(84), "has no content but zeros"),
    ("a.stl", b"x" * 80 + (4_000_000_000).to_bytes(4, "little") + bytes(50), "4000000000 facets, as its header says"),
    ("m.su2:a", b"NDIME= 2\n", "line 1: is a mesh of"),
    ("m.su2:a", b"NZONE= 2\n", "line 1: is a mesh of several zones"),
    ("m.su2:a", b"NPOIN= 2\n0 0 0\n", "NPOIN: announces 2 lines and 1 follow"),
    ("m.su2:a", b"NPOIN= 4000000000\n0 0 0\nNMARK= 1\n", "NPOIN: announces 4000000000 lines and 1 follow, up to line 3"),
    ("m.su2:a", b"NPOIN= 1\n0 0 0\n1 1 1\n", "line 3: belongs to no section"),
    ("m.su2:a", b"NPOIN= 1\n0 0\n", "line 2: is not a point"),
    ("m.su2:a", b"NPOIN= 1\n0 0 nan\n", "line 2: is not a point"),
    ("m.su2:a", b"NPOIN= many\n", 'has no count ("many")'),
    ("m.su2:a", b"NPOIN= 1\n0 0 0\nMARKER_TAG= b\n", "has no marker a; name some of b"),
    ("m.su2", b"NPOIN= 1\n0 0 0\nMARKER_TAG= b\n", "needs the markers of the wing; name some of b"),
    ("m.su2:a", b"NPOIN= 1\n0 0 0\nMARKER_TAG= a\nMARKER_ELEMS= 1\n5 0 0 1\n", "names node 1, but the mesh has 1"),
    ("m.su2:a", b"NPOIN= 1\n0 0 0\nMARKER_TAG= a\nMARKER_ELEMS= 1\n3 0 0\n", "is not a triangle (5) or"),
    ("m.su2:a", b"NPOIN= 1\n0 0 0\nMARKER_TAG= a\nMARKER_ELEMS= 0\n", "has no element of a"),
    ("m.su2:a", b"MARKER_TAG= a\n", "has no points (NPOIN)"),
    ("m.vtk", b"# vtk DataFile Version 3.0\na\nASCII\nDATASET POLYDATA\nPOINTS 4000000000 double\n0 0 0\n", "announces 4000000000"),
    ("m.ply", b"ply\nformat binary_little_endian 1.0\nelement vertex 4000000000\nproperty float x\nend_header\n", "4000000000"),
    ("m.vtu", b"<VTKFile", "cannot be read by meshio"),
    ("m.obj", b"v 0 nan 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "node 1: has a coordinate that is not a finite number"),
    ("m.inp", b"*NODE\n1, 0, 0, 0\n", "has no ending of a surface that keeps its nodes"),
    ("n.csv", b"\xff\xfei\0d\0", "is UTF-16 text; save it as UTF-8"),
    ("n.csv", b"id,x_m,y_m,z_m\n1,2,3,\xe9\n", "line 2: is not text in UTF-8"),
    ("n.csv", b"PK\x03\x04\x14\0", "is a spreadsheet file or an archive"),
]  # fmt: skip


@pytest.mark.parametrize(("name", "content", "words"), MALFORMED)
def test_every_malformed_surface_names_place_cause_and_remedy(
    tmp_path: Path, name: str, content: bytes, words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / name.split(":")[0]).write_bytes(content)
    status = main([str(DATA / "shape.nc"), "--surface", str(tmp_path / name), "--output", str(tmp_path / "out")])
    printed = capsys.readouterr()
    assert status == 1 and words in printed.err and "; " in printed.err and printed.err.count("\n") == 1, printed.err
    assert not (tmp_path / "out").exists() and not printed.out


@pytest.mark.parametrize("name", ["a.stl", "n.csv", "m.vtk", "m.su2:a", "m.bdf"])
def test_sparse_files_of_a_gigabyte_and_missing_ones_are_refused_at_once(tmp_path: Path, name: str) -> None:
    with pytest.raises(WingdError, match="cannot be read"):
        read_surface(tmp_path / name)
    with (tmp_path / name.split(":")[0]).open("wb") as file:
        file.truncate(1 << 30)
    with pytest.raises(WingdError, match="has 1073741824 bytes, of which 0 are on the disk: the others are holes"):
        read_surface(tmp_path / name)


def wing_surface(shape: xr.Dataset, unit: float = 1.0, matrix: np.ndarray | None = None) -> str:
    """A skin through the bending axis, 5 m deep, as OBJ."""
    axis = shape.ground_position.values[::3]
    side = np.cross([0, 0, 1.0], axis[-1] - axis[0])
    points = np.concatenate([axis + s * side / np.linalg.norm(side) for s in (-2.5, 2.5)])
    points = points if matrix is None else points @ matrix[:3, :3].T + matrix[:3, 3]
    n = len(axis)
    faces = [f"f {k} {k + 1} {n + k + 1}\nf {k} {n + k + 1} {n + k}\n" for k in range(1, n)]
    return "".join("v {:.6f} {:.6f} {:.6f}\n".format(*p / unit) for p in points) + "".join(faces)


def test_a_surface_on_which_the_markers_do_not_lie_is_refused_with_axes_and_unit(
    shape: xr.Dataset, tmp_path: Path
) -> None:
    file = tmp_path / "wing.obj"
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = Rotation.from_euler("xyz", [0.3, -2.0, 1.1]).as_matrix(), [17, -4, 2]
    in_cad = shape.assign(cad_from_survey=(("row", "column"), matrix))

    def refusal(text: str, unit: str | None = None, axes: str = "survey", of: xr.Dataset = shape) -> str:
        file.write_text(text)
        with pytest.raises(WingdError) as error:
            deform(of, read_surface(file, unit), axes=axes)
        return str(error.value)

    file.write_text(wing_surface(shape))
    right = deform(shape, read_surface(file))
    assert right.marker_distance_m < 0.3 and 2.5 < np.abs(right.displacement_m).max() < 3.3
    for unit, metres in (("mm", 0.001), ("ft", 0.3048), ("in", 0.0254), ("cm", 0.01)):
        assert f"its coordinates are in {unit}, not m: add --unit {unit}" in refusal(wing_surface(shape, metres))
        moved = deform(shape, read_surface(file, unit))
        np.testing.assert_allclose(moved.displacement_m, right.displacement_m, atol=1e-4)
    assert "its coordinates are in m, not ft: add --unit m" in refusal(wing_surface(shape), "ft")
    assert "its axes are those of the CAD model: use --axes cad" in refusal(wing_surface(shape, 1, matrix), of=in_cad)
    both = refusal(wing_surface(shape, 0.001, matrix), of=in_cad)
    assert "in mm, not m: add --unit mm; its axes are those of the CAD model" in both
    assert "its axes are those of the survey: use --axes survey" in refusal(wing_surface(shape), axes="cad", of=in_cad)
    turned = np.eye(4)[[1, 2, 0, 3]] * np.array([[-1], [1], [1], [1]])
    assert "its axes are -y, z, x of the survey: turn it" in refusal(wing_surface(shape, 1, turned))
    far = np.eye(4)
    far[:3, 3] = [0, 9, 4]
    assert "give the surface of the measured wing in the axes of the survey" in refusal(wing_surface(shape, 1, far))
    assert "the installation has no [cad]" in refusal(wing_surface(shape), axes="cad")
    # In the axes and the unit of the model the same surface moves in the same way.
    file.write_text(wing_surface(shape, 0.001, matrix))
    moved = deform(in_cad, read_surface(file, "mm"), axes="cad", draws=2)
    np.testing.assert_allclose(moved.displacement_m, right.displacement_m @ matrix[:3, :3].T, atol=1e-5)
    assert (moved.draws[0].points != moved.draws[1].points).any() and len(moved.draws) == 2


def test_unknown_axes_are_never_taken_and_no_unit_is_advised(shape: xr.Dataset, tmp_path: Path) -> None:
    """Before, such surfaces moved by 37 mm or 4.24 m instead of 2.28 m, and the advice was another unit."""
    random, file = np.random.default_rng(2), tmp_path / "wing.obj"
    for _ in range(12):
        matrix = np.eye(4)
        matrix[:3, :3] = Rotation.from_rotvec(random.uniform(0.3, 2) * random.standard_normal(3)).as_matrix()
        matrix[:3, 3] = random.uniform(-20, 20, 3)
        file.write_text(wing_surface(shape, 1.0, matrix))
        with pytest.raises(WingdError) as error:
            deform(shape, file)
        assert "give the surface of the measured wing in the axes of the survey" in str(error.value), error.value


def test_meshes_of_other_packages_and_arrays_are_moved_as_files(shape: xr.Dataset, tmp_path: Path) -> None:
    import meshio
    import pyvista

    file = tmp_path / "wing.obj"
    file.write_text(wing_surface(shape))
    expected = deform(shape, file)
    mesh = meshio.read(file)
    moved = shape.wingd.deform(mesh)
    np.testing.assert_array_equal(moved.mesh.points, expected.points)
    assert (mesh.points == expected.surface.points).all() and len(moved.surface.triangles) == len(
        expected.surface.triangles
    )
    faces = np.hstack([np.full((len(expected.surface.triangles), 1), 3), expected.surface.triangles]).ravel()
    poly = shape.wingd.deform(pyvista.PolyData(mesh.points * 1000, faces), unit="mm")
    np.testing.assert_allclose(poly.mesh.points, expected.points * 1000, rtol=1e-6)
    np.testing.assert_allclose(shape.wingd.deform(mesh.points).mesh, expected.points)
    poly.mesh.save(tmp_path / "wing.vtp")
    np.testing.assert_allclose(read_surface(tmp_path / "wing.vtp", "mm").points, expected.points * 1000, rtol=1e-6)
    np.testing.assert_allclose(deform(shape.wingd.mean(), file).sigma_m, expected.sigma_m, rtol=1e-9)
    for other in (np.zeros((3, 2)), "no.such", np.full((4, 3), np.nan), object()):
        with pytest.raises(WingdError):
            shape.wingd.deform(other)
    with pytest.raises(WingdError, match="has 3 stations, too few"):
        deform(shape.isel(eta=[0, 20, 41]), file)


def test_other_parts_and_folds_are_named(shape: xr.Dataset, tmp_path: Path) -> None:
    file = tmp_path / "nodes.csv"
    axis = shape.ground_position.values
    aside = np.cross([0, 0, 1.0], axis[-1] - axis[0])
    tail, tip = axis[5] + 15 * aside / np.linalg.norm(aside), axis[-1] + 0.05 * (axis[-1] - axis[0])
    file.write_text(nodes(shape) + "".join("{},{},{},{}\n".format(k, *p) for k, p in ((1, tail), (2, tip))))
    notes = deform(shape, read_surface(file)).notes
    assert any("1 of 29 nodes are beyond the outermost marker" in note for note in notes), notes
    assert any("1 of 29 nodes are farther from the bending axis than any chord" in note for note in notes), notes


def test_the_command_writes_the_files_of_the_input(
    shape: xr.Dataset, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file, out = tmp_path / "nodes.csv", tmp_path / "out"
    file.write_text(nodes(shape, "mm", 1000))
    call = [str(DATA / "shape.nc"), "--surface", str(file), "--output", str(out)]
    assert main([*call, "--draws", "1"]) == 0
    printed = capsys.readouterr().out
    assert "27 of 27 nodes moved, by at most 2.9" in printed or "27 of 27 nodes moved" in printed
    names = sorted(str(p.relative_to(out)) for p in out.rglob("*.*"))
    assert names == sorted(f"{folder}surface.{e}" for folder in ("", "draw-001/") for e in ("csv", "vtu", "bdf"))
    table = pd.read_csv(out / "surface.csv")
    assert list(table.columns[:4]) == ["id", "x_mm", "y_mm", "z_mm"] and table.sigma_dz_mm.notna().sum() > 20
    assert main([*call, "--frame", "zz"]) == 1
    assert "there is no frame zz; available: s000001/0001.jpg" in capsys.readouterr().err
    with pytest.raises(SystemExit, match="2"):
        main([*call, "--draws", "-1"])


def test_random_changes_of_surfaces_end_in_a_surface_or_one_error(tmp_path: Path) -> None:
    random = np.random.default_rng(51)
    table = "id,x_m,y_m,z_m\n" + "".join(f"{k},1.5,{k},-0.25\n" for k in range(1, 30))
    files = [(f"{n}{DATA_END[n]}", (DATA / n).read_bytes(), "") for n in DATA_END]
    files += [
        ("a.csv", table.encode(), ""),
        ("a.bdf", BDF.encode(), ""),
        ("a.su2", (DATA / "meshio.su2").read_bytes(), ":1,2"),
    ]
    read = refused = 0
    for name, original, marker in files:
        for _ in range(120):
            content = bytearray(original)
            for _ in range(random.integers(1, 4)):
                at = int(random.integers(len(content)))
                kind = random.integers(6)
                if kind < 2:
                    content[at] = random.integers(256) if kind else b"0123456789.,-=eE \n"[random.integers(18)]
                elif kind == 2:
                    del content[max(at, 1) :]
                elif kind == 3:
                    del content[at]
                    content = content or bytearray(b"x")
                else:
                    content[at:at] = (
                        content[at : at + 40] if kind == 5 else b"9-\n="[random.integers(4)].to_bytes(1, "big")
                    )
            (tmp_path / name).write_bytes(content)
            try:
                surface = read_surface(f"{tmp_path / name}{marker}")
            except WingdError as error:
                refused += 1
                assert "; " in str(error) and "\n" not in str(error)
            else:
                read += 1
                assert np.isfinite(surface.points).all()
                assert surface.triangles.max(initial=0) < len(surface.points)
                if surface.write is not None:
                    surface.write(surface.points)
    assert read > 100 and refused > 150, (read, refused)


DATA_END = {"vtk-binary.stl": "", "vtk-text.stl": ""}
