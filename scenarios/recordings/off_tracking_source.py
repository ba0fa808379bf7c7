"""The off-tracking estimator for a recording: VISO-OT or one of the user's own, with an odometry."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Final, NamedTuple

from estimators.calibration.self_calibration import SelfCalibratedOdometry
from estimators.context import OffTrackingEstimator, OffTrackingSource, TrailerContext
from estimators.protocol import Odometry
from scenarios.catalogue import ODOMETRY, OFF_TRACKING, check_made, constructed, resolve
from scenarios.options.scenario import Scenario
from scenarios.randomness import stream
from scenarios.recordings.stereo_reader import Recording
from vehicle.combination.description import Vehicle, load_vehicle
from vehicle.option import Parameter, check_options

VISO_OT: Final = "viso_ot"
DATA_SHEET: Final = str(Scenario.model_fields["vehicle"].default)
_IMAGES: Final = "stereo_camera"


class Chosen(NamedTuple):
    """Names and options of the parts, as a user gives them."""

    estimator: str = VISO_OT
    odometry: str = str(Scenario.model_fields["odometry"].default)
    self_calibration: bool = True
    vehicle: str | None = None  # data sheet for an estimator of the user's own; None: ``DATA_SHEET``, and said
    options: Mapping[str, Parameter] = {}  # of the estimator


def off_tracking_source(recording: Recording, chosen: Chosen) -> tuple[OffTrackingSource, Recording]:
    """The estimator, and the recording with what was assumed for it.

    Raises:
        ValueError: one line, if a part is unknown, needs other messages than images, or an option does not fit.
    """
    odometry = _odometry(recording, chosen)
    part: type[OffTrackingEstimator] = resolve("--estimator", chosen.estimator, OFF_TRACKING, in_scenario=False)
    if part.sensor != _IMAGES:
        raise ValueError(
            f"--estimator {chosen.estimator}: needs the sensor {part.sensor}: a recording holds the images of a stereo "
            "camera only"
        )
    check_options(part.options, chosen.options, "estimator")
    if chosen.estimator == VISO_OT and not chosen.options:
        source: OffTrackingSource = resolve("--estimator", VISO_OT, OFF_TRACKING)(
            recording.calibration,
            recording.follow_distance,
            odometry,
            path_height=recording.roll_axis_height,
            direction_std=recording.direction_std,
        )
        return source, recording
    vehicle = _data_sheet(recording, chosen.vehicle or DATA_SHEET)
    if chosen.vehicle is None:
        assumed = (*recording.assumed, f"data sheet for the estimator: {DATA_SHEET} (--vehicle)")
        recording = replace(recording, assumed=assumed)
    context = TrailerContext(
        vehicle=vehicle,
        unit=len(vehicle.units) - 1,
        follow_distance=recording.follow_distance,
        calibration=recording.calibration,
        odometry=odometry,
        rng=stream(0, chosen.estimator),
        options=chosen.options,
        sensor=None,
    )
    source = constructed("--estimator", chosen.estimator, lambda: part.of(context))
    check_made("--estimator", chosen.estimator, source, ("init", "step"))
    return source, recording


def _odometry(recording: Recording, chosen: Chosen) -> Odometry[Any]:
    kind = resolve("--odometry", chosen.odometry, ODOMETRY)
    motions = constructed("--odometry", chosen.odometry, lambda: kind(recording.calibration))
    return SelfCalibratedOdometry(recording.calibration, motions, correcting=chosen.self_calibration)


def _data_sheet(recording: Recording, name: str) -> Vehicle:
    """A vehicle's data sheet, whose last trailer rolls about the recording's axis.

    Raises:
        ValueError: one line, if there is no such vehicle, or it tows nothing.
    """
    vehicle = load_vehicle(name)
    if len(vehicle.units) < 2:
        raise ValueError(f"--vehicle {name}: tows no trailer")
    last = vehicle.units[-1].model_copy(update={"roll_axis_height": recording.roll_axis_height})
    return vehicle.model_copy(update={"units": (*vehicle.units[:-1], last)})
