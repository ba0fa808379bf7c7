"""Variables of an exported FMU: quantities with units, and their value references."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

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
