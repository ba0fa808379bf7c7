"""Prediction steps of a Gaussian state over a distance: growth, correlation and decay."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from vehicle.frames import FloatArray


def correlation(lengths: FloatArray, correlation_length: float) -> FloatArray:
    """Correlation matrix of pieces, decaying exponentially over ``correlation_length`` [m]."""
    at = np.cumsum(lengths)
    correlations: FloatArray = np.exp(-np.abs(at[:, None] - at) / correlation_length)
    return correlations


def add(mean: FloatArray, covariance: FloatArray, part: int, of: int, factor: float) -> None:
    """Add a multiple of one component of the state to another, in place."""
    mean[part] += factor * mean[of]
    covariance[part] += factor * covariance[of]
    covariance[:, part] += factor * covariance[:, of]


def fade(
    mean: FloatArray, covariance: FloatArray, parts: NDArray[np.intp], lengths: float, variances: FloatArray
) -> None:
    """Decay components (n,) of the state over ``lengths`` correlation lengths, with their stationary variances."""
    keep = math.exp(-lengths)
    mean[parts] *= keep
    covariance[parts] *= keep
    covariance[:, parts] *= keep
    covariance[parts, parts] += (1.0 - keep**2) * variances
