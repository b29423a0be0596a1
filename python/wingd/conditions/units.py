"""Quantities of the aircraft data, and units as tables write them."""

from __future__ import annotations

import functools
import re
from typing import Any, NamedTuple


class Quantity(NamedTuple):
    """Unit for pint and possible range of a quantity, in the unit of its name."""

    unit: str
    low: float
    high: float


#: Quantities of the canonical table. Tables write values outside the range for missing ones (-9999 and the like).
QUANTITIES = {
    "mach": Quantity("", 0, 3),
    "pressure_altitude_m": Quantity("m", -1e3, 3e4),
    "static_temperature_c": Quantity("degC", -110, 70),
    "total_temperature_c": Quantity("degC", -110, 150),
    "static_pressure_hpa": Quantity("hPa", 10, 1100),
    "cabin_pressure_hpa": Quantity("hPa", 300, 1200),
    "weight_kg": Quantity("kg", 100, 1e6),
    "fuel_kg": Quantity("kg", 0, 5e5),
    "load_factor": Quantity("standard_gravity", -5, 10),
    "flap_deg": Quantity("deg", -20, 90),
    "angle_of_attack_deg": Quantity("deg", -30, 60),
    "sideslip_deg": Quantity("deg", -45, 45),
    "calibrated_airspeed_m_s": Quantity("m/s", 0, 600),
    "true_airspeed_m_s": Quantity("m/s", 0, 1000),
    "centre_of_gravity_percent": Quantity("percent", -50, 150),
    "aileron_deg": Quantity("deg", -60, 60),
    "spoiler_deg": Quantity("deg", -10, 90),
}

#: Spellings of units that pint does not know or reads as another unit, without blanks and points, in lower case.
_SPELLINGS = {
    "c": "degC", "degc": "degC", "celsius": "degC", "f": "degF", "degf": "degF", "fahrenheit": "degF", "k": "kelvin",
    "degk": "kelvin", "kelvin": "kelvin", "r": "degR", "degr": "degR", "rankine": "degR", "fl": "hectofoot", "hft": "hectofoot",
    "kft": "kilofoot", "mb": "millibar", "hpa": "hPa", "pa": "Pa", "kpa": "kPa", "psia": "psi", "lb/in2": "psi", "lbf/in2": "psi",
    "psf": "lbf/ft**2", "lb/ft2": "lbf/ft**2", "lbf/ft2": "lbf/ft**2", "inhg": "inHg", "incheshg": "inHg", "inchhg": "inHg",
    "inchesofmercury": "inHg", "mmhg": "mmHg", "kgs": "kg", "kilograms": "kg", "t": "tonne", "tonnes": "tonne", "lbs": "lb", "lbm": "lb",
    "pounds": "lb", "klb": "kilopound", "klbs": "kilopound", "g": "standard_gravity", "gs": "standard_gravity", "ms-1": "m/s",
    "m/s2": "m/s**2", "m/s²": "m/s**2", "ft/s2": "ft/s**2", "degrees": "deg", "radians": "rad", "kt": "knot", "kts": "knot",
    "knots": "knot", "kph": "km/h", "fps": "ft/s", "%": "percent", "mach": "", "%mac": "percent", "%rc": "percent", "mac": "percent",
    "feet": "ft", "millibars": "millibar", "bars": "bar", "sec": "s", "usgal": "gallon",
}  # fmt: skip
#: Words behind a unit that name its reference, not another unit.
_REFERENCES = set("baro msl amsl agl std abs absolute gps pressure indicated true normal".split())


class Conversion(NamedTuple):
    """Value in the unit of the quantity = scale * number + offset."""

    scale: float
    offset: float

    def same_unit(self, other: Conversion) -> bool:
        """Return whether two conversions are of one unit: scales to 1 %, offsets to 1."""
        return abs(self.scale / other.scale - 1) < 0.01 and abs(self.offset - other.offset) < 1


@functools.cache
def _registry() -> Any:
    try:
        import pint
    except ImportError:
        from wingd import WingdError

        raise WingdError("tables need pint; install it: pip install 'wingd[vision]'") from None
    return pint.UnitRegistry(autoconvert_offset_to_baseunit=True)


@functools.cache
def find_unit(quantity: str, text: str) -> Conversion | str:
    """Find a unit in any usual spelling: ``deg F``, ``°F``, ``ft Baro``, ``inches Hg``.

    Returns
    -------
    Conversion or str
        Conversion to the unit of the quantity; else ``absent`` (no text, or a sign for none), ``wrong`` (a unit of another
        quantity), or ``unknown``.
    """
    plain = re.sub(r"[°º]", "deg ", text.lower()).replace("degrees ", "deg ")
    words = re.findall(r"[^\s._\[\]()]+", plain)
    while len(words) > 1 and words[-1] in _REFERENCES:
        words.pop()
    name = "".join(words)
    if name in ("", "-", "1", "n/a", "none"):
        return "absent"
    if quantity == "mach" and name == "m":
        return Conversion(1.0, 0.0)
    registry, target = _registry(), QUANTITIES[quantity].unit
    # Names longer than a unit's, or with signs that are no unit's, are not given to the parser.
    if name not in _SPELLINGS and not re.fullmatch(r"[a-zµ/*^0-9-]{1,20}", name):
        return "unknown"
    try:
        unit = registry.Unit(_SPELLINGS.get(name, name.replace("^", "**")))
    except Exception:
        return "unknown"
    if not unit.is_compatible_with(target):
        return "wrong"
    # A number without unit is no angle, though pint counts both as dimensionless.
    angles = {"deg", "rad", "mrad", "degree", "radian", "milliradian"}
    if (target == "deg") != (str(unit) in angles) and registry.Unit(target).dimensionless:
        return "wrong"
    zero, one = (registry.Quantity(value, unit).to(target).magnitude for value in (0.0, 1.0))
    # pint multiplies the factors of a unit one after the other: 30.48 becomes 30.479999999999997.
    return Conversion(float(f"{one - zero:.14g}"), float(f"{zero:.14g}"))


def unit_in_name(quantity: str, name: str) -> str | None:
    """Return the unit in a column's name: in brackets (``ALT [ft]``), at its end (``ALT_FT``, ``Alt / ft``), or all of it (``FL``)."""
    bracket = re.search(r"\[([^\]]*)\]|\(([^)]*)\)", name)
    if bracket:
        return bracket[1] if bracket[1] is not None else bracket[2]
    end = re.search(r"(?:^|.[_ /.,])([^_ /.,]{2,})$", name)
    known = end and quantity != "mach" and isinstance(find_unit(quantity, end[1]), Conversion)
    return end[1] if end and known else None


def check_name(name: str) -> str | None:
    """Return the remedy for a name that is a quantity in another case or unit; None for other names."""
    if name in QUANTITIES:
        return None
    low = name.strip().lower()
    if low in QUANTITIES:
        return f"write {low}"
    for known in QUANTITIES:
        base, _, unit = known.partition("_m_s") if known.endswith("_m_s") else known.rpartition("_")
        if unit is None or known in ("mach", "load_factor"):
            base = known
        rest = low.removeprefix(f"{base}_")
        if low == base or (rest != low and isinstance(find_unit(known, rest.replace("_", "/")), Conversion)):
            return f"write {known}" + (
                "" if low == base else f', with the column\'s unit: unit = "{rest.replace("_", "/")}"'
            )
    return None
