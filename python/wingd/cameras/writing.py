"""Writing of cameras for other programs."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from wingd import WingdError
from wingd.cameras.model import PARAMETERS, Camera, format_of_name


def write_camera(file: Path | str, camera: Camera, format: str | None = None) -> str:
    """Write a camera, without its covariance; returns the format.

    Raises
    ------
    WingdError
        The format cannot represent the lens, or the name does not determine it.
    """
    path = Path(file)
    named, syntax = format_of_name(path)
    format = format or named or ("opencv" if syntax else None)
    if format is None:
        raise WingdError(f"the name {path} does not determine its format; give --to")
    if format == "opencv" and path.suffix.lower() in (".xml", ".json"):
        raise WingdError(f"{path} would be XML or JSON, which are not written; name a .yaml file")
    if format == "kalibr" and (camera.is_rational or camera.k3):
        what = "k4, k5, k6" if camera.is_rational else "k3"
        remedy = (
            "convert to another format"
            if camera.is_rational
            else "calibrate with --select, or convert to another format"
        )
        raise WingdError(f"Kalibr's radtan has no {what}; {remedy}")
    path.write_text(_WRITERS[format](camera))
    return format


def _decimals(values: Iterable[float]) -> str:
    """Format numbers with a point and without exponent: YAML 1.1 takes ``1e-5`` for a text and ``955`` for an integer."""

    def one(value: float) -> str:
        mantissa, _, exponent = repr(float(value)).partition("e")
        if exponent:
            digits = len(mantissa.partition(".")[2])
            mantissa = f"{float(value):.{max(digits - int(exponent), 1)}f}"
        return mantissa

    return ", ".join(one(v) for v in values)


def _matrices(camera: Camera) -> tuple[str, str, int]:
    matrix = [camera.fx, 0, camera.cx, 0, camera.fy, camera.cy, 0, 0, 1]
    return _decimals(matrix), _decimals(camera.terms), len(camera.terms)


def _own_text(c: Camera) -> str:
    keys = [*PARAMETERS, *(["k4", "k5", "k6"] if c.is_rational else [])]
    return f"width = {c.width}\nheight = {c.height}\n" + "".join(f"{k} = {float(getattr(c, k))!r}\n" for k in keys)


def _opencv_text(c: Camera) -> str:
    matrix, terms, count = _matrices(c)
    head = "!!opencv-matrix\n   rows: {}\n   cols: {}\n   dt: d\n   data: [{}]\n"
    return (
        f"%YAML:1.0\n---\nimage_width: {c.width}\nimage_height: {c.height}\ncamera_matrix: {head.format(3, 3, matrix)}"
        f"distortion_coefficients: {head.format(1, count, terms)}"
    )


def _ros_text(c: Camera) -> str:
    matrix, terms, count = _matrices(c)
    projection = _decimals([c.fx, 0, c.cx, 0, 0, c.fy, c.cy, 0, 0, 0, 1, 0])
    block = "{}:\n  rows: {}\n  cols: {}\n  data: [{}]\n"
    return (
        f"image_width: {c.width}\nimage_height: {c.height}\ncamera_name: wingd\n{block.format('camera_matrix', 3, 3, matrix)}"
        f"distortion_model: {'rational_polynomial' if c.is_rational else 'plumb_bob'}\n"
        f"{block.format('distortion_coefficients', 1, count, terms)}"
        f"{block.format('rectification_matrix', 3, 3, _decimals([1, 0, 0, 0, 1, 0, 0, 0, 1]))}"
        f"{block.format('projection_matrix', 3, 4, projection)}"
    )


def _kalibr_text(c: Camera) -> str:
    return (
        f"cam0:\n  camera_model: pinhole\n  distortion_coeffs: [{_decimals(c.terms[:4])}]\n  distortion_model: radtan\n  "
        f"intrinsics: [{_decimals([c.fx, c.fy, c.cx, c.cy])}]\n  resolution: [{c.width}, {c.height}]\n  "
        "rostopic: /cam0/image_raw\n"
    )


def _mrcal_text(c: Camera) -> str:
    values = _decimals([c.fx, c.fy, c.cx, c.cy, *c.terms])
    return (
        f"{{\n    'lensmodel':  'LENSMODEL_OPENCV{len(c.terms)}',\n\n    'extrinsics': [ 0, 0, 0, 0, 0, 0,],\n\n    "
        f"'intrinsics': [ {values},],\n\n    'imagersize': [ {c.width}, {c.height},]\n}}\n"
    )


_WRITERS = {"wingd": _own_text, "opencv": _opencv_text, "ros": _ros_text, "kalibr": _kalibr_text, "mrcal": _mrcal_text}
