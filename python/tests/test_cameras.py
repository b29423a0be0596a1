"""Promise: a camera of another program is read as its own program reads it, or refused with the cause by name."""

from __future__ import annotations

import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from wingd import WingdError
from wingd.cameras import Camera, read_camera, read_kalibr_board, write_camera
from wingd.commands.convert import main

DATA = Path(__file__).parent / "data" / "cameras"
LENS = Camera(1920, 1200, 2410.5, 2409.8, 955.0, 610.0, -0.11, 0.07, 0.0003, -0.0002, 0.01)

#: Files and words of their refusal; the others are read as the program read them.
REFUSED = {
    "comment_camera_info.yaml": 'line 9, distortion_model: "equidistant" is not a supported lens model',
    "opencv-equidistant.yaml": 'distortion_model: "equidistant" is not a supported lens model',
    "opencv-fisheye-flag.yml": "fisheye_model",
    "cahvor.cameramodel": 'lensmodel: "LENSMODEL_CAHVOR" is not a supported lens model',
    "nocomma_camera_info.yaml": "distortion_coefficients: has 5 numbers without commas",
    "zeros_camera_info.yaml": "camera_matrix: is zero: this camera was never calibrated",
    "skew_camera_info.yaml": "camera_matrix: has a skew of 4.26 px (row 1, column 2)",
    "transposed_camera_info.yaml": "camera_matrix: is transposed",
    "stereo-camchain.yaml": "has 2 cameras: cam0, cam1; select one: --camera cam0",
    "binned.yaml": "line 23, binning_x: is 2",
    "roi.yaml": "roi.x_offset: is 100",
    "omnidir-fov.yaml": "line 15, fov: is a parameter of the FOV model",
    "omnidir-matrix.yaml": "xi: is a parameter of the omnidirectional model",
    "omnidir-number.yaml": "xi: is a parameter of the omnidirectional model",
    "omnidir-thin-prism-tilt.yaml": "thin_prism: is a parameter of the thin prism model",
}
FILES = sorted(p.name for p in DATA.iterdir() if p.suffix not in (".md", "") and p.is_file())


