"""Units by their names in vehicle files, as the exponents that FMI writes down."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from typing import Final, NamedTuple


class BaseUnit(NamedTuple):
    """SI exponents of a unit and its factor: SI value = factor * value."""

    exponents: Mapping[str, int]
    factor: float = 1.0


_ATOMS: Final = {
    "kg": BaseUnit({"kg": 1}),
    "m": BaseUnit({"m": 1}),
    "s": BaseUnit({"s": 1}),
    "rad": BaseUnit({"rad": 1}),
    "N": BaseUnit({"kg": 1, "m": 1, "s": -2}),
    "Pa": BaseUnit({"kg": 1, "m": -1, "s": -2}),
    "W": BaseUnit({"kg": 1, "m": 2, "s": -3}),
    "Hz": BaseUnit({"s": -1}),
    "deg": BaseUnit({"rad": 1}, math.pi / 180.0),
    "1": BaseUnit({}),
}
_ATOM: Final = re.compile(r"([A-Za-z]+|1)(\d?)")
DISPLAY: Final = {"rad": ("deg", 180.0 / math.pi), "m/s": ("km/h", 3.6), "rad/s": ("deg/s", 180.0 / math.pi)}


def base_unit(name: str) -> BaseUnit | None:
    """The unit in SI; None if its exponents depend on another number, as of some soil moduli."""
    over, _, under = name.partition("/")
    factor, exponents = 1.0, dict[str, int]()
    for part, sign in ((over, 1), (under.removeprefix("(").removesuffix(")"), -1)):
        top, _, bottom = part.partition("/")  # m/s2 in rad/(m/s2)
        for words, direction in ((top, sign), (bottom, -sign)):
            for word in words.split():
                atom = _ATOM.fullmatch(word)
                if atom is None or atom[1] not in _ATOMS:
                    return None
                power = direction * int(atom[2] or 1)
                of_atom = _ATOMS[atom[1]]
                factor *= of_atom.factor**power
                for si, exponent in of_atom.exponents.items():
                    exponents[si] = exponents.get(si, 0) + power * exponent
    return BaseUnit({si: exponent for si, exponent in exponents.items() if exponent}, factor)
