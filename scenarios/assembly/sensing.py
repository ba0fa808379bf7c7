"""Sensing of a trailer: a sensor with its faults, and the off-tracking estimator."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, cast

from estimators.calibration.self_calibration import SelfCalibratedOdometry
from estimators.context import OffTrackingEstimator, OffTrackingSource, TrailerContext
from estimators.protocol import FusesSignals, Odometry
from scenarios.assembly.loop_faults import sensor_faults
from scenarios.assembly.mount import SIGNALS, Cameras, MountContext, OpenedSensor
from scenarios.assembly.stereo_cameras import Rectified
from scenarios.catalogue import ODOMETRY, OFF_TRACKING, SENSOR, Part, check_made, constructed, resolve
from scenarios.options.scenario import Scenario
from scenarios.options.viso_ot import VisoOtOptions
from sensors.faults.fault import with_faults
from sensors.faults.signal_kinds import SignalFault
from sensors.messages import StereoFrame
from sensors.sensor import Message, Sensor, check_receives
from sensors.trailer_view import TrailerViewSensor
from vehicle.clock import Schedule
from vehicle.combination.truth import Truth
from vehicle.option import Parameter, check_options


@dataclass(frozen=True, slots=True, kw_only=True)
class Sensing:
    """A sensor with its faults, and its estimator."""

    sensor: Sensor[Truth, Message]
    schedule: Schedule
    period: int  # between two of its messages [ticks]
    estimator: OffTrackingSource
    cameras: Cameras | None  # None: the estimator receives no stereo images


def opened_sensor(name: str, context: MountContext) -> OpenedSensor:
    """Open a sensor by its name; a sensor without a schedule of its own samples at the rate of the cameras.

    Raises:
        ValueError: one line, if there is no such sensor or the context does not fit.
        RendererUnavailableError: one line, if it renders and OpenGL does not work here.
    """
    part: Part[MountContext, OpenedSensor | Sensor[Truth, Message]] = resolve("sensor", name, SENSOR)
    sensor = constructed("sensor", name, lambda: part.of(context))
    opened = sensor if isinstance(sensor, OpenedSensor) else OpenedSensor(sensor=sensor, schedule=context.schedule)
    check_made("sensor", name, opened.sensor, ("sample",))
    return opened


def opened_sensing(context: MountContext) -> Sensing:
    """Open the scenario's sensor and estimator for one trailer.

    Raises:
        ValueError: one line, if the scenario is not consistent.
        RendererUnavailableError: one line, if cameras are needed and OpenGL does not work here.
    """
    scenario = context.scenario
    part: type[OffTrackingEstimator] = resolve("off_tracking", scenario.off_tracking, OFF_TRACKING)
    options = _estimator_options(scenario)
    check_options(part.options, options, "estimator")
    sensor = scenario.sensor if scenario.sensor is not None else part.sensor
    if hasattr(kind := resolve("sensor", sensor, SENSOR), "sends"):  # cameras take seconds to open
        check_receives(f"off_tracking = {scenario.off_tracking}", part, kind)
    opened = opened_sensor(sensor, context)
    cameras = opened.cameras
    odometry: Odometry[Any] | None = None
    if cameras and cameras.epipolar:
        motions, calibration = resolve("odometry", scenario.odometry, ODOMETRY), cameras.calibration
        odometry = constructed("odometry", scenario.odometry, lambda: motions(calibration))
    if odometry and cameras:
        correcting = scenario.rig.self_calibration
        odometry = SelfCalibratedOdometry(cameras.calibration, odometry, correcting=correcting)
    known = TrailerContext(
        vehicle=context.nominal,
        unit=context.unit,
        follow_distance=context.trailer.follow_distance,
        calibration=cameras.calibration if cameras else None,
        odometry=odometry,
        rng=context.stream(scenario.off_tracking),
        options=options,
        sensor=opened.sensor,
    )
    estimator = constructed("off_tracking", scenario.off_tracking, lambda: part.of(known))
    check_made("off_tracking", scenario.off_tracking, estimator, ("init", "step"))
    check_receives(f"off_tracking = {scenario.off_tracking}", estimator, opened.sensor)
    sensing = Sensing(
        sensor=_with_faults(opened, context),
        schedule=opened.schedule,
        period=opened.schedule.period,
        estimator=Rectified(estimator, cameras.rectifier) if cameras and cameras.rectifier else estimator,
        cameras=cameras,
    )
    fuses = isinstance(estimator, FusesSignals) and estimator.fuses_signals
    return _with_signals(sensing, context) if fuses and cameras else sensing


def _with_signals(sensing: Sensing, context: MountContext) -> Sensing:
    """The same with views of the trailer, frames and signals, instead of frames alone."""
    camera = cast("Sensor[Truth, StereoFrame]", sensing.sensor)  # what cameras of a stereo odometry send
    views = TrailerViewSensor(camera, sensing.schedule, context.signals, SIGNALS)
    return replace(sensing, sensor=views, schedule=views.schedule)


def _estimator_options(scenario: Scenario) -> dict[str, Parameter]:
    """Parameters of the estimator: ``viso_ot.…`` for viso_ot, ``estimator.…`` for all.

    Raises:
        ValueError: one line, if ``viso_ot.…`` is given to another estimator.
    """
    if scenario.off_tracking == "viso_ot":
        return scenario.viso_ot.model_dump() | scenario.estimator
    if scenario.viso_ot != VisoOtOptions():
        raise ValueError(f"viso_ot.* options apply only to off_tracking = viso_ot, not to {scenario.off_tracking}")
    return dict(scenario.estimator)


def _with_faults(opened: OpenedSensor, context: MountContext) -> Sensor[Truth, Message]:
    """The sensor with the scenario's faults, applied in their order; those of signals act on the own sensors."""
    faults = sensor_faults(context.scenario.faults)
    of_signals = [(k, fault) for k, fault in faults if issubclass(fault.kind, SignalFault)]
    of_sensor = [(k, fault) for k, fault in faults if not issubclass(fault.kind, SignalFault)]
    context.signals.fail([fault for _, fault in of_signals], lambda k: context.stream(f"fault {of_signals[k][0]}"))
    return with_faults(
        opened.sensor,
        [fault for _, fault in of_sensor],
        camera=opened.cameras.calibration if opened.cameras else None,
        unit=context.unit,
        rng=lambda k: context.stream(f"fault {of_sensor[k][0]}"),
    )
