"""How a run's off-tracking is sensed: cameras or a reference unit, their faults, and the estimator behind them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

from controllers.trailer import TrailerGeometry
from estimators.self_calibration import SelfCalibratedOdometry
from scenarios.adapters import rig_on
from scenarios.cameras import Cameras, Rectified, built_world, opened_cameras
from scenarios.catalogue import ODOMETRY, OFF_TRACKING, resolve
from scenarios.courses import Course
from scenarios.ground_cameras import opened_ground_cameras
from scenarios.randomness import stream
from scenarios.scenario import Scenario
from sensors.faults import faulty
from sensors.messages import BodyPose, StereoFrame
from sensors.navigation import ExactPose
from vehicle.description import Vehicle
from vehicle.surface import Surface
from vehicle.truth import Truth


class PoseSensor(Protocol):
    """What the off-tracking is estimated from: a stereo camera or a reference unit; None: nothing arrives."""

    def sample(self, truth: Truth) -> StereoFrame | BodyPose | None: ...


class OffTrackingSource(Protocol):
    """An off-tracking estimator, with the odometry (if any) that feeds it."""

    def init(self) -> Any: ...

    def step(self, memory: Any, message: Any) -> tuple[Any, Any]: ...


@dataclass(frozen=True, slots=True, kw_only=True)
class Sensing:
    """A sensor, with its faults, and what estimates the off-tracking from its messages."""

    sensor: PoseSensor
    source: OffTrackingSource
    cameras: Cameras | None  # None: nothing is rendered


def opened_sensing(
    scenario: Scenario,
    seed: int,
    *,
    unit: int,
    vehicle: Vehicle,
    trailer: TrailerGeometry,
    course: Course,
    surface: Surface,
    keep_colour: bool,
    record: bool,
) -> Sensing:
    """What senses the trailer of this ``unit``; cameras are opened if they are estimated from, or to be recorded.

    Raises:
        ValueError: one line, for whatever of the scenario does not fit.
        RendererUnavailableError: one line, if cameras are needed and OpenGL does not work here.
    """
    estimator = resolve("off_tracking", scenario.off_tracking, OFF_TRACKING)
    odometry = resolve("odometry", scenario.odometry, ODOMETRY)
    watches_ground = getattr(estimator, "watches_ground", False)  # with cameras under the trailer
    sees = scenario.off_tracking != "truth"
    cameras: Cameras | None = None
    if sees or record:
        world = built_world(scenario.world, course, surface, stream(seed, "world"))
        noise = stream(seed, "camera noise")
        if watches_ground:
            cameras = opened_ground_cameras(
                scenario, world, surface, vehicle, trailer, unit=unit, rng=noise, keep_colour=keep_colour
            )
        else:
            rig = rig_on(vehicle.units[unit], trailer, scenario.rig)
            cameras = opened_cameras(scenario.rig, rig, world, unit=unit, rng=noise, keep_colour=keep_colour)
    if cameras is None or not sees:
        sensor = _with_faults(ExactPose(unit), scenario, seed, unit, None)
        return Sensing(sensor=sensor, source=estimator(trailer.follow_distance), cameras=cameras)
    arguments = [cameras.calibration, trailer.follow_distance]
    if not watches_ground:
        measuring = odometry(cameras.calibration)
        own = scenario.rig.self_calibration
        arguments.append(SelfCalibratedOdometry(cameras.calibration, measuring) if own else measuring)
    source = estimator(*arguments)
    return Sensing(
        sensor=_with_faults(cameras.camera, scenario, seed, unit, cameras),
        source=Rectified(source, cameras.rectifier) if cameras.rectifier else source,
        cameras=cameras,
    )


def _with_faults(sensor: Any, scenario: Scenario, seed: int, unit: int, cameras: Cameras | None) -> PoseSensor:
    """The sensor as the scenario's faults leave it, the first of them nearest to it."""
    calibration = cameras.calibration if cameras else None
    for k, options in enumerate(scenario.faults):
        rng = stream(seed, f"fault {k}")
        sensor = faulty(sensor, options.fault(), unit=unit, calibration=calibration, rng=rng)
    faulted: PoseSensor = sensor
    return faulted
