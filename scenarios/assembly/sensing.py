"""How a run's off-tracking is sensed: cameras or a reference unit, their faults, and the estimator behind them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

from controllers.trailer import TrailerGeometry
from estimators.calibration.self_calibration import SelfCalibratedOdometry
from estimators.context import OffTrackingEstimator, OffTrackingSource, TrailerContext
from scenarios.assembly.adapters import rig_on
from scenarios.assembly.board_calibration import Told
from scenarios.assembly.ground_cameras import opened_ground_cameras
from scenarios.assembly.stereo_cameras import Cameras, Rectified, Views, opened_cameras
from scenarios.catalogue import ODOMETRY, OFF_TRACKING, resolve
from scenarios.options.scenario import Scenario
from scenarios.options.viso_ot import VisoOtOptions
from scenarios.randomness import stream
from sensors.faults.faulty_sensor import with_faults
from sensors.instruments.combination import CombinationSensors
from sensors.instruments.navigation import ExactPose
from sensors.messages import BodyPose, CombinationSignals, StereoFrame
from vehicle.clock import Schedule
from vehicle.combination.description import Vehicle
from vehicle.combination.truth import Truth
from vehicle.surface import Surface

Message = StereoFrame | BodyPose | CombinationSignals

# assumed: gyros and angle sensors send every 20 ms, and so long it takes until their message has been worked on
_SIGNALS = Schedule.at_rate(50.0, latency=0.02)


class Sensor(Protocol):
    """What the off-tracking is estimated from; None: nothing arrives."""

    def sample(self, truth: Truth) -> Message | None:
        """The message of this moment."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Sensing:
    """A sensor, with its faults, and what estimates the off-tracking from its messages."""

    sensor: Sensor
    schedule: Schedule
    source: OffTrackingSource
    cameras: Cameras | None  # None: nothing is rendered
    sees: bool  # whether the off-tracking is estimated from what the cameras send


def opened_sensing(
    scenario: Scenario,
    seed: int,
    *,
    unit: int,
    vehicle: Vehicle,
    trailer: TrailerGeometry,
    signals: CombinationSensors,
    surface: Surface,
    views: Views,
    schedule: Schedule,
    keep_colour: bool,
    record: bool,
    calibrating: Told | None = None,
) -> Sensing:
    """What senses the trailer of this ``unit``; cameras are opened if they are estimated from, or to be recorded.

    Args:
        scenario: says how.
        seed: decides noise and faults.
        unit: the trailer's number in the vehicle.
        vehicle: the combination.
        trailer: the trailer's data sheet.
        signals: what the combination's sensors say for this trailer.
        surface: of the ground.
        views: what cameras see.
        schedule: of cameras, or of a reference unit in their place.
        keep_colour: let frames carry what the left camera saw in colour.
        record: have cameras even if the off-tracking is not estimated from them.
        calibrating: told how many pictures of calibration boards are done, of how many.

    Raises:
        ValueError: one line, for whatever of the scenario does not fit.
        RendererUnavailableError: one line, if cameras are needed and OpenGL does not work here.
    """
    estimator: type[OffTrackingEstimator] = resolve("off_tracking", scenario.off_tracking, OFF_TRACKING)
    odometry = resolve("odometry", scenario.odometry, ODOMETRY)
    sees = estimator.sensor in ("stereo_camera", "ground_cameras")
    declared = {option.name for option in estimator.options}
    settings = {name: value for name, value in scenario.viso_ot.model_dump().items() if name in declared}
    if not settings and scenario.viso_ot != VisoOtOptions():
        raise ValueError(f"viso_ot: off_tracking = {scenario.off_tracking} has none of these options, viso_ot has")
    cameras: Cameras | None = None
    if sees or record:
        noise = stream(seed, f"camera noise{_own(vehicle, unit)}")
        if estimator.sensor == "ground_cameras":
            cameras = opened_ground_cameras(
                scenario, views, surface, vehicle, trailer, unit=unit, rng=noise, keep_colour=keep_colour
            )
        else:
            rig = rig_on(vehicle.units[unit], trailer, scenario.rig)
            cameras = opened_cameras(
                scenario.rig,
                rig,
                views,
                unit=unit,
                rng=noise,
                boards=stream(seed, f"calibration boards{_own(vehicle, unit)}"),
                keep_colour=keep_colour,
                calibrating=calibrating,
            )
    sensor: Sensor = ExactPose(unit)
    if estimator.sensor == "combination_signals":
        sensor, schedule = signals, _SIGNALS
    elif sees and cameras is not None:
        sensor = cameras.camera
    sensor = _with_faults(sensor, scenario, seed, vehicle, unit, cameras if sees else None)
    calibration, measuring = (cameras.calibration if cameras and sees else None), None
    if calibration is not None and estimator.sensor == "stereo_camera":
        measuring = odometry(calibration)
        if scenario.rig.self_calibration:
            measuring = SelfCalibratedOdometry(calibration, measuring)
    source = estimator.of(
        TrailerContext(
            vehicle=vehicle,
            unit=unit,
            follow_distance=trailer.follow_distance,
            calibration=calibration,
            odometry=measuring,
            rng=stream(seed, f"{scenario.off_tracking}{_own(vehicle, unit)}"),
            options=settings,
            sensor=sensor,
        )
    )
    rectifier = cameras.rectifier if cameras and sees else None
    return Sensing(
        sensor=sensor,
        schedule=schedule,
        source=Rectified(source, rectifier) if rectifier else source,
        cameras=cameras,
        sees=sees,
    )


def _own(vehicle: Vehicle, unit: int) -> str:
    """What tells the random streams of a trailer from those of the last one."""
    return "" if unit == len(vehicle.units) - 1 else f" of {vehicle.units[unit].name}"


def _with_faults(
    sensor: Any, scenario: Scenario, seed: int, vehicle: Vehicle, unit: int, cameras: Cameras | None
) -> Sensor:
    """The sensor with the scenario's faults, the first of them nearest to it."""
    faulty: Sensor = with_faults(
        sensor,
        [options.fault() for options in scenario.faults],
        camera=cameras.calibration if cameras else None,
        unit=unit,
        rng=lambda k: stream(seed, f"fault {k}{_own(vehicle, unit)}"),
    )
    return faulty
