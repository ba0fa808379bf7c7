"""Contexts that sensors are constructed from: ``SensorClass.of(context)``."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np

from vehicle.clock import Schedule
from vehicle.combination.description import Vehicle
from vehicle.option import Parameter
from vehicle.rover.description import Rover
from vehicle.surface import Surface

if TYPE_CHECKING:
    from sensors.camera.rig import StereoCalibration
    from sensors.render import StereoRenderer
    from sensors.world.world import World


class WorldViews(Protocol):
    """The rendered world of a run, which all cameras of the run share."""

    @property
    def world(self) -> "World":
        """The world; built when it is first asked for."""

    def seen_by(self, calibration: "StereoCalibration") -> "StereoRenderer":
        """Renderer for cameras of this calibration.

        Raises:
            RendererUnavailableError: if OpenGL does not work here.
        """


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TrailerSensorContext:
    """Everything that a sensor on one unit of a combination may be constructed from."""

    vehicle: Vehicle
    unit: int  # the sensor's unit; the tractor is 0
    follow_distance: float  # hitch to follow point of that unit [m]
    surface: Surface
    views: WorldViews
    schedule: Schedule  # of the scenario's cameras: rig.rate_hz, rig.latency
    rng: np.random.Generator  # the sensor's own stream
    options: Mapping[str, Parameter]  # ``sensing.…`` of the scenario; those not given keep their defaults


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RoverSensorContext:
    """Everything that a sensor on a rover may be constructed from."""

    rover: Rover
    schedule: Schedule  # of the scenario's camera: rig.rate_hz, rig.latency
    rng: np.random.Generator  # the sensor's own stream
    options: Mapping[str, Parameter]  # ``sensing.…`` of the scenario; those not given keep their defaults
