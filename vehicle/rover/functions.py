"""The rover's equations as CasADi functions of vectors (state, input, numbers)."""

from __future__ import annotations

from collections.abc import Iterable
from functools import lru_cache
from typing import Any, TypeVar

import casadi as ca
import numpy as np
from pydantic import BaseModel

from vehicle.combination.layout import parts
from vehicle.frames import FloatArray
from vehicle.rover.description import Rover
from vehicle.rover.equations import dynamics
from vehicle.rover.layout import RoverInput, RoverState, input_sizes, state_sizes
from vehicle.rover.soil import Soil

M = TypeVar("M", bound=BaseModel)


def numbers(rover: Rover, soil: Soil | None) -> FloatArray:
    """All physical numbers of a rover and its soil, in the order of the functions' third argument."""
    values = [value for model in (rover, soil) if model is not None for _, value in _numbers(model)]
    return np.array([*values, *rover.footprint[:2]])


def step_function(rover: Rover, soil: Soil | None) -> Any:
    """Function (state, input, numbers) -> state one step later, by the midpoint rule."""
    return _functions(_bare_rover(rover), None if soil is None else _bare(soil))[0]


def load_function(rover: Rover, soil: Soil | None) -> Any:
    """Function (state, input, numbers) -> the wheels' loads [N]."""
    return _functions(_bare_rover(rover), None if soil is None else _bare(soil))[1]


@lru_cache(maxsize=16)
def _functions(rover: Rover, soil: Soil | None) -> tuple[Any, Any]:
    symbols: list[ca.SX] = []
    rover = _symbolic(rover, symbols)
    soil = None if soil is None else _symbolic(soil, symbols)
    symbols += [ca.SX.sym("half_length"), ca.SX.sym("half_width")]
    footprint = rover.footprint._replace(half_length=symbols[-2], half_width=symbols[-1])
    in_state, in_input = state_sizes(len(rover.wheels)), input_sizes(len(rover.wheels))
    x, given = ca.SX.sym("x", sum(in_state)), ca.SX.sym("u", sum(in_input))
    u = RoverInput(*parts(given, in_input))

    def at(state: ca.SX) -> Any:
        return dynamics(rover, footprint, soil, RoverState(*parts(state, in_state)), u)

    now = at(x)
    midway = at(x + 0.5 * u.step * ca.vertcat(*now.rate))
    after = x + u.step * ca.vertcat(*midway.rate)
    arguments = [x, given, ca.vertcat(*symbols)]
    return (
        ca.Function("step", arguments, [ca.cse(ca.densify(after))]),
        ca.Function("loads", arguments, [ca.cse(ca.densify(now.loads))]),
    )


def _numbers(model: BaseModel) -> Iterable[tuple[str, float]]:
    return ((name, value) for name, value in model if isinstance(value, float))


def _bare(model: M) -> M:
    """The model without numbers and names: equal for all models with the same equations."""
    zeros = {name: 0.0 for name, _ in _numbers(model)}
    return type(model).model_construct(**{**dict(model), **zeros, "name": "", "summary": ""})


def _bare_rover(rover: Rover) -> Rover:
    """The same for a rover; the proportions of its wheel places stay."""
    shares = zip(rover.wheels, rover.footprint.along, rover.footprint.across, strict=True)
    wheels = tuple(wheel.model_copy(update={"name": "", "x": x, "y": y}) for wheel, x, y in shares)
    return _bare(rover).model_copy(update={"wheels": wheels})


def _symbolic(model: M, symbols: list[ca.SX]) -> M:
    """The model with a symbol in place of each number; the symbols are appended to the list."""
    own = {name: ca.SX.sym(name) for name, _ in _numbers(model)}
    symbols.extend(own.values())
    return type(model).model_construct(**{**dict(model), **own})
