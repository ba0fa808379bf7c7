"""Interface of a plant: anything that moves a vehicle; and the check that its states are finite."""

import math
from typing import Final, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from vehicle.frames import FloatArray

TruthT = TypeVar("TruthT", covariant=True)
CommandT = TypeVar("CommandT", contravariant=True)


class EndedError(Exception):
    """A part can not go on: the run ends as "diverged". The text is one line that says why."""


class KilledError(EndedError):
    """The process of a part has died or does not answer: the run has failed, the vehicle has done nothing wrong."""


class PlantLike(Protocol[TruthT, CommandT]):
    """Anything that moves a vehicle: the dynamics, or a prescribed motion."""

    def step(self, state: FloatArray, command: CommandT, ticks: int) -> FloatArray:
        """State so many ticks later.

        Raises:
            DivergedError: if the physics breaks.
        """

    def observe(self, state: FloatArray, tick: int) -> TruthT:
        """Ground truth for this state."""


_UNPHYSICAL: Final = 1e12  # in any SI unit: positions stay below 1e7 m, hitch forces below 1e8 N


def is_sane(vector: FloatArray) -> bool:
    """True if all entries of a vector are finite and below 1e12."""
    return math.hypot(*vector.tolist()) < _UNPHYSICAL  # half the time of numpy for a single vehicle


def are_sane(vectors: FloatArray) -> NDArray[np.bool_]:
    """``is_sane`` for every row of (n, n_entries)."""
    with np.errstate(over="ignore", invalid="ignore"):
        sane: NDArray[np.bool_] = np.einsum("ij,ij->i", vectors, vectors) < _UNPHYSICAL**2
    return sane
