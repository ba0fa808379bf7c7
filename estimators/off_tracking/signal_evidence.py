"""Evidence against a signal by itself: readings that cannot be true, and the size of its error as it is measured."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from vehicle.clock import TICK
from vehicle.frames import FloatArray

_REPEATED: Final = 15  # equal values in a row of a sensor that is stuck
_JUMP_SIGMAS: Final = 8.0  # of a sample's noise
_VALUE, _SLOPE = 0.5, 0.1  # gains of an alpha-beta filter [-]
_AHEAD: Final = 0.3  # longest extrapolation of an error [s]


def stuck(readings: FloatArray) -> list[bool]:
    """Signals (k,) that repeat themselves exactly in the newest ``readings`` (n, k) while most others are noisy."""
    recent = readings[-_REPEATED:]
    repeats = (np.ptp(recent, axis=0) == 0.0) & (len(recent) == _REPEATED)
    return [bool(one) and 2 * int(np.sum(repeats)) <= len(repeats) for one in repeats]


def jumps(step: FloatArray, elapsed: float, rates: FloatArray, noise: FloatArray) -> list[bool]:
    """Signals whose ``step`` (k,) within ``elapsed`` [s] exceeds their highest rates (k,) and their noise (k,)."""
    return [bool(one) for one in np.abs(step) > rates * elapsed + _JUMP_SIGMAS * noise]


class SignalError(NamedTuple):
    """Error of a signal and its rate, in units of the signal, tracked by an alpha-beta filter."""

    value: float = 0.0
    slope: float = 0.0  # [1/s]
    tick: int = -1  # of the last measurement; below 0: none yet

    def measured(self, value: float, tick: int, *, exact: bool) -> SignalError:
        """The error after a measurement; an ``exact`` one is taken as it is."""
        if self.tick < 0:
            return SignalError(value, 0.0, tick)
        interval = max(tick - self.tick, 1) * TICK
        expected = self.value + self.slope * interval
        change = value - expected
        slope = self.slope + _SLOPE * change / interval
        return SignalError(expected + (1.0 if exact else _VALUE) * change, slope, tick)

    def at(self, tick: int) -> float:
        """The error at a tick, extrapolated for some tenths of a second at most."""
        return self.value + self.slope * min((tick - self.tick) * TICK, _AHEAD) if self.tick >= 0 else 0.0
