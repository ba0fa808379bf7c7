"""How parts of a Gaussian state grow and fade along a way."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from vehicle.frames import FloatArray


def alike(lengths: FloatArray, way: float) -> FloatArray:
    """Correlation of pieces with each other that fades over a way."""
    at = np.cumsum(lengths)
    alike: FloatArray = np.exp(-np.abs(at[:, None] - at) / way)
    return alike


def add(mean: FloatArray, covariance: FloatArray, part: int, of: int, factor: float) -> None:
    """Lets one part of the state grow by a multiple of another."""
    mean[part] += factor * mean[of]
    covariance[part] += factor * covariance[of]
    covariance[:, part] += factor * covariance[:, of]


def fade(mean: FloatArray, covariance: FloatArray, parts: NDArray[np.intp], way: float, variances: FloatArray) -> None:
    """Forgets parts of the state (n,) by the share of their way that was gone, while the same comes anew."""
    keep = math.exp(-way)
    mean[parts] *= keep
    covariance[parts] *= keep
    covariance[:, parts] *= keep
    covariance[parts, parts] += (1.0 - keep**2) * variances
