"""A rover's scenario: everything that decides its run besides the seed, frozen and validated."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import tomli_w
from pydantic import Field, field_validator

from scenarios.options.base import Options, quantity
from scenarios.options.faults import Faults
from vehicle.option import Parameter

Compensation = Literal["none", "heading", "crab"]


class RoverStraightOptions(Options):
    """Straight ahead."""

    kind: Literal["straight"]
    length: float = quantity(7.0, "m", ge=0.5, le=200.0)  # Reina 2008, section III: about 7 m


class RoverFigureOfEightOptions(Options):
    """A full left circle, then a full right circle, a straight before and after."""

    kind: Literal["figure-of-eight"]
    radius: float = quantity(2.0, "m", ge=1.0, le=50.0)
    straight: float = quantity(1.0, "m", ge=0.2, le=50.0)


class RoverArcOptions(Options):
    """A straight, then an arc to the left (turn > 0) or to the right."""

    kind: Literal["arc"]
    radius: float = quantity(3.0, "m", ge=1.0, le=100.0)
    turn_deg: float = quantity(90.0, "deg", ge=-720.0, le=720.0)
    straight: float = quantity(1.0, "m", ge=0.2, le=50.0)


ROVER_COURSES = (RoverStraightOptions, RoverFigureOfEightOptions, RoverArcOptions)
RoverCourse = Annotated[RoverStraightOptions | RoverFigureOfEightOptions | RoverArcOptions, Field(discriminator="kind")]


class MoundOptions(Options):
    """A round mound, or with a negative height a crater."""

    x: float = quantity(0.0, "m", ge=-1e3, le=1e3)  # W of its middle
    y: float = quantity(0.0, "m", ge=-1e3, le=1e3)
    radius: float = quantity(1.0, "m", ge=0.2, le=100.0)  # where its height has fallen to 0.14 of that of its top
    height: float = quantity(0.1, "m", ge=-5.0, le=5.0)


class RoverSurfaceOptions(Options):
    """The ground: a plane, mounds on it, and what it is made of."""

    soil: str = "toyoura_sand"  # a known soil, a TOML file, or none: hard ground
    friction: float = quantity(0.8, "-", ge=0.05, le=1.5)  # where it is hard
    cross_fall: float = quantity(0.0, "-", ge=-0.6, le=0.6)  # a slope: it falls to the right of W's x
    grade: float = quantity(0.0, "-", ge=-0.6, le=0.6)  # it rises along W's x
    slope_from: float | None = quantity(
        None, "m", ge=0.0, le=1e3
    )  # along W's x, where the slopes set in; else everywhere
    slope_over: float = quantity(1.0, "m", ge=0.1, le=100.0)  # way over which they do
    mounds: tuple[MoundOptions, ...] = ()
    height_map: str | None = None  # a file of heights [m], .npy or comma-separated text, rows of growing y
    height_map_spacing: float = quantity(0.05, "m", ge=0.001, le=10.0)
    height_map_x: float = quantity(0.0, "m", ge=-1e4, le=1e4)  # W of its first column
    height_map_y: float = quantity(0.0, "m", ge=-1e4, le=1e4)  # W of its first row

    @field_validator("height_map")
    @classmethod
    def _full_path(cls, path: str | None) -> str | None:
        return None if path is None else str(Path(path).resolve())  # the resolved scenario runs from any folder


class SandOptions(Options):
    """What the ground looks like, and the light."""

    terrain: str = "uniform"  # see sensors.sand.kinds
    sun_azimuth_deg: float | None = quantity(None, "deg", ge=0.0, le=360.0)  # as on a compass; not given: by the seed
    sun_elevation_deg: float | None = quantity(None, "deg", ge=10.0, le=90.0)


class TraceRigOptions(Options):
    """The camera behind the left rear wheel (Reina 2008, section II); its place is that of the paper's."""

    rate_hz: float = quantity(5.0, "Hz", ge=1.0, le=20.0)
    latency: float = quantity(0.1, "s", ge=0.0, le=2.0)  # exposure to finished estimate
    noise: float = quantity(2.0, "grey levels", ge=0.0, le=50.0)  # standard deviation of the image noise
    shot_noise: float = quantity(3.0, "grey levels", ge=0.0, le=50.0)  # of the light's own noise, where it is white


class RoverSignalOptions(Options):
    """Encoders, compass and laser tracker."""

    noise: float = quantity(1.0, "-", ge=0.0, le=10.0)  # 1: as on their data sheets, 0: exact


class RoverScenario(Options):
    """One closed-loop run of a rover."""

    kind: Literal["rover"]
    name: str = Field(min_length=1, pattern=r"^[A-Za-z0-9._-]+$")
    description: str = ""
    course: RoverCourse
    vehicle: str = "el_dorado_ii"  # a known rover or a TOML file
    speed_kmh: float = quantity(0.288, "km/h", ge=0.05, le=1.08)  # 8 cm/s; the paper's rover does 2 to 30 cm/s
    slip_estimator: str = "ftrace_plus"  # truth, ftrace, ftrace_plus or package.module:Name
    estimator: dict[str, Parameter] = Field(default_factory=dict)  # its parameters; those not given keep their defaults
    sensor: str | None = None  # that it reads: a known one or package.module:Name; not given: the estimator's own
    sensing: dict[str, Parameter] = Field(default_factory=dict)  # parameters of the sensor, if it is one's own
    driver: str = "path"  # a known rover driver or package.module:Name
    driving: dict[str, Parameter] = Field(default_factory=dict)  # its parameters, if it is one's own
    slip_compensation: Compensation = "crab"
    navigation: Literal["odometry", "laser"] = "odometry"  # where the rover has its position from
    surface: RoverSurfaceOptions = RoverSurfaceOptions()
    world: SandOptions = SandOptions()
    rig: TraceRigOptions = TraceRigOptions()
    signals: RoverSignalOptions = RoverSignalOptions()
    faults: Faults = ()

    @property
    def speed(self) -> float:
        """Set speed of the wheels [m/s]."""
        return self.speed_kmh / 3.6

    def to_toml(self) -> str:
        """The resolved scenario as TOML: it runs again identically."""
        return tomli_w.dumps(self.model_dump(exclude_none=True))
