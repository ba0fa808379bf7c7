"""Where the sun stands: found from the rut's own light and shade, and fixed in the world."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from estimators.slip.trace_tracker.channels import CHANNELS
from estimators.slip.trace_tracker.matching import unit
from estimators.slip.trace_tracker.templates import ELEVATIONS, Profiles, Templates, at_slips
from vehicle.frames import FloatArray

_COURSES: Final = 24  # azimuths in the world that are weighed against each other
_WORTH: Final = 4.0  # log likelihood of one picture's correlation being better by 1, by band
_FORGETTING: Final = 0.99  # a picture: the sun moves on, and clouds come
_NEGLIGIBLE: Final = 8.0  # log likelihood below the best


def unknown_sun() -> FloatArray:
    """Log likelihood (courses, elevations): nothing is known."""
    return np.zeros((_COURSES, len(ELEVATIONS)))


def lit(templates: Templates, direction: float) -> Profiles:
    """Profiles (courses, elevations, slips, ...) of a trace in a direction in the world [rad], for all suns."""
    azimuths = np.asarray(2.0 * math.pi / _COURSES * np.arange(_COURSES) - direction, dtype=np.float64)
    return templates.under(azimuths)


def probable(sun: FloatArray) -> FloatArray:
    """Whether (courses, elevations) each sun is worth a look."""
    worth: FloatArray = sun > sun.max() - _NEGLIGIBLE
    return worth


def expected(profiles: Profiles, sun: FloatArray) -> Profiles:
    """Profiles (slips, ...) under the suns believed in."""
    share = np.exp(sun - sun.max())
    mixed: Profiles = np.tensordot((share / share.sum()).astype(np.float32), profiles, axes=2)
    return mixed


def weighed(sun: FloatArray, profiles: Profiles, seen: Profiles, slips: FloatArray) -> FloatArray:
    """The belief after rut profiles (n, CHANNELS, WIDTH) of windows, made where the slips (n,) were so."""
    told = unit(at_slips(profiles, slips))
    scores = np.einsum("asncw,ncw->as", told, seen, optimize=True) / CHANNELS
    belief: FloatArray = _FORGETTING * sun + _WORTH * scores
    belief -= belief.max()
    return belief
