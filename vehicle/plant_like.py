"""Interface of a plant: anything that moves a vehicle."""

from __future__ import annotations

from typing import Protocol, TypeVar

from vehicle.frames import FloatArray

TruthT = TypeVar("TruthT", covariant=True)
CommandT = TypeVar("CommandT", contravariant=True)


class EndedError(Exception):
    """A part can not go on: the run ends as "diverged". The text is one line that says why."""


class PlantLike(Protocol[TruthT, CommandT]):
    """Anything that moves a vehicle: the dynamics, or a prescribed motion."""

    def step(self, state: FloatArray, command: CommandT, ticks: int) -> FloatArray:
        """State so many ticks later.

        Raises:
            DivergedError: if the physics breaks.
        """

    def observe(self, state: FloatArray, tick: int) -> TruthT:
        """Ground truth for this state."""
