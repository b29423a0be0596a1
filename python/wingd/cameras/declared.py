"""Keys that change the rays: lens models and images that a file declares, besides the keys that are read."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable

from wingd import WingdError
from wingd.keyed import Node

MODEL_REMEDY = "calibrate with Brown's model or the rational model: OPENCV4, OPENCV5, OPENCV8, radtan, plumb_bob, rational_polynomial"
#: Lens models that are not supported, as files name them, in letters and digits, without the number of terms. An unknown
#: key with such a value may be another program's key for the model.
_FOREIGN = set(
    "equi equidistant fisheye fisheyeopencv opencvfisheye kannalabrandt kb omni omnidirectional mei ucm eucm ds doublesphere "
    "fov atan scaramuzza ocam ocamcalib cahvor cahvore stereographic equisolid orthographic thinprism thinprismfisheye "
    "tilted division inversebrownconrady".split()
)
#: Parameters of such models: with another value than 0, every ray is another one.
_FOREIGN_KEYS = {
    "xi": "omnidirectional", "alpha": "unified or double sphere", "beta": "unified or double sphere", "fov": "FOV",
    "omega": "FOV", "thinprism": "thin prism", **{k: "thin prism" for k in "s1 s2 s3 s4 sx1 sy1 sx2 sy2".split()},
    **{k: "tilted sensor" for k in "tau taux tauy tilt".split()},
}  # fmt: skip
#: Keys by which an image is another than the calibrated one, with the values that leave it unchanged.
_IMAGE_KEYS = {"binning": {0.0, 1.0}, "binningx": {0.0, 1.0}, "binningy": {0.0, 1.0}, "decimation": {0.0, 1.0},
               "roi": {0.0}, "crop": {0.0}}  # fmt: skip
BROWN = {"plumbbob", "radtan", "brown", "brownconrady"}
_NONE = {"", "0", "false", "no", "none", "off"}


def plain(name: str) -> str:
    """Return a name in lower case, without the signs in which programs differ."""
    return re.sub(r"[^a-z0-9]", "", name.lower())


def model_fault(node: Node, key: str, name: str) -> WingdError:
    """Create the error of a lens model that is not supported."""
    shown = key if name.strip().lower() in ("1", "true", "yes", "on", "") else name.strip()
    return node.fault(key, f'"{shown}" is not a supported lens model', MODEL_REMEDY)


def _is_supported(text: str | None) -> bool:
    if text is None:
        return False
    return text.strip().lower() in _NONE or plain(text) in BROWN | {"pinhole", "rationalpolynomial"}


def _check_image(key: str, node: Node, size: set[tuple[str, str]]) -> None:
    """Refuse binning and regions of interest: the parameters belong to another image."""
    harmless = _IMAGE_KEYS.get(plain(key))
    if harmless is None:
        return
    values = [(k, v.text) for k, v in node.entries] or [("", node.text)]
    for name, text in values:
        if plain(name) in ("dorectify",) or (plain(name), (text or "").strip()) in size:
            continue
        number = re.fullmatch(r"\s*[+-]?\d+(\.\d*)?\s*", text or "")
        if not number or float(number[0]) not in harmless:
            problem = f"is {text}: the images are not those of the calibrated sensor"
            place = f"{key}.{name}" if name else key
            raise node.fault(
                place, problem, "calibrate images as they are used, without binning and region of interest"
            )


def check_keys(node: Node, known: Iterable[str], ignored: Iterable[str]) -> tuple[list[str], list[str]]:
    """Check that every key that may change the rays says nothing of a foreign model or image; returns dropped keys and remarks."""
    known, ignored, dropped, remarks = {k.lower() for k in known}, {k.lower() for k in ignored}, [], []
    size = {(k, (n.text or "").strip()) for k, key in (("width", "image_width"), ("height", "image_height"))
            if (n := node.get(key)) is not None}  # fmt: skip
    for key, value in node.entries:
        if key.lower() in known:
            continue
        declares = any(word in key.lower() for word in ("model", "fisheye", "omni"))
        if declares and not _is_supported(value.text):
            raise model_fault(value, key, value.text or "")
        model = _FOREIGN_KEYS.get(plain(key))
        if model and any(n != 0 for n in _loose_numbers(value)):
            problem = f"is a parameter of the {model} model, which is not a supported lens model"
            raise value.fault(key, problem, MODEL_REMEDY)
        _check_image(key, value, size)
        if key.lower() in ignored or declares or plain(key) in _IMAGE_KEYS:
            dropped.append(key)
        else:
            _check_nested(key, value)
            remarks.append(f"line {value.line}: the key {key} is unknown and not read")
    return dropped, remarks


def _loose_numbers(node: Node) -> list[float]:
    try:
        return (node.get("data") or node).numbers("")
    except WingdError:
        return [math.nan]


def _check_nested(key: str, node: Node) -> None:
    """Refuse an unknown key, or one within its value, that names a foreign model."""
    flagged = any(word in key.lower() for word in ("fisheye", "omni")) and not _is_supported(node.text)
    if flagged or (node.text is not None and plain(node.text).rstrip("0123456789") in _FOREIGN):
        raise model_fault(node, key, node.text or "")
    items = node.value if isinstance(node.value, list) else []
    for item in items:
        for name, value in [item] if isinstance(item, tuple) else item.entries:
            _check_nested(name, value)
