"""Whether numbers can be a vehicle's: finite, and not astronomic."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from vehicle.frames import FloatArray

_BEYOND_ALL_PHYSICS: Final = 1e12  # in any SI unit: positions stay below 1e7 m, hitch forces below 1e8 N


def is_sane(vector: FloatArray) -> bool:
    """Whether all entries of a vector are finite and below 1e12."""
    return math.hypot(*vector.tolist()) < _BEYOND_ALL_PHYSICS  # half of the time that numpy takes for a single vehicle


def are_sane(vectors: FloatArray) -> NDArray[np.bool_]:
    """The same of every row of (n, n_entries)."""
    with np.errstate(over="ignore", invalid="ignore"):
        sane: NDArray[np.bool_] = np.einsum("ij,ij->i", vectors, vectors) < _BEYOND_ALL_PHYSICS**2
    return sane
