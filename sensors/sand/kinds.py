"""Kinds of sand by name, after the sample images of Reina 2008, Fig. 2 a to f."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True, slots=True, kw_only=True)
class SandKind:
    """Look of a kind of sand, and the default range of the sun's position.

    All sizes are assumed: chosen by eye from the paper's description, in the range of natural beaches.
    """

    ripples: float = 0.0005  # amplitude of wind ripples [m]
    low_relief: float = 0.0025  # standard deviation of the relief above 0.1 m wavelength [m]
    stones: float = 300.0  # pebbles above 1.5 mm radius [1/m2]
    blotches: float = 0.05  # standard deviation of the relative albedo [-]
    wet: float = 0.0  # share of the light that wet patches absorb [-]
    cracks: float = 0.0  # depth of cracks across the path [m]
    rocks: float = 0.0  # beside the path [1/m2]
    foreign_tracks: bool = False  # tracks of other vehicles beside and across the path
    mast: bool = False  # the rover has a mast with a head that pans
    azimuth: tuple[float, float] = (
        math.radians(60.0),
        math.radians(210.0),
    )  # of the sun relative to the path, + left [rad]
    elevation: tuple[float, float] = (math.radians(30.0), math.radians(48.0))  # of the sun [rad]


# A sun ahead on the right casts the rover's own shadow into the camera's view, ahead on the left the shadows of rocks
# beside the path. From behind it brings out relief across the path.
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
    """Look up a kind of sand.

    Raises:
        ValueError: if there is no kind of this name.
    """
    if name not in KINDS:
        raise ValueError(f"terrain = {name!r} must be one of {', '.join(KINDS)}")
    return KINDS[name]
