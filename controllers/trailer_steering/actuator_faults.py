"""Kinds of faults of steering actuators, and which of them explains what an actuator did.

Each hypothesis is the model of a sound actuator with other numbers: it moves to ``gain * demand + offset`` with the
known lag, at a rate limit of its own, some time after the demand was sent. All start from the measured angle at the
beginning of a window. The likeliest explains it; a free number has to gain more than noise would give it (Akaike's
criterion).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, Literal, NamedTuple

import numpy as np

from controllers.actuator import settle
from vehicle.clock import TICK
from vehicle.frames import FloatArray

Kind = Literal["sound", "stuck", "dead", "slow", "offset", "late"]

_STILL: Final = 1e-9  # rate of an actuator that does not move [rad/s]
_CENTRING: Final = tuple(np.radians([1.0, 2.0, 3.0, 5.0, 8.0, 12.0, 20.0]).tolist())  # rates of dead actuators [rad/s]
_SHARES: Final = (0.02, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.7)  # rate limits of slow ones over their own [-]
_DELAYS: Final = (0.1, 0.15, 0.2, 0.3, 0.4, 0.6, 0.8)  # of demands that come late [s]
_GROWN: Final = (0.9, 1.0, 1.1, 1.3, 1.7, 2.5)  # an offset over the newest residual, which may still grow


class Hypothesis(NamedTuple):
    """An actuator that may be at fault."""

    kind: Kind
    rate: float  # limit [rad/s]
    gain: float = 1.0  # of the demand [-]
    offset: float = 0.0  # [rad]
    delay: float = 0.0  # [s]

    @property
    def is_free(self) -> bool:
        """True if a number of it is fitted."""
        return self.kind not in ("sound", "stuck")


class Window(NamedTuple):
    """Demands of one actuator and what it did over a short time; oldest first."""

    ticks: FloatArray  # (n,)
    sent: FloatArray  # (n,) demands, each until the next [rad]
    angles: FloatArray  # (n,) measured [rad]
    std: FloatArray  # (n,) of the difference between a sound actuator and its model [rad]


def candidates(residual: float, rate: float) -> list[Hypothesis]:
    """Hypotheses for a ``residual`` [rad] of an actuator with this rate limit [rad/s]; the sound one comes first."""
    return [
        Hypothesis("sound", rate),
        Hypothesis("stuck", _STILL),
        *(Hypothesis("dead", centring, gain=0.0) for centring in _CENTRING),
        *(Hypothesis("slow", share * rate) for share in _SHARES),
        *(Hypothesis("offset", rate, offset=grown * residual) for grown in _GROWN),
        *(Hypothesis("late", rate, delay=delay) for delay in _DELAYS),
    ]


def misfits(
    window: Window, hypotheses: Sequence[Hypothesis], *, start: float, lag: float, limit: float, memory: float
) -> FloatArray:
    """Twice the negative log likelihood (k,) of each hypothesis, up to a constant, and 2 for a free number.

    Args:
        window: demands and angles; those before ``start`` are only demands that may come late.
        hypotheses: the actuators to compare.
        start: tick at which all of them have the measured angle.
        lag: time constant of the actuator [s].
        limit: of its angle [rad].
        memory: time in which the residual's errors are correlated [s].
    """
    first = min(int(np.searchsorted(window.ticks, start)), len(window.ticks) - 1)
    rate, gain, offset, delay = (
        np.array([getattr(one, name) for one in hypotheses]) for name in ("rate", "gain", "offset", "delay")
    )
    late = window.ticks[:, None] - delay / TICK
    sent = window.sent[np.maximum(np.searchsorted(window.ticks, late, side="right") - 1, 0)]  # (n, k)
    targets = np.clip(gain * sent + offset, -limit, limit)
    angle, total = np.full(len(hypotheses), window.angles[first]), np.zeros(len(hypotheses))
    for k in range(first, len(window.ticks) - 1):
        span = float(window.ticks[k + 1] - window.ticks[k]) * TICK
        angle = settle(angle, targets[k], span, lag=lag, max_rate=rate)
        total += ((window.angles[k + 1] - angle) / window.std[k + 1]) ** 2 * (span / memory)
    return total + 2.0 * np.array([one.is_free for one in hypotheses])
