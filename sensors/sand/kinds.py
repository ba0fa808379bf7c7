"""Named kinds of sand ground, after the sample images of Reina 2008, Fig. 2 a to f."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True, slots=True, kw_only=True)
class SandKind:
    """What a ground is made of, and where the sun stands over it if nothing else is said.

    All sizes are assumed: chosen by eye beside the paper's description, and in the range of what beaches look like.
    """

    ripples: float = 0.0005  # amplitude of wind ripples [m]
    low_relief: float = 0.0025  # standard deviation of what is longer than 0.1 m [m]
    stones: float = 300.0  # pebbles above 1.5 mm radius [1/m2]
    blotches: float = 0.05  # standard deviation of the relative albedo [-]
    wet: float = 0.0  # share of the light that wet patches take [-]
    cracks: float = 0.0  # depth of cracks across the way [m]
    rocks: float = 0.0  # beside the way [1/m2]
    foreign_tracks: bool = False  # of other vehicles, beside the way and across it
    mast: bool = False  # the rover carries a mast whose head looks around
    azimuth: tuple[float, float] = (math.radians(60.0), math.radians(210.0))  # of the sun against the way, + left [rad]
    elevation: tuple[float, float] = (math.radians(30.0), math.radians(48.0))  # of the sun [rad]


# Ahead and to the right of the rover the sun throws the rover's own shadow over what its camera sees; ahead and to the
# left that of rocks beside the way; from behind it shows what lies across the way.
_OWN_SHADOW: Final = (math.radians(-75.0), math.radians(10.0))  # [rad]
_ROCK_SHADOWS: Final = (math.radians(-50.0), math.radians(80.0))
_BEHIND: Final = (math.radians(105.0), math.radians(215.0))
_LOW: Final = (math.radians(22.0), math.radians(38.0))

KINDS: Final[dict[str, SandKind]] = {
    "uniform": SandKind(),
    "ripples": SandKind(ripples=0.0028, cracks=0.004, azimuth=_BEHIND, elevation=_LOW),
    "pebbles": SandKind(ripples=0.0008, low_relief=0.004, stones=3500.0, blotches=0.13, wet=0.35),
    "shadows": SandKind(
        ripples=0.0008, low_relief=0.003, stones=700.0, blotches=0.07, rocks=2.0, mast=True, azimuth=_OWN_SHADOW
    ),
    "mast_shadows": SandKind(
        ripples=0.0006,
        low_relief=0.003,
        stones=2200.0,
        blotches=0.10,
        rocks=5.0,
        mast=True,
        azimuth=_ROCK_SHADOWS,
        elevation=_LOW,
    ),
    "foreign": SandKind(ripples=0.0008, low_relief=0.003, stones=500.0, blotches=0.06, foreign_tracks=True),
}


def kind_named(name: str) -> SandKind:
    """The kind of that name.

    Raises:
        ValueError: if there is none.
    """
    if name not in KINDS:
        raise ValueError(f"terrain = {name!r} must be one of {', '.join(KINDS)}")
    return KINDS[name]
