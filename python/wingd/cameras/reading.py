"""Reading of cameras of OpenCV, ROS, Kalibr and mrcal."""

from __future__ import annotations

import math
import tomllib
from dataclasses import dataclass
from pathlib import Path

from wingd import WingdError
from wingd.cameras.declared import BROWN, MODEL_REMEDY, check_keys, model_fault, plain
from wingd.cameras.model import PARAMETERS, Camera, format_of_name
from wingd.keyed import Node, parse_keyed
from wingd.textfiles import fault, read_text

_EXPORT = "export the calibration again, or name its format with --from"
_TERMS = ["k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6", "s1", "s2", "s3", "s4", "tau_x", "tau_y"]


@dataclass(frozen=True)
class ReadCamera:
    """Camera of a file, with the file's format, name of the camera, model as declared, keys that are no part of it, remarks."""

    camera: Camera
    format: str
    name: str = ""
    model: str = ""
    dropped: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()


def _format_of_keys(tree: Node) -> str | None:
    cameras = [tree, *(node for _, node in tree.entries)]
    keys = {key.lower() for camera in cameras for key, _ in camera.entries}
    tagged = any("opencv-" in node.tag for camera in cameras for _, node in camera.entries)
    if "lensmodel" in keys:
        return "mrcal"
    if not tagged and keys & {"intrinsics", "distortion_coeffs"}:
        return "kalibr"
    if not tagged and {"camera_matrix", "distortion_model"} <= keys:
        return "ros"
    return "opencv" if "camera_matrix" in keys else None


def read_camera(file: Path | str, format: str | None = None, camera: str | None = None) -> ReadCamera:
    """Read a camera.

    Parameters
    ----------
    file
        Path of the file.
    format
        A key of :data:`FORMATS`; default: detected from the name and the keys.
    camera
        One of several cameras, by its name in the file.

    Raises
    ------
    WingdError
        The lens model is not supported, a value is impossible, a key changes the image, or the format is not determined.
    """
    path = Path(file)
    named, syntax = format_of_name(path)
    if format == "wingd" or (format is None and named == "wingd"):
        return _read_own(path, camera)
    text_start = read_text(path, 1 << 24).lstrip()[:1]
    guessed = "literal" if format == "mrcal" else "xml" if text_start == "<" else "yaml"
    tree = parse_keyed(path, syntax or guessed)
    format = format or (named if syntax == "literal" else None) or _format_of_keys(tree) or named
    if format is None:
        raise fault(
            path, "has no known camera", "give a file of OpenCV, ROS, Kalibr or mrcal, or its format with --from"
        )
    name, node = _choose(tree, format, camera)
    reader = {"kalibr": _read_kalibr, "mrcal": _read_mrcal}.get(format)
    interior = reader(node) if reader else _read_matrices(node, format == "ros")
    return ReadCamera(
        _checked(interior), format, name, interior.model, tuple(interior.dropped), tuple(interior.remarks)
    )


def _read_own(path: Path, chosen: str | None) -> ReadCamera:
    table = _load_toml(path)
    if chosen is not None:
        raise fault(path, f"has one camera, not named {chosen}", "omit --camera")
    known = {"width", "height", *PARAMETERS, "k4", "k5", "k6"}
    unknown = sorted(set(table) - known - {"covariance", "calibration"})
    if unknown:
        raise fault(path, "is not a key of camera.toml", "delete it", key=unknown[0])
    values = {}
    for key in ("width", "height", *PARAMETERS, "k4", "k5", "k6"):
        value = table.get(key, 0 if key in ("k4", "k5", "k6") else None)
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            problem = "is missing" if value is None else f"is {value}"
            raise fault(path, problem, "give a finite number", key=key)
        values[key] = value if key in ("width", "height") else float(value)
    if not all(isinstance(values[k], int) and 1 <= values[k] <= 100_000 for k in ("width", "height")):
        raise fault(
            path, f"is {values['width']} x {values['height']} px", "give the size of the images in pixels", key="width"
        )
    if min(values["fx"], values["fy"]) <= 0:
        raise fault(path, f"is {values['fx']} px", "give focal lengths in pixels, above 0", key="fx")
    camera = Camera(**values)
    hole = camera.pixel_without_ray()
    if hole:
        problem = f"is not invertible: no ray belongs to the pixel ({hole[0]:.0f}, {hole[1]:.0f})"
        raise fault(path, problem, "calibrate again with points up to the corners", key="k1 to p2")
    dropped = tuple(key for key in ("covariance", "calibration") if key in table)
    return ReadCamera(camera, "wingd", "", "rational" if camera.is_rational else "Brown's", dropped)


