"""Courses as a scenario file describes them; ``kind`` tells which."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from scenarios.options.base import Options, option, quantity


class RoundaboutOptions(Options):
    """The tractor's outer front corner on a circle, tangent entry and exit."""

    kind: Literal["roundabout"] = option("Kind of the course.")
    direction: Literal["left", "right"] = option("Direction of travel round the circle.", "left")
    radius: float = quantity(12.5, "m", 11.0, 100.0, "Radius of the circle of the tractor's outer front corner.")
    turn_deg: float = quantity(360.0, "deg", 30.0, 1800.0, "Angle driven round the circle.")
    entry: float = quantity(30.0, "m", 20.0, 500.0, "Straight before the circle.")
    exit: float = quantity(35.0, "m", 5.0, 500.0, "Straight after the circle.")


class FigureOfEightOptions(Options):
    """A full left circle, then a full right circle."""

    kind: Literal["figure-of-eight"] = option("Kind of the course.")
    radius: float = quantity(12.5, "m", 11.0, 100.0, "Radius of both circles of the tractor's outer front corner.")
    entry: float = quantity(30.0, "m", 20.0, 500.0, "Straight before the circles.")
    exit: float = quantity(35.0, "m", 5.0, 500.0, "Straight after the circles.")


class ConstantSlipOptions(Options):
    """The trailer dragged along a straight line at a constant slip angle (de Saxe & Cebon 2018, section 3.1)."""

    kind: Literal["constant-slip"] = option("Kind of the course.")
    slip_angle_deg: float = quantity(14.0, "deg", -60.0, 60.0, "Direction of travel from the trailer's x axis, + left.")
    length: float = quantity(100.0, "m", 20.0, 1000.0, "Length of the straight line.")


class TurnOptions(Options):
    """The low-speed turn of performance-based standards: the outer steered tyre's wall on an arc, tangent both ends."""

    kind: Literal["turn"] = option("Kind of the course.")
    direction: Literal["left", "right"] = option("Direction of the turn.", "left")
    radius: float = quantity(12.5, "m", 8.0, 100.0, "Radius of the arc of the outer steered tyre's wall.")
    turn_deg: float = quantity(90.0, "deg", 10.0, 180.0, "Angle of the turn.")
    entry: float = quantity(30.0, "m", 20.0, 500.0, "Straight before the turn.")
    exit: float = quantity(35.0, "m", 5.0, 500.0, "Straight after the turn.")


class LaneChangeOptions(Options):
    """The single lane change of ISO 14791, at the scenario's set speed."""

    kind: Literal["lane-change"] = option("Kind of the course.")
    direction: Literal["left", "right"] = option("Side to which the lane is changed.", "left")
    frequency_hz: float = quantity(0.4, "Hz", 0.1, 2.0, "Frequency of the single period of lateral acceleration.")
    peak_acceleration: float = quantity(1.4715, "m/s2", 0.1, 6.0, "Peak lateral acceleration; 1.4715 is 0.15 g.")
    entry: float = quantity(60.0, "m", 20.0, 500.0, "Straight before the lane change.")
    exit: float = quantity(150.0, "m", 20.0, 1000.0, "Straight after the lane change.")


class StraightOptions(Options):
    """Straight ahead."""

    kind: Literal["straight"] = option("Kind of the course.")
    length: float = quantity(200.0, "m", 20.0, 5000.0, "Length of the course.")


class TurnTable(Options):
    """A turn, and the straight behind it."""

    direction: Literal["left", "right"] = option("Direction of the turn.")
    radius: float = quantity(12.5, "m", 8.0, 5000.0, "Radius of the path of the middle of the tractor's front.")
    turn_deg: float = quantity(90.0, "deg", 10.0, 720.0, "Angle of the turn.")
    straight: float = quantity(10.0, "m", 0.1, 5000.0, "Straight after the turn.")


class SegmentsOptions(Options):
    """One turn after the other, with straights between them; the middle of the tractor's front is guided."""

    kind: Literal["segments"] = option("Kind of the course.")
    entry: float = quantity(30.0, "m", 20.0, 500.0, "Straight before the first turn.")
    turns: tuple[TurnTable, ...] = Field(
        min_length=1, description="Turns, each with direction, radius, turn_deg and straight."
    )


COURSES = (
    RoundaboutOptions,
    FigureOfEightOptions,
    ConstantSlipOptions,
    TurnOptions,
    LaneChangeOptions,
    StraightOptions,
    SegmentsOptions,
)
Course = Annotated[
    RoundaboutOptions
    | FigureOfEightOptions
    | ConstantSlipOptions
    | TurnOptions
    | LaneChangeOptions
    | StraightOptions
    | SegmentsOptions,
    Field(discriminator="kind"),
]
