"""Units of an FMU's variables, as factors to SI."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

from scenarios.fmi_import.archive import Variable


class Scale(NamedTuple):
    """A unit: the SI unit it stands for, and SI value = factor * value + offset."""

    si: str
    factor: float = 1.0
    offset: float = 0.0


_G: Final = 9.80665  # [m/s2]
UNITS: Final = {
    **{si: Scale(si) for si in ("-", "s", "m", "rad", "m/s", "m/s2", "rad/s", "N", "1/m")},
    "1": Scale("-"),
    "": Scale("-"),
    "%": Scale("-", 0.01),
    "ms": Scale("s", 1e-3),
    "mm": Scale("m", 1e-3),
    "deg": Scale("rad", math.radians(1.0)),
    "degree": Scale("rad", math.radians(1.0)),
    "km/h": Scale("m/s", 1.0 / 3.6),
    "m/s^2": Scale("m/s2"),
    "g": Scale("m/s2", _G),
    "deg/s": Scale("rad/s", math.radians(1.0)),
    "kN": Scale("N", 1e3),
}  # by the names in a map, and in FMUs that do not define their units
_BASE: Final = {
    (): "-",
    (("s", 1),): "s",
    (("m", 1),): "m",
    (("rad", 1),): "rad",
    (("m", 1), ("s", -1)): "m/s",
    (("m", 1), ("s", -2)): "m/s2",
    (("s", -1), ("rad", 1)): "rad/s",
    (("s", -1),): "rad/s",  # radians may be left out
    (("kg", 1), ("m", 1), ("s", -2)): "N",
    (("m", -1),): "1/m",
}  # SI units by exponents, in the order of the FMI standard


def declared_scale(variable: Variable) -> Scale | None:
    """Unit that the FMU declares for a variable; None if it declares none, or one of no signal."""
    if variable.exponents or (variable.unit and (variable.factor, variable.offset) != (1.0, 0.0)):
        si = _BASE.get(variable.exponents)
        return None if si is None else Scale(si, variable.factor, variable.offset)
    return UNITS.get(variable.unit) if variable.unit else None


def fits(scale: Scale, si: str) -> bool:
    """True if a unit measures what an SI unit does; angles may be given as plain numbers, as FMI allows."""
    return scale.si == si or {scale.si, si} <= {"-", "rad"}
