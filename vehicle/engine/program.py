"""A function of state, input and a vehicle's numbers, cut by how often each of them changes."""

from __future__ import annotations

from typing import Any, NamedTuple

from vehicle.engine.stages import stages
from vehicle.engine.tape import Tape, tape_of

_STATE, _INPUT, _PARAMETERS, _NUMBERS = range(4)


class Program(NamedTuple):
    """Three tapes, each of which takes what the ones before it give, behind (state, input, parameters)."""

    numbers: Tape  # once for a vehicle
    held: Tape  # once for an input
    body: Tape  # every time

    @property
    def n_state(self) -> int:
        """Length of the state."""
        return self.body.sizes[_STATE]

    @property
    def n_input(self) -> int:
        """Length of the input."""
        return self.body.sizes[_INPUT]

    @property
    def n_numbers(self) -> int:
        """How many numbers of a vehicle the program works with."""
        return len(self.numbers.result)


def program_of(function: Any) -> Program:
    """The program of a ``casadi.Function`` (state, input, parameters) -> result."""
    numbers, later = stages(tape_of(function), {_PARAMETERS}, forget=True)
    held, body = stages(later, {_INPUT, _NUMBERS}, forget=False)
    return Program(numbers, held, body)
