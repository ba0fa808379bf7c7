"""Conditions under which a standard manoeuvre is driven."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

Hand = Literal["left", "right"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Conditions:
    """Changes of a manoeuvre's conditions; None: as the standard prescribes."""

    hand: Hand = "left"  # side to which it turns first
    speed: float | None = None  # [m/s]
    radius: float | None = None  # of the guided point's path [m]
    friction: float | None = None  # [-]

    @property
    def side(self) -> float:
        """+1 to the left, -1 to the right."""
        return 1.0 if self.hand == "left" else -1.0

    def speed_or(self, standard: float) -> float:
        """The speed [m/s], by default the standard's."""
        return standard if self.speed is None else self.speed

    def radius_or(self, standard: float) -> float:
        """The radius [m], by default the standard's."""
        return standard if self.radius is None else self.radius

    def friction_or(self, standard: float) -> float:
        """The friction [-], by default the standard's."""
        return standard if self.friction is None else self.friction


STANDARD: Final = Conditions()
