"""Operations of a tape as numpy functions; the last argument takes the result."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

import numpy as np

from vehicle.engine.tape import Constant, Entry, Tape
from vehicle.frames import FloatArray


def _minimum(a: Any, b: Any, out: FloatArray) -> None:
    np.minimum(a, b, out=out)  # these two functions need it by name


def _maximum(a: Any, b: Any, out: FloatArray) -> None:
    np.maximum(a, b, out=out)


def _if_else_zero(condition: Any, value: Any, out: FloatArray) -> None:
    out[...] = np.where(condition != 0.0, value, 0.0)


INTO: Final[dict[str, Callable[..., Any]]] = {
    "add": np.add,
    "sub": np.subtract,
    "mul": np.multiply,
    "div": np.divide,
    "neg": np.negative,
    "inv": np.reciprocal,
    "sqrt": np.sqrt,
    "sin": np.sin,
    "cos": np.cos,
    "tan": np.tan,
    "asin": np.arcsin,
    "acos": np.arccos,
    "atan": np.arctan,
    "sinh": np.sinh,
    "cosh": np.cosh,
    "tanh": np.tanh,
    "exp": np.exp,
    "log": np.log,
    "abs": np.absolute,
    "sign": np.sign,
    "floor": np.floor,
    "ceil": np.ceil,
    "not": np.logical_not,
    "pow": np.power,
    "atan2": np.arctan2,
    "hypot": np.hypot,
    "copysign": np.copysign,
    "min": _minimum,
    "max": _maximum,
    "lt": np.less,
    "le": np.less_equal,
    "eq": np.equal,
    "ne": np.not_equal,
    "and": np.logical_and,
    "or": np.logical_or,
    "if_else_zero": _if_else_zero,
}


def evaluated(tape: Tape, arguments: list[FloatArray]) -> FloatArray:
    """Result (..., n) of a tape for arguments (..., size), node by node; for single evaluations."""
    shape = np.broadcast_shapes(*(a.shape[:-1] for a in arguments))
    values: list[FloatArray] = []
    for node in tape.nodes:
        value = np.empty(shape)
        if isinstance(node, Entry):
            value[...] = arguments[node.argument][..., node.place]
        elif isinstance(node, Constant):
            value[...] = node.value
        else:
            INTO[node.name](*(values[a] for a in node.operands), value)
        values.append(value)
    return np.stack([values[k] for k in tape.result], axis=-1) if tape.result else np.empty((*shape, 0))