def _load_toml(path: Path) -> dict[str, object]:
    try:
        return tomllib.loads(read_text(path, 1 << 24))
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise fault(path, f"is not TOML ({error})", "correct the line") from None


def _choose(tree: Node, format: str, camera: str | None) -> tuple[str, Node]:
    """Return name and keys of the camera: the file itself, or a part of it."""
    keys = (
        {"intrinsics"} if format in ("kalibr", "mrcal") else {"camera_matrix", "distortion_coefficients", "image_width"}
    )
    is_camera = [any(k.lower() in keys for k, _ in node.entries) for node in (tree, *(n for _, n in tree.entries))]
    if is_camera[0]:
        if camera is not None:
            raise fault(tree.file, f"has one camera, not named {camera}", "omit --camera")
        return "", tree
    parts = [part for part, found in zip(tree.entries, is_camera[1:], strict=True) if found]
    names = [name for name, _ in parts]
    if not parts:
        there = ", ".join(name for name, _ in tree.entries[:8])
        raise fault(tree.file, f"is missing; the file has {there}", _EXPORT, key=sorted(keys)[0])
    if camera is None and len(parts) > 1:
        raise fault(tree.file, f"has {len(parts)} cameras: {', '.join(names)}", f"select one: --camera {names[0]}")
    if camera is not None and camera not in names:
        raise fault(tree.file, f"has no camera {camera}", f"its cameras are {', '.join(names)}")
    return parts[names.index(camera) if camera is not None else 0]


@dataclass
class _Interior:
    node: Node
    size: list[float]
    core: list[float]
    terms: list[float]
    model: str
    keys: tuple[str, str, str]
    dropped: list[str]
    remarks: list[str]

    def fault(self, key: int, problem: str, remedy: str) -> WingdError:
        return (self.node.get(self.keys[key]) or self.node).fault(self.keys[key], problem, remedy)


_MATRIX_IGNORED = (
    "camera_name camera_id rectification_matrix projection_matrix calibration_time calibration_date nr_of_frames nframes "
    "board_width board_height square_size marker_size marker_length fix_aspect_ratio aspect_ratio aspectratio flags "
    "flagvalue avg_reprojection_error per_view_reprojection_errors extrinsic_parameters image_points grid_points "
    "nframes_used type_id"
).split()


def _read_matrices(node: Node, of_ros: bool) -> _Interior:
    """Read a camera with a matrix and coefficients: OpenCV's FileStorage, or ROS's camera_info, which declares its model."""
    keys = ("image_width", "camera_matrix", "distortion_coefficients")
    dropped, remarks = check_keys(node, [*keys, "image_height", "distortion_model"], _MATRIX_IGNORED)
    model = _matrix_model(node, of_ros, remarks)
    add = "add the size of the images, px: image_width, image_height"
    size = [node.require(key, add).number(key) for key in ("image_width", "image_height")]
    core = _camera_matrix(node.require(keys[1], _EXPORT))
    of_terms = node.require(keys[2], _EXPORT)
    terms, shape = _matrix_values(of_terms, keys[2])
    if len(terms) not in (4, 5, 8, 12, 14) or (shape and 1 not in shape):
        raise of_terms.fault(keys[2], f"has {len(terms)} numbers", "give 4, 5 or 8 numbers: k1 k2 p1 p2, k3, k4 k5 k6")
    remedy = "name the model that was calibrated"
    if model == "plumb_bob" and len(terms) > 5:
        problem = f"are {len(terms)} numbers, but distortion_model is plumb_bob, which has 5"
        raise of_terms.fault(keys[2], problem, remedy)
    if model == "none" and any(terms):
        raise of_terms.fault(keys[2], "are not all 0, but distortion_model is none", remedy)
    return _Interior(node, size, core, terms, model, keys, dropped, remarks)