@pytest.mark.parametrize("name", FILES)
def test_every_case_is_read_as_the_program_read_it_or_refused_by_name(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "camera.toml"
    status, printed = main([str(DATA / name), str(out)]), capsys.readouterr()
    if name in REFUSED:
        assert status == 1 and REFUSED[name] in printed.err and not out.exists(), printed.err
        assert printed.err.count("\n") == 1 and "; " in printed.err
    else:
        golden = tomllib.loads((DATA / "golden" / f"{name}.toml").read_text())
        assert status == 0 and tomllib.loads(out.read_text()) == golden, printed.err
        assert f"fx {golden['fx']}" in printed.out and "dropped: " in printed.out


@pytest.mark.parametrize("lens", ["brown", "rational"])
@pytest.mark.parametrize("name", ["opencv.yaml", "camera_info.yaml", "camchain.yaml", "x.cameramodel", "written.toml"])
def test_files_are_written_as_the_program_wrote_them(lens: str, name: str, tmp_path: Path) -> None:
    golden, out = DATA / "golden" / f"{lens}-{name}", tmp_path / name
    camera = read_camera(DATA / "golden" / f"{lens}.toml").camera
    if not golden.exists():
        with pytest.raises(WingdError, match="radtan has no k4, k5, k6"):
            write_camera(out, camera)
        return
    write_camera(out, camera)
    if name.endswith("toml"):
        assert tomllib.loads(out.read_text()) == tomllib.loads(golden.read_text())
    else:
        assert out.read_text() == golden.read_text()
    assert read_camera(out).camera == camera


def read(folder: Path, text: str, name: str = "x_camera_info.yaml", **options: str) -> Camera:
    (folder / name).write_text(text)
    return read_camera(folder / name, **options).camera


def refusal(folder: Path, text: str, name: str = "x_camera_info.yaml") -> str:
    with pytest.raises(WingdError) as error:
        read(folder, text, name)
    assert "; " in str(error.value) and "\n" not in str(error.value)
    return str(error.value)


def ros(
    model: str,
    matrix: str = "2410.5, 0, 955, 0, 2409.8, 610, 0, 0, 1",
    terms: str = "-0.11, 0.07, 0.0003, -0.0002, 0.01",
) -> str:
    count = len(terms.split(","))
    return (
        f"image_width: 1920\nimage_height: 1200\ncamera_matrix: {{rows: 3, cols: 3, data: [{matrix}]}}\n"
        f"distortion_model: {model}\ndistortion_coefficients: {{rows: 1, cols: {count}, data: [{terms}]}}\n"
    )


BROWN = "-0.11, 0.07, 0.0003, -0.0002, 0.01"
NAMED = [
    (ros("thin_prism"), '"thin_prism" is not a supported lens model'),
    (ros("rational_polynomial", terms=f"{BROWN}, 0, 0, 0, 0.001, 0, 0, 0"), "s1 = 0.001, a term of the thin prism model"),
    (ros("rational_polynomial", terms=f"{BROWN}, 0, 0, 0, 0, 0, 0, 0, 0.02, 0"), "tau_x = 0.02, a term of the tilt model"),
    (ros("plumb_bob", terms=f"{BROWN}, 0, 0, 0, 0, 0, 0, 0, 0, 0"), "are 14 numbers, but distortion_model is plumb_bob"),
    (ros("KannalaBrandt8"), '"KannalaBrandt8" is not a supported lens model'),
    (ros("none"), "are not all 0, but distortion_model is none"),
    (ros("~"), "is empty: this camera was never calibrated"),
    (ros("''"), "is empty: this camera was never calibrated"),
    (ros("plumb_bob") + "lens: {maker: x, type: Kannala-Brandt4}\n", '"Kannala-Brandt4" is not a supported'),
    (ros("plumb_bob") + "lens: {fisheye: yes}\n", 'line 6, fisheye: "fisheye" is not a supported'),
    (ros("plumb_bob") + "base: &b {x: 1}\nm:\n  <<: *b\n", "<<: merges keys from elsewhere"),
    ("M1: {rows: 3}\nD1: [0]\nM2: {rows: 3}\n", "is missing; the file has M1, D1, M2"),
    (ros("plumb_bob", "2.4, 0, 0.9, 0, 2.4, 0.6, 0, 0, 1"), "focal lengths of 2.4 and 2.4 px"),
    (ros("plumb_bob", "2410, 0, 2955, 0, 2410, 610, 0, 0, 1"), "principal point at (2955, 610)"),
    (ros("plumb_bob", "2410, 0, 955, 0, 2410, 610, 0, 0, 2"), "has 2 in row 3, column 3, not 1"),
    (ros("plumb_bob", terms="-0.11, 0.07, .nan, 0, 0"), '".nan" is not a finite number'),
    (ros("plumb_bob", terms="-0.11, 0.07, 1e308, 0, 1e999"), '"1e999" is not a finite number'),
    (ros("plumb_bob", terms="-0.11, 0.07, 0"), "has 3 numbers"),
    (ros("plumb_bob", terms="-9, 0.07, 0, 0, 0"), "is not invertible: no ray belongs to the pixel"),
    (ros("plumb_bob") + "image_width: 1920\n", "image_width: occurs twice"),
    (ros("plumb_bob") + "Image_Width: 1920\n", "Image_Width: occurs twice"),
    (ros("plumb_bob") + "---\nx: 1\n", "several documents"),
    (ros("plumb_bob") + "\tx: 1\n", "is not YAML"),
    (ros("plumb_bob") + "binning_y: 4\n", "line 6, binning_y: is 4"),
    (ros("plumb_bob") + "roi: {x_offset: 0, y_offset: 0, height: 600, width: 800}\n", "roi.height: is 600"),
    (ros("plumb_bob") + "roi: [0, 0, 800, 600]\n", "roi: is None"),
    ("x: " + "[" * 5000, "is more than 64 levels deep"),
    ("a: &a [1,1,1,1,1,1,1,1,1,1]\n" + "".join(f"{chr(98 + k)}: &{chr(98 + k)} [{', '.join(['*' + chr(97 + k)] * 10)}]\n" for k in range(7)), "more than 200000 values"),
]  # fmt: skip


@pytest.mark.parametrize(("text", "words"), NAMED)
def test_unsupported_models_elements_and_images_are_named(tmp_path: Path, text: str, words: str) -> None:
    assert words in refusal(tmp_path, text)


@pytest.mark.parametrize("more", ["binning_x: 0\nbinning_y: 1\n", "roi:\n  x_offset: 0\n  height: 0\n  do_rectify: false\n", "roi: {width: 1920, height: 1200, x_offset: 0}\n", "xi: 0.\n", "thin_prism: [ 0., 0., 0., 0. ]\n", "...\n---\n~\n", "---\n"])  # fmt: skip
def test_values_that_leave_the_image_unchanged_are_read(tmp_path: Path, more: str) -> None:
    for model in ("radtan", "Brown Conrady", "Plumb Bob", "plumb_bob"):
        assert read(tmp_path, ros(model) + more) == LENS


def test_parts_aliases_and_blocks_are_read(tmp_path: Path) -> None:
    inner = "".join(f"  {line}\n" for line in ros("plumb_bob").splitlines())
    (tmp_path / "x.yaml").write_text(f"meta:\n  date: 2026-06-01\ncamera:\n{inner}")
    found = read_camera(tmp_path / "x.yaml")
    assert (found.camera, found.name, found.format) == (LENS, "camera", "ros")
    aliased = "x: &m [2410.5, 0, 955, 0, 2409.8, 610, 0, 0, 1]\n" + ros("plumb_bob", "*m").replace("[*m]", "*m")
    assert read(tmp_path, aliased) == LENS
    zero = f"{BROWN}, 0, 0, 0, 0, 0, 0, 0, 0, 0"
    assert read(tmp_path, ros("rational_polynomial", terms=zero)) == LENS, "terms of 0 are no other model"
    commented = (DATA / "opencv.json").read_text().replace("1920,", '1920, // "image_width": 1280,')
    assert read(tmp_path, commented.replace("{\n", '{\n// a, "b": c\n', 1), "x.json") == LENS


def test_every_unsupported_model_of_kalibr_and_mrcal_is_named(tmp_path: Path) -> None:
    kalibr = ("cam0:\n  camera_model: {}\n  distortion_model: {}\n  intrinsics: [2410.5, 2409.8, 955, 610]\n"
              "  distortion_coeffs: [-0.11, 0.07, 0.0003, -0.0002]\n  resolution: [1920, 1200]\n")  # fmt: skip
    for models in ("omni radtan", "eucm none", "ds none", "pinhole equidistant", "pinhole fov", "double_sphere radtan"):
        assert "is not a supported lens model" in refusal(tmp_path, kalibr.format(*models.split()), "camchain.yaml")
    for model in ("CAHVOR", "CAHVORE_linearity=0.37", "STEREOGRAPHIC", "LONLAT", "SPLINED_STEREOGRAPHIC_order=3_Nx=30"):
        text = f"{{'lensmodel': 'LENSMODEL_{model}', 'intrinsics': [2410.5, 2409.8, 955, 610], 'imagersize': [1920, 1200]}}"
        assert f'"LENSMODEL_{model}" is not a supported lens model' in refusal(tmp_path, text, "x.cameramodel")
    for text, words in (
        ("{'lensmodel': __import__('os').getcwd(), 'intrinsics': [1, 2, 3, 4]}", "is not a supported lens model"),
        ("{'lensmodel': 'a' 'b', 1: 2}", "is not YAML"),
        ("{'lensmodel': ", "is not YAML"),
        ("[" * 3000, "is more than 64 levels deep"),
    ):
        assert words in refusal(tmp_path, text, "x.cameramodel") or "too many nested" in refusal(
            tmp_path, text, "x.cameramodel"
        )
    for text, words in (
        ("<a/>", "begins with <a>"),
        ("<opencv_storage><b></opencv_storage>", "is not XML (mismatched tag)"),
        ('<!DOCTYPE x [<!ENTITY a "b">]><opencv_storage>&a;</opencv_storage>', "defines entities"),
        ("<opencv_storage>" + "<a>" * 100, "is more than 64 levels deep"),
    ):
        assert words in refusal(tmp_path, text, "x.xml")


def test_one_of_several_cameras_is_read_by_its_name(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    stereo, out = str(DATA / "stereo-camchain.yaml"), str(tmp_path / "camera.toml")
    assert main(["--camera", "cam0", stereo, out]) == 0
    printed = capsys.readouterr().out
    assert "cam0, pinhole, radtan" in printed and "fx 1210.5" in printed
    assert main(["--camera", "cam7", stereo, out]) == 1 and "its cameras are cam0, cam1" in capsys.readouterr().err
    assert main(["--camera", "cam0", out, out]) == 1 and "omit --camera" in capsys.readouterr().err
    assert main([stereo, str(tmp_path / "x.dat"), "--camera", "cam0"]) == 1 and "give --to" in capsys.readouterr().err
    with pytest.raises(SystemExit, match="2"):
        main([stereo, out, "--to", "maya"])


def test_a_camera_toml_is_checked(tmp_path: Path) -> None:
    text = (DATA / "golden" / "brown.toml").read_text()
    for old, new, words in (("fx = 2410.5", "fx = nan", "fx: is nan"), ("k3 = 0.0", "k9 = 0.0", "k9: is not a key"), ("k3 = 0.0", "", "k3: is missing"), ("width = 1920", "width = true", "width: is True"), ("= 2409.8", "= -1.0", "px; give focal lengths"), ("fx =", "fx", "is not TOML")):  # fmt: skip
        assert words in refusal(tmp_path, text.replace(old, new), "camera.toml")


GRID = (
    "target_type: 'aprilgrid' # gridtype\ntagCols: 6\ntagRows: 5\ntagSize: 0.088 # m\ntagSpacing: 0.3\ncodeOffset: 0\n"
)
CHECKS = "target_type: checkerboard\ntargetCols: 8\ntargetRows: 6\nrowSpacingMeters: 0.025\ncolSpacingMeters: 0.025\n"


def test_a_board_of_kalibr_becomes_board_toml(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file, out = tmp_path / "target.yaml", tmp_path / "board.toml"
    for text, board in (
        (GRID, {"pattern": "aprilgrid", "columns": 6, "rows": 5, "tag_m": 0.088, "spacing": 0.3}),
        (CHECKS, {"pattern": "checkerboard", "columns": 8, "rows": 6, "square_m": 0.025}),
    ):
        file.write_text(text)
        assert main([str(file), str(out)]) == 0 and tomllib.loads(out.read_text()) == board, capsys.readouterr()
    for text, words in (
        (CHECKS.replace("colSpacingMeters: 0.025", "colSpacingMeters: 0.03"), "only squares are supported"),
        (GRID.replace("aprilgrid", "circlegrid"), '"circlegrid" is not a supported target'),
        (GRID.replace("codeOffset: 0", "codeOffset: 36"), "line 6, codeOffset: is not 0"),
        (f"{GRID}tagFamily: t25h9\n", "line 7, tagFamily: is not a known key of a target"),
        (f"{GRID}targetCols: 7\n", "line 7, targetCols: is not a known key of a target"),
        (GRID.replace("tagCols: 6", "tagCols: 6.5"), "tagCols: is 6.5"),
        (GRID.replace("0.088", "88"), "88 m, a board of 528 m; give metres: 0.088 for 88 mm"),
        (GRID.replace("tagRows: 5", "tagRow: 5"), "tagRows: is missing"),
    ):
        file.write_text(text)
        with pytest.raises(WingdError) as error:
            read_kalibr_board(file)
        assert words in str(error.value)


def pieces(kind: str) -> dict[str, str]:
    """Blocks of a file of a format, written by this test alone; their order has no meaning."""
    matrix, terms = (
        "2410.5, 0.0, 955.25, 0.0, 2409.8, 610.75, 0.0, 0.0, 1.0",
        "-0.1123, 0.0745, 0.00031, -0.00027, 0.0123",
    )
    tag = " !!opencv-matrix" if kind == "opencv" else ""
    if kind in ("opencv", "ros"):
        block = "{}:{}\n   rows: {}\n   cols: {}\n   data: [ {} ]\n"
        blocks = {"width": "image_width: 1920\n", "height": "image_height: 1200\n", "matrix": block.format("camera_matrix", tag, 3, 3, matrix),
                  "terms": block.format("distortion_coefficients", tag, 1, 5, terms)}  # fmt: skip
        return blocks | ({"model": "distortion_model: plumb_bob\n"} if kind == "ros" else {})
    if kind == "kalibr":
        terms = ", ".join(terms.split(", ")[:4])
        return {"p": "  camera_model: pinhole\n", "model": "  distortion_model: radtan\n", "core": "  intrinsics: [2410.5, 2409.8, 955.25, 610.75]\n",
                "terms": f"  distortion_coeffs: [{terms}]\n", "size": "  resolution: [1920, 1200]\n"}  # fmt: skip
    return {"model": "    'lensmodel': 'LENSMODEL_OPENCV5',\n", "core": f"    'intrinsics': [ 2410.5, 2409.8, 955.25, 610.75, {terms},],\n",
            "size": "    'imagersize': [ 1920, 1200,],\n"}  # fmt: skip


FRAMES = {"opencv": ("camera.yaml", "%YAML:1.0\n---\n", ""), "ros": ("wing_camera_info.yaml", "", ""),
          "kalibr": ("wing-camchain.yaml", "cam0:\n", ""), "mrcal": ("wing.cameramodel", "{\n", "}\n")}  # fmt: skip
COMMENTS = [
    "image_width: 1280",
    "'lensmodel': 'LENSMODEL_CAHVOR',",
    "data: [999.0, 0.0, 640.0]",
    "distortion_model: equidistant",
    "[ ] { } , : ' \"",
]


@pytest.mark.parametrize("kind", list(FRAMES))
def test_a_changed_file_is_never_silently_another_camera(kind: str, tmp_path: Path) -> None:
    random = np.random.default_rng(5)
    name, before, after = FRAMES[kind]
    lens = Camera(1920, 1200, 2410.5, 2409.8, 955.25, 610.75, -0.1123, 0.0745, 0.00031, -0.00027, 0.0123)
    lens = replace(lens, k3=0.0) if kind == "kalibr" else lens
    refused = other = 0
    for k in range(600):
        blocks = list(pieces(kind).values())
        same = k % 6 < 2
        if k % 6 == 0:
            random.shuffle(blocks)
        elif k % 6 == 1:
            blocks.insert(int(random.integers(len(blocks))), f"# {random.choice(COMMENTS)}\n")
        at = int(random.integers(len(blocks)))
        block = blocks[at]
        if k % 6 == 2:  # a letter of a word
            letters = [i for i, c in enumerate(block) if c.isalpha()]
            i = int(random.choice(letters))
            blocks[at] = block[:i] + random.choice(["", "x", block[i] * 2]) + block[i + 1 :]
        elif k % 6 == 3:  # a word for a number
            numbers = [
                w for w in block.replace("[", " ").replace("]", " ").replace(",", " ").split() if w[0] in "-0123456789"
            ]
            if numbers:
                words = ["nan", "inf", "-inf", "NCD", "1e400", "", "0x10", "1,5", "1_0", "[1]", "~", "'"]
                blocks[at] = block.replace(str(random.choice(numbers)), str(random.choice(words)), 1)
        elif k % 6 == 4:  # a list reversed, cut or lengthened
            if "[" in block:
                head, _, rest = block.partition("[")
                values = [v.strip() for v in rest.partition("]")[0].split(",") if v.strip()]
                values = [values[::-1], values[:-1], [*values, "0.5"], values[1:] + values[:1]][int(random.integers(4))]
                tail = rest.partition("]")[2]
                blocks[at] = f"{head}[ {', '.join(values)} ]{tail}"
        elif k % 6 == 5:  # a foreign model, or a line dropped or doubled
            models = ["equidistant", "fisheye", "eucm", "ds", "LENSMODEL_CAHVOR", "thin_prism", "KannalaBrandt8"]
            foreign = str(random.choice(models))
            blocks[at] = random.choice(
                [
                    block.replace("plumb_bob", foreign)
                    .replace("radtan", foreign)
                    .replace("LENSMODEL_OPENCV5", foreign),
                    "",
                    block * 2,
                ]
            )
        (tmp_path / name).write_text(before + "".join(blocks) + after)
        try:
            found = read_camera(tmp_path / name)
        except WingdError as error:
            refused += 1
            assert not same and "; " in str(error) and "\n" not in str(error), (k, blocks, error)
            continue
        is_quiet = all("no lens model is declared" in remark for remark in found.remarks)
        other += found.camera != lens
        assert found.camera == lens or not (same or is_quiet), (k, "".join(blocks), found)
    assert refused > 200, refused
