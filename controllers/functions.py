"""Elementary functions for equations that are written once for floats, numpy arrays and CasADi symbols."""
# ruff: noqa: D102  # the names say it

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from vehicle.frames import FloatArray

if TYPE_CHECKING:
    import casadi as ca

Num = TypeVar("Num", float, FloatArray, "ca.SX")
Array = FloatArray | float


class Functions(Protocol[Num]):
    """Functions of one kind of number: `FLOATS`, `ARRAYS`, or the module ``casadi`` for symbols."""

    def tan(self, x: Num, /) -> Num: ...
    def atan(self, x: Num, /) -> Num: ...
    def atan2(self, y: Num, x: Num, /) -> Num: ...
    def exp(self, x: Num, /) -> Num: ...
    def sqrt(self, x: Num, /) -> Num: ...
    def sign(self, x: Num, /) -> Num: ...
    def fabs(self, x: Num, /) -> Num: ...
    def fmin(self, x: Num | float, y: Num | float, /) -> Num: ...
    def fmax(self, x: Num | float, y: Num | float, /) -> Num: ...
    def if_else(
        self, condition: Num | bool | NDArray[np.bool_], then: Num | float, otherwise: Num | float, /
    ) -> Num: ...


class _Floats:
    tan = staticmethod(math.tan)
    atan = staticmethod(math.atan)
    atan2 = staticmethod(math.atan2)
    fabs = staticmethod(math.fabs)
    sqrt = staticmethod(math.sqrt)

    @staticmethod
    def exp(x: float) -> float:
        return float(np.exp(x))  # to the last bit as of arrays

    @staticmethod
    def sign(x: float) -> float:
        return float((x > 0.0) - (x < 0.0))

    @staticmethod
    def fmin(x: float, y: float) -> float:
        return min(x, y)

    @staticmethod
    def fmax(x: float, y: float) -> float:
        return max(x, y)

    @staticmethod
    def if_else(condition: float | NDArray[np.bool_], then: float, otherwise: float) -> float:
        return then if condition else otherwise


class _Arrays:
    tan, atan, atan2 = np.tan, np.arctan, np.arctan2
    exp, sqrt, sign, fabs, fmin, fmax = np.exp, np.sqrt, np.sign, np.fabs, np.fmin, np.fmax

    @staticmethod
    def if_else(condition: FloatArray | bool | NDArray[np.bool_], then: Array, otherwise: Array) -> FloatArray:
        return np.where(condition, then, otherwise)


FLOATS: Final[Functions[float]] = _Floats()
ARRAYS: Final[Functions[FloatArray]] = _Arrays()


def limited(f: Functions[Num], value: Num, limit: float) -> Num:
    """The value within -limit and limit."""
    return f.fmax(-limit, f.fmin(limit, value))