def _matrix_model(node: Node, of_ros: bool, remarks: list[str]) -> str:
    declared = node.get("distortion_model")
    if declared is None:
        if of_ros:
            raise node.fault("distortion_model", "is missing", "name the model: plumb_bob or rational_polynomial")
        remarks.append("no lens model is declared: assumed to be OpenCV's k1 k2 p1 p2 k3 k4 k5 k6")
        return "no model declared"
    name = plain("a list" if declared.text is None else declared.text)
    if name in BROWN:
        return "plumb_bob"
    if name in ("", "null"):
        problem = "is empty: this camera was never calibrated"
        raise declared.fault("distortion_model", problem, _EXPORT)
    known = {"rationalpolynomial": "rational_polynomial", "none": "none"}.get(name)
    if known is None:
        raise model_fault(declared, "distortion_model", declared.text or "a list")
    return known


def _matrix_values(node: Node, key: str) -> tuple[list[float], tuple[float, ...]]:
    """Return the numbers of a matrix and its rows and columns, which must agree."""
    if not node.entries:
        return node.numbers(key), ()
    values = node.require("data", _EXPORT).numbers(key)
    sides = [side.number(f"{key}.{name}") for name in ("rows", "cols") if (side := node.get(name)) is not None]
    if len(sides) == 2 and sides[0] * sides[1] != len(values):
        problem = f"has {len(values)} numbers for {sides[0]:g} rows of {sides[1]:g}"
        raise node.fault(key, problem, _EXPORT)
    return values, tuple(sides) if len(sides) == 2 else ()


def _camera_matrix(node: Node) -> list[float]:
    """Return fx, fy, cx, cy of a 3 x 3 matrix without skew."""
    m, shape = _matrix_values(node, "camera_matrix")
    by_rows = "give the matrix by rows: [fx 0 cx], [0 fy cy], [0 0 1]"

    def wrong(problem: str, remedy: str = by_rows) -> WingdError:
        return node.fault("camera_matrix", problem, remedy)

    if len(m) != 9 or shape not in ((), (3.0, 3.0)):
        raise wrong(f"has {len(m)} numbers", "give 3 rows of 3 numbers")
    if not any(m):
        raise wrong("is zero: this camera was never calibrated", "calibrate it, or use the file of its calibration")
    if m[2] == m[5] == 0 and (m[6] or m[7]):
        raise wrong(f"is transposed: row 3 begins with {m[6]:g} and {m[7]:g}, but cx and cy belong in column 3")
    if m[1]:
        raise wrong(f"has a skew of {m[1]:g} px (row 1, column 2), which is not supported", "calibrate without skew")
    for k, want in ((3, 0), (6, 0), (7, 0), (8, 1)):
        if m[k] != want:
            raise wrong(f"has {m[k]:g} in row {k // 3 + 1}, column {k % 3 + 1}, not {want}")
    return [m[0], m[4], m[2], m[5]]


def _counted(node: Node, key: str, count: int) -> list[float]:
    found = node.require(key, _EXPORT)
    values = found.numbers(key) if found.value != [] else []
    if len(values) != count:
        raise found.fault(key, f"has {len(values)} numbers, not {count}", _EXPORT)
    return values


def _word(node: Node, key: str) -> tuple[Node, str]:
    found = node.require(key, _EXPORT)
    if found.text is None:
        raise found.fault(key, "is not a name", _EXPORT)
    return found, found.text.strip()


def _read_kalibr(node: Node) -> _Interior:
    keys = ("resolution", "intrinsics", "distortion_coeffs")
    ignored = (
        "rostopic cam_overlaps T_cn_cnm1 T_cam_imu timeshift_cam_imu line_delay T_cam_body image_width image_height"
    )
    dropped, remarks = check_keys(node, [*keys, "camera_model", "distortion_model"], ignored.split())
    projection, distortion = _word(node, "camera_model"), _word(node, "distortion_model")
    if projection[1] != "pinhole":
        raise model_fault(projection[0], "camera_model", projection[1])
    if distortion[1] not in ("radtan", "none"):
        raise model_fault(distortion[0], "distortion_model", distortion[1])
    terms = _counted(node, keys[2], 4 if distortion[1] == "radtan" else 0)
    size, core = _counted(node, keys[0], 2), _counted(node, keys[1], 4)
    return _Interior(node, size, core, terms, f"pinhole, {distortion[1]}", keys, dropped, remarks)


