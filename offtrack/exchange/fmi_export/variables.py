"""Variables of an exported FMU: quantities with units, value references, and the exponents of their units."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Literal, NamedTuple

Causality = Literal["parameter", "input", "output"]


class Quantity(NamedTuple):
    """A number that goes in or comes out."""

    name: str
    unit: str  # SI, "-" for none
    meaning: str
    start: float = 0.0  # of a parameter or input
    low: float | None = None  # limits that the exporter declares; the FMU does not enforce them
    high: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Variable:
    """A quantity as a variable of the FMU."""

    quantity: Quantity
    causality: Causality
    reference: int  # value reference; 0 is the time
    feed_through: tuple[int, ...] = ()  # of an output: references of the inputs that it depends on at once
    held: bool = False  # an output that begins at its start value, and changes in steps alone
    text: str | None = None  # start of a text; None: a number


@dataclass(frozen=True, slots=True, kw_only=True)
class Interface:
    """All vectors of a plant; an entry's place in its vector decides its value reference."""

    parameters: Sequence[Quantity]  # all numbers of the model, with those that are fixed
    fixed: frozenset[int]  # places of parameters that no equation reads: they are no variables
    inputs: Sequence[Quantity]
    outputs: Sequence[Quantity]
    feed_through: Sequence[Sequence[int]]  # by output, places of inputs

    def variables(self) -> tuple[Variable, ...]:
        """Parameters, inputs and outputs with their references, as the C source counts them."""
        first_input = 1 + len(self.parameters)
        first_output = first_input + len(self.inputs)
        parameters = [
            Variable(quantity=quantity, causality="parameter", reference=1 + k)
            for k, quantity in enumerate(self.parameters)
            if k not in self.fixed
        ]
        inputs = [
            Variable(quantity=quantity, causality="input", reference=first_input + k)
            for k, quantity in enumerate(self.inputs)
        ]
        outputs = [
            Variable(
                quantity=quantity,
                causality="output",
                reference=first_output + k,
                feed_through=tuple(first_input + i for i in self.feed_through[k]),
            )
            for k, quantity in enumerate(self.outputs)
        ]
        return (*parameters, *inputs, *outputs)


def numbered(name: str, unit: str, meanings: Iterable[str], start: float = 0.0) -> list[Quantity]:
    """Quantities of one kind, counted from 1: ``name_1``, ``name_2``, ..."""
    return [Quantity(f"{name}_{k}", unit, meaning, start) for k, meaning in enumerate(meanings, start=1)]


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
