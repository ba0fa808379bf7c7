"""Estimation of the sun's direction in the world from light and shade in the rut."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from estimators.slip.trace_tracker.channels import CHANNELS
from estimators.slip.trace_tracker.matching import unit
from estimators.slip.trace_tracker.templates import ELEVATIONS, Profiles, Templates, at_slips
from vehicle.frames import FloatArray

_COURSES: Final = 24  # number of azimuths in the world that are compared
_WORTH: Final = 4.0  # log likelihood per unit of correlation, by band of one image
_FORGETTING: Final = 0.99  # per image: the sun moves, and clouds appear
_NEGLIGIBLE: Final = 8.0  # difference of log likelihood to the best that is ignored


def unknown_sun() -> FloatArray:
    """Uniform log likelihood (courses, elevations)."""
    return np.zeros((_COURSES, len(ELEVATIONS)))


def lit(templates: Templates, direction: float) -> Profiles:
    """Profiles (courses, elevations, slips, ...) of a trace in a world direction [rad], for all suns."""
    azimuths = np.asarray(2.0 * math.pi / _COURSES * np.arange(_COURSES) - direction, dtype=np.float64)
    return templates.under(azimuths)


def probable(sun: FloatArray) -> FloatArray:
    """Mask (courses, elevations) of suns that are not improbable."""
    worth: FloatArray = sun > sun.max() - _NEGLIGIBLE
    return worth


def expected(profiles: Profiles, sun: FloatArray) -> Profiles:
    """Expected profiles (slips, ...), weighted with the probability of each sun."""
    share = np.exp(sun - sun.max())
    mixed: Profiles = np.tensordot((share / share.sum()).astype(np.float32), profiles, axes=2)
    return mixed


def weighed(sun: FloatArray, profiles: Profiles, observed: Profiles, slips: FloatArray) -> FloatArray:
    """Log likelihood after observed rut profiles (n, CHANNELS, WIDTH) at slips (n,)."""
    predicted = unit(at_slips(profiles, slips))
    scores = np.einsum("asncw,ncw->as", predicted, observed, optimize=True) / CHANNELS
    belief: FloatArray = _FORGETTING * sun + _WORTH * scores
    belief -= belief.max()
    return belief