def _read_mrcal(node: Node) -> _Interior:
    ignored = "extrinsics rt_cam_ref valid_intrinsics_region icam_intrinsics optimization_inputs " \
              "icam_intrinsics_optimization_inputs"  # fmt: skip
    dropped, remarks = check_keys(node, ["lensmodel", "intrinsics", "imagersize"], ignored.split())
    of_model, model = _word(node, "lensmodel")
    counts = {"PINHOLE": 0, "OPENCV4": 4, "OPENCV5": 5, "OPENCV8": 8, "OPENCV12": 12}
    count = counts.get(model.removeprefix("LENSMODEL_")) if model.startswith("LENSMODEL_") else None
    if count is None:
        raise model_fault(of_model, "lensmodel", model)
    values = _counted(node, "intrinsics", 4 + count)
    keys = ("imagersize", "intrinsics", "intrinsics")
    return _Interior(node, _counted(node, "imagersize", 2), values[:4], values[4:], model, keys, dropped, remarks)


def _checked(interior: _Interior) -> Camera:
    """Return the camera; impossible values are refused, unusual ones become remarks."""
    (width, height), (fx, fy, cx, cy) = interior.size, interior.core
    if not all(side == int(side) and 1 <= side <= 100_000 for side in (width, height)):
        raise interior.fault(0, f"is {width:g} x {height:g} px", "give the size of the images in whole pixels")
    if fx == fy == 0:
        problem = "is zero: this camera was never calibrated"
        raise interior.fault(1, problem, "calibrate it, or use the file of its calibration")
    side = max(width, height)
    # A field of view of 136 degrees, the limit of the polynomials, and of 0.5 degrees.
    if not all(0.2 <= f / side <= 100 for f in (fx, fy)):
        problem = f"gives focal lengths of {fx:g} and {fy:g} px, not 0.2 to 100 times the longer side ({side:g} px)"
        raise interior.fault(1, problem, "give fx and fy in pixels, in the right order")
    if not (0 <= cx <= width and 0 <= cy <= height):
        problem = f"puts the principal point at ({cx:g}, {cy:g}) px, outside {width:g} x {height:g} px"
        raise interior.fault(1, problem, "give cx and cy in pixels, in the right order")
    for k, value in enumerate(interior.terms[8:], 8):
        if value:
            model = "thin prism" if k < 12 else "tilt"
            raise interior.fault(2, f"has {_TERMS[k]} = {value:g}, a term of the {model} model", MODEL_REMEDY)
    terms = dict(zip(_TERMS, interior.terms[:8], strict=False))
    camera = Camera(int(width), int(height), fx, fy, cx, cy, **terms)
    hole = camera.pixel_without_ray()
    if hole:
        problem = f"is not invertible: no ray belongs to the pixel ({hole[0]:.0f}, {hole[1]:.0f})"
        raise interior.fault(2, problem, "calibrate again with the board up to the corners")
    if not 0.4 <= fx / side <= 5:
        interior.remarks.append(f"the focal length is {fx / side:.2f} times the longer side; are all lengths in px?")
    if abs(fx / fy - 1) > 0.02:
        interior.remarks.append(f"fx and fy differ by {100 * abs(fx / fy - 1):.0f} %")
    if abs(cx / width - 0.5) > 0.15 or abs(cy / height - 0.5) > 0.15:
        size = f"{width:g} x {height:g} px"
        interior.remarks.append(
            f"the principal point ({cx:g}, {cy:g}) is far from the centre of {size}; is this its size?"
        )
    if max(abs(camera.p1), abs(camera.p2)) > 0.005:
        interior.remarks.append(f"p1 = {camera.p1:g} and p2 = {camera.p2:g} are large; is the order k1 k2 p1 p2 k3?")
    return camera
