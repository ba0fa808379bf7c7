"""The functions that drive the standard manoeuvres, by name."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, TypeAlias

from scenarios.standards.braking import braking, braking_in_turn, braking_slippery, braking_split
from scenarios.standards.closing_curve import closing_curve
from scenarios.standards.conditions import Conditions
from scenarios.standards.crosswind import crosswind
from scenarios.standards.guided_axle import aashto_turn, ctsw_turn
from scenarios.standards.lane_change import lane_change
from scenarios.standards.longitudinal import longitudinal
from scenarios.standards.low_speed import roundabout, turn
from scenarios.standards.manoeuvre import Manoeuvre
from scenarios.standards.pulse import pulse
from scenarios.standards.random_steer import random_steer
from scenarios.standards.sine_with_dwell import sine_with_dwell
from scenarios.standards.steady_circle import steady_circle
from scenarios.standards.straight import straight
from scenarios.standards.tilt import tilt
from vehicle.combination.description import Vehicle

Drive: TypeAlias = Callable[[Vehicle, str, Conditions], Manoeuvre]  # with the law that steers the last unit

DRIVES: Final[dict[str, Drive]] = {
    "turn": turn,
    "roundabout": roundabout,
    "aashto_turn": aashto_turn,
    "ctsw_turn": ctsw_turn,
    "lane_change": lane_change,
    "straight": straight,
    "pulse": pulse,
    "steady_circle": steady_circle,
    "sine_with_dwell": sine_with_dwell,
    "random_steer": random_steer,
    "closing_curve": closing_curve,
    "crosswind": crosswind,
    "tilt": tilt,
    "braking": braking,
    "braking_slippery": braking_slippery,
    "braking_split": braking_split,
    "braking_in_turn": braking_in_turn,
    "longitudinal": longitudinal,
}
