"""Functions of state, input and a vehicle's numbers, split by how often each argument changes."""

from __future__ import annotations

from typing import Any, NamedTuple

from vehicle.engine.stages import stages, with_reciprocals
from vehicle.engine.tape import Tape, tape_of

_STATE, _INPUT, _PARAMETERS, _NUMBERS = range(4)


class Program(NamedTuple):
    """Three tapes; each takes (state, input, parameters) and then the results of the tapes before it."""

    numbers: Tape  # evaluated once per vehicle
    held: Tape  # once per input
    body: Tape  # once per tick

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
        """Number of values that the program derives from a vehicle's numbers."""
        return len(self.numbers.result)


def program_of(function: Any) -> Program:
    """Program of a ``casadi.Function`` (state, input, parameters) -> result."""
    tape = with_reciprocals(tape_of(function), {_INPUT, _PARAMETERS})
    numbers, later = stages(tape, {_PARAMETERS}, forget=True)
    held, body = stages(later, {_INPUT, _NUMBERS}, forget=False)
    return Program(numbers, held, body)
