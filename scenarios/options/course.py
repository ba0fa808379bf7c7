"""Courses as a scenario file describes them; ``kind`` tells which."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from scenarios.options.base import Options, quantity


class RoundaboutOptions(Options):
    """The tractor's outer front corner on a circle, tangent entry and exit."""

    kind: Literal["roundabout"]
    direction: Literal["left", "right"] = "left"
    radius: float = quantity(12.5, "m", ge=11.0, le=100.0)  # of the outer front corner's circle
    turn_deg: float = quantity(360.0, "deg", ge=30.0, le=1800.0)
    entry: float = quantity(30.0, "m", ge=20.0, le=500.0)  # straight before the circle
    exit: float = quantity(35.0, "m", ge=5.0, le=500.0)  # straight behind it


class FigureOfEightOptions(Options):
    """A full left circle, then a full right circle."""

    kind: Literal["figure-of-eight"]
    radius: float = quantity(12.5, "m", ge=11.0, le=100.0)  # of the outer front corner's circles
    entry: float = quantity(30.0, "m", ge=20.0, le=500.0)
    exit: float = quantity(35.0, "m", ge=5.0, le=500.0)


class ConstantSlipOptions(Options):
    """The trailer dragged along a straight line at a constant slip angle (de Saxe & Cebon 2018, section 3.1)."""

    kind: Literal["constant-slip"]
    slip_angle_deg: float = quantity(14.0, "deg", ge=-60.0, le=60.0)  # from where the trailer points, + left
    length: float = quantity(100.0, "m", ge=20.0, le=1000.0)


class TurnOptions(Options):
    """The low-speed turn of performance-based standards: the outer steered tyre's wall on an arc, tangent both ends."""

    kind: Literal["turn"]
    direction: Literal["left", "right"] = "left"
    radius: float = quantity(12.5, "m", ge=8.0, le=100.0)  # of the arc
    turn_deg: float = quantity(90.0, "deg", ge=10.0, le=180.0)
    entry: float = quantity(30.0, "m", ge=20.0, le=500.0)
    exit: float = quantity(35.0, "m", ge=5.0, le=500.0)


class LaneChangeOptions(Options):
    """The single lane change of ISO 14791, at the scenario's set speed."""

    kind: Literal["lane-change"]
    direction: Literal["left", "right"] = "left"
    frequency_hz: float = quantity(0.4, "Hz", ge=0.1, le=2.0)  # of the lateral acceleration's one period
    peak_acceleration: float = quantity(1.4715, "m/s2", ge=0.1, le=6.0)  # 0.15 g
    entry: float = quantity(60.0, "m", ge=20.0, le=500.0)
    exit: float = quantity(150.0, "m", ge=20.0, le=1000.0)


class StraightOptions(Options):
    """Straight ahead."""

    kind: Literal["straight"]
    length: float = quantity(200.0, "m", ge=20.0, le=5000.0)


class TurnTable(Options):
    """A turn, and the straight behind it."""

    direction: Literal["left", "right"]
    radius: float = quantity(12.5, "m", ge=8.0, le=5000.0)  # of the way of the front's middle
    turn_deg: float = quantity(90.0, "deg", ge=10.0, le=720.0)
    straight: float = quantity(10.0, "m", ge=0.1, le=5000.0)


class SegmentsOptions(Options):
    """One turn after the other, with straights between them; the middle of the tractor's front is guided."""

    kind: Literal["segments"]
    entry: float = quantity(30.0, "m", ge=20.0, le=500.0)  # straight before the first
    turns: tuple[TurnTable, ...] = Field(min_length=1)


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
