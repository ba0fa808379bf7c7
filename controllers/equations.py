"""Functions for equations on floats, arrays and CasADi symbols, and the lag of a steering actuator."""

import math
from typing import TYPE_CHECKING, Final, Protocol, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vehicle.frames import FloatArray

if TYPE_CHECKING:
    import casadi as ca


# ruff: noqa: D102  # the names say it


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


def settled(
    f: Functions[Num], angle: Num, demand: Num, duration: Num | float, *, lag: float, max_rate: Num | float
) -> Num:
    """Angle [rad] ``duration`` [s] after the demand [rad] was set: exact for d(angle)/dt = clip((demand - angle)/lag).

    ``lag`` [s] is the first-order time constant (zero: the rate limit alone), ``max_rate`` [rad/s] the limit.
    """
    gap = demand - angle
    # The rate is at its limit while |gap| > max_rate lag; from there on the gap decays exponentially.
    linear = f.fmin(f.fmax(f.fabs(gap) / max_rate - lag, 0.0), duration)  # time at the limit [s]
    remaining = f.fabs(gap) - max_rate * linear
    if lag > 0.0:
        remaining = remaining * f.exp((linear - duration) / lag)
    return demand - f.sign(gap) * remaining


def settle(
    angle: ArrayLike, demand: ArrayLike, duration: ArrayLike, *, lag: float, max_rate: FloatArray | float
) -> FloatArray:
    """`settled` for arrays."""
    angle, demand = np.asarray(angle, dtype=np.float64), np.asarray(demand, dtype=np.float64)
    duration = np.asarray(duration, dtype=np.float64)
    return settled(ARRAYS, angle, demand, duration, lag=lag, max_rate=max_rate)
