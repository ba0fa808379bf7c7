"""Functions of state, input and a vehicle's numbers, split by how often each argument changes."""

from __future__ import annotations

from itertools import accumulate, pairwise
from typing import Any, NamedTuple

from vehicle.engine.composite import AnyFunction, composite
from vehicle.engine.stages import stages, with_reciprocals
from vehicle.engine.tape import Tape, tape_of

_STATE, _INPUT, _PARAMETERS = range(3)


class Part(NamedTuple):
    """Three tapes of one function; each takes its arguments and then the results of the tapes before it."""

    numbers: Tape  # evaluated once per vehicle
    held: Tape  # once per input
    body: Tape  # at every call


class PartCall(NamedTuple):
    """Call of a part, as ``composite.Call``."""

    part: int
    state: int
    results: tuple[int, ...]


class Program(NamedTuple):
    """Functions, and the calls of them that make up one tick."""

    parts: tuple[Part, ...]
    calls: tuple[PartCall, ...]

    @property
    def n_state(self) -> int:
        """Length of the state."""
        return self.parts[self.calls[0].part].body.sizes[_STATE]

    @property
    def n_input(self) -> int:
        """Length of the input."""
        return self.parts[0].body.sizes[_INPUT]

    @property
    def n_result(self) -> int:
        """Length of the result."""
        return len(self.parts[self.calls[-1].part].body.result)

    @property
    def numbers_of(self) -> list[slice]:
        """Place of every part's numbers among the values that the program derives from a vehicle's numbers."""
        ends = list(accumulate((len(part.numbers.result) for part in self.parts), initial=0))
        return [slice(start, stop) for start, stop in pairwise(ends)]

    @property
    def n_numbers(self) -> int:
        """Number of values that the program derives from a vehicle's numbers."""
        return sum(len(part.numbers.result) for part in self.parts)


def program_of(function: AnyFunction) -> Program:
    """Program of a function (state, input, parameters) -> result, or of a composite of several."""
    calls = composite(function).calls
    functions = list(dict.fromkeys(call.function for call in calls))
    numbered = {of: k for k, of in enumerate(functions)}
    return Program(
        tuple(_part(of) for of in functions),
        tuple(PartCall(numbered[call.function], call.state, call.results) for call in calls),
    )


def _part(function: Any) -> Part:
    of_scalars = function.expand() if function.is_a("MXFunction") else function
    tape = with_reciprocals(tape_of(of_scalars), {_INPUT, _PARAMETERS})
    numbers, later = stages(tape, {_PARAMETERS}, forget=True)
    held, body = stages(later, {_INPUT, len(tape.sizes)}, forget=False)
    return Part(numbers, held, body)
