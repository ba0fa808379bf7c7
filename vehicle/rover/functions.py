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
from vehicle.rover.equations import balance
from vehicle.rover.layout import INPUT_SIZES, STATE_SIZES, RoverInput, RoverState
from vehicle.rover.soil import Soil

M = TypeVar("M", bound=BaseModel)


def numbers(rover: Rover, soil: Soil | None) -> FloatArray:
    """Every physical number of a rover and its soil, in the order in which the functions take them."""
    return np.array([value for model in (rover, soil) if model is not None for _, value in _numbers(model)])


def step_function(rover: Rover, soil: Soil | None) -> Any:
    """Function (state, input, numbers) -> state one step later, by the midpoint rule."""
    return _functions(_bare(rover), None if soil is None else _bare(soil))[0]


def load_function(rover: Rover, soil: Soil | None) -> Any:
    """Function (state, input, numbers) -> the wheels' loads [N]."""
    return _functions(_bare(rover), None if soil is None else _bare(soil))[1]


@lru_cache(maxsize=16)
def _functions(rover: Rover, soil: Soil | None) -> tuple[Any, Any]:
    symbols: list[ca.SX] = []
    rover = _symbolic(rover, symbols)
    soil = None if soil is None else _symbolic(soil, symbols)
    x, given = (ca.SX.sym(name, sum(sizes)) for name, sizes in (("x", STATE_SIZES), ("u", INPUT_SIZES)))
    u = RoverInput(*parts(given, INPUT_SIZES))

    def at(state: ca.SX) -> Any:
        return balance(rover, soil, RoverState(*parts(state, STATE_SIZES)), u)

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
    """The model without its numbers and names: equal for all that the same equations serve."""
    zeros = {name: 0.0 for name, _ in _numbers(model)}
    return type(model).model_construct(**{**dict(model), **zeros, "name": "", "summary": ""})


def _symbolic(model: M, symbols: list[ca.SX]) -> M:
    """The model with a symbol for each of its numbers, which go to the end of the list."""
    own = {name: ca.SX.sym(name) for name, _ in _numbers(model)}
    symbols.extend(own.values())
    return type(model).model_construct(**{**dict(model), **own})
