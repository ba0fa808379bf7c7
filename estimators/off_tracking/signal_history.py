"""Signals of a combination as they arrive: in order, without repetitions and without values that are no numbers."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from vehicle.frames import FloatArray

REMEMBERED = 20_000  # signals are kept for motions that span an outage of this length [ticks]
_LOOKED_AT = 25  # newest messages
_BEFORE = 2000  # signals kept before the reference, to interpolate and to compare them with each other [ticks]


def extended_history(history: FloatArray, arrived: Sequence[FloatArray], reference: int, tick: int) -> FloatArray:
    """Rows (n, columns) of signals, oldest first, that are needed for motions from the tick ``reference`` on.

    The first column is the tick. A sensor that is frozen repeats its last values under a new time. Its messages are
    left out: working sensors have noise, and do not measure the same twice. Ideal ones without noise do.
    """
    oldest = max(tick - REMEMBERED, reference - _BEFORE)
    kept = history[np.searchsorted(history[:, 0], oldest) :]
    new: list[FloatArray] = []
    may_repeat = _without_noise(kept)
    for row in arrived:
        last = new[-1] if new else history[-1] if len(history) else None
        later = last is None or (row[0] > last[0] and (may_repeat or not np.array_equal(row[1:], last[1:])))
        if later and np.all(np.isfinite(row)):
            new.append(row)
    return np.vstack([kept, *new]) if new else kept


def _without_noise(history: FloatArray) -> bool:
    """True if most signals have measured the same twice lately."""
    repeats = np.any(np.diff(history[-_LOOKED_AT:, 1:], axis=0) == 0.0, axis=0)
    return bool(2 * np.sum(repeats) > len(repeats))
