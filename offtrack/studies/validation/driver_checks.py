"""Checks of the preview driver: stability, straight running and lane changes of every shipped combination.

The combination is `lateral_model` with its tyres, roll and actuators over one period of the driver; the driver is the
code of runs, linearised by differences. So nothing of the driver's own model enters on the combination's side.
"""

import math
from itertools import chain
from typing import Any, Final

import numpy as np

from controllers.driver import PERIOD, DriverMemory, PreviewDriver
from controllers.path import Path, line
from controllers.preview_law import Motion
from offtrack.studies.standards.assessment import linear_figures
from offtrack.studies.standards.proving_ground import (
    Drive,
    amplification,
    drive_course,
    largest_load_transfer,
    lateral_acceleration,
    point_path,
)
from offtrack.studies.validation.check import Check, CheckSection
from offtrack.studies.validation.simple_drives import with_each_tyre
from scenarios.assembly.adapters import tractor_guided_at
from scenarios.courses import Course, lane_change, straight
from sensors.messages import EgoState
from vehicle.clock import TICK
from vehicle.combination.description import GRAVITY, Vehicle, load_vehicle, vehicle_names
from vehicle.combination.linear import ComplexArray, lateral_model
from vehicle.frames import FloatArray, Pose2
from vehicle.surface import Surface

_REMEMBERED: Final = ("demand", "steer", "front_slip", "rear_slip", "side", "turn")  # besides v_y and yaw rate
_OBSERVED: Final = 4  # y, psi, v_y, yaw rate
_STEP: Final = 1e-6  # of the differences: rounding and curvature both cost 1e-9
_STATION: Final = 50.0  # anywhere on the straight [m]
_AT_REST: Final = 1e-9  # eigenvalues of a memory that only stores observations


def driver_modes(vehicle: Vehicle, driven: Vehicle, speed: float, ahead: float) -> ComplexArray:
    """Eigenvalues [1/s] of the closed loop at ``speed`` [m/s].

    Args:
        vehicle: as the driver's data sheet has it.
        driven: the combination that is driven.
        speed: [m/s].
        ahead: guided point on the tractor's axis, in T [m].
    """
    import control  # the import takes seconds

    multipliers = control.feedback(_motion(driven, speed), _driver(vehicle, speed, ahead), sign=1).poles()
    moving = multipliers[np.abs(multipliers) > _AT_REST].astype(np.complex128)
    return np.asarray(np.log(moving), dtype=np.complex128) / PERIOD


def _motion(driven: Vehicle, speed: float) -> Any:
    """Place, direction and motion of the tractor by its steer demand: a system of python-control over periods."""
    import control

    model = lateral_model(
        driven, speed, outputs=("lateral_velocity", "yaw_rate"), tyre_dynamics=True, actuators=True, path=True
    )
    observed = np.zeros((_OBSERVED, len(model.A)))
    observed[0, model.states.index("y")] = observed[1, model.states.index("psi")] = 1.0
    for row, output in ((2, "lateral_velocity_0"), (3, "yaw_rate_0")):
        observed[row] = model.C[model.outputs.index(output)]
    return control.c2d(control.ss(model.A, model.B[:, :1], observed, np.zeros((_OBSERVED, 1))), PERIOD)


def _driver(vehicle: Vehicle, speed: float, ahead: float) -> Any:
    """The driver's steer demand by what it observes: its new memory has the demand that it answers with."""
    driver = PreviewDriver(
        tractor_guided_at(vehicle, (ahead, 0.0)), Path(Pose2(0.0, 0.0, 0.0), (line(10.0 * _STATION),)), speed
    )
    tick, m = round(PERIOD / TICK), len(_REMEMBERED) + 2

    def step(values: list[float]) -> FloatArray:
        *remembered, v_y_before, yaw_rate_before, y, psi, v_y, yaw_rate = values
        demand, steer, front, rear, side, turn = remembered
        before = Motion(speed, v_y_before, yaw_rate_before)
        memory = DriverMemory(0, _STATION, demand, steer, front, 0.0, rear, side, turn, before)
        x = _STATION + speed * PERIOD - ahead * math.cos(psi)
        observed = EgoState(tick=tick, x=x, y=y, psi=psi, v_x=speed, v_y=v_y, yaw_rate=yaw_rate)
        after, _ = driver.step(memory, tick, observed)
        return np.array([*(getattr(after, name) for name in _REMEMBERED), after.motion.v_y, after.motion.yaw_rate])

    steps = (_STEP * np.eye(m + _OBSERVED)).tolist()
    opposite = (-_STEP * np.eye(m + _OBSERVED)).tolist()
    new = np.column_stack([(step(a) - step(b)) / (2.0 * _STEP) for a, b in zip(steps, opposite, strict=True)])
    import control

    return control.ss(new[:, :m], new[:, m:], new[:1, :m], new[:1, m:], PERIOD)


def margins(loop: Any) -> str:
    """Gain and phase margin of a loop gain with negative feedback, in words."""
    import control

    response = control.frequency_response(loop, np.geomspace(0.1, 0.99 * math.pi / PERIOD, 400))
    gain, phase, *_ = control.stability_margins(response)
    return f"gain margin {20.0 * math.log10(gain):.0f} dB, phase margin {phase:.0f}°"


SPEEDS: Final = (1.0, 2.5, 10.0, 20.0, 40.0, 65.0, 90.0, 110.0)  # [km/h]
DAMPINGS: Final = (0.0, 0.05)  # of the carcass at rest [s]
_SPEED: Final = 88.0 / 3.6  # of ISO 14791 [m/s]
_SMALL: Final = 0.05 * GRAVITY  # of the comparison with linear theory [m/s2]
_PEAK: Final = 0.15 * GRAVITY  # of ISO 14791 [m/s2]
_EXIT: Final = 250.0  # after the lane change [m]: 10 s, so that motion decays
_STRAIGHT_SPEED: Final = 90.0 / 3.6  # [m/s]
_LENGTH: Final = 1000.0  # of the straight road [m]
_CROSS_FALL: Final = 0.03  # of it, to the right [-]
_QUICK: Final = ("a_double",)


def driver(quick: bool) -> CheckSection:
    """Largest growth rate over speeds; path on a straight road; path and amplification of lane changes."""
    vehicles = [load_vehicle(name) for name in (_QUICK if quick else vehicle_names())]
    checks = chain.from_iterable(
        (_stability(vehicle), _straight(vehicle), *_small_lane_change(vehicle), _lane_change(vehicle))
        for vehicle in vehicles
    )
    return CheckSection(
        title="Driver",
        text="Stability: the linear motion of the combination, closed by the driver's code, from 1 to 110 km/h, with a "
        "tyre damping of 0 and of 0.05 s. Straight: 1 km of smooth road at 90 km/h with 3 % cross-fall. Lane changes: "
        "0.4 Hz at 88 km/h, with 0.15 g of the front axle as in ISO 14791, and with 0.05 g for the comparison with "
        "linear theory. The driver guides the front axle.",
        checks=tuple(checks),
    )


def with_damping(vehicle: Vehicle, damping: float) -> Vehicle:
    """The vehicle with another ``damping`` [s] of all tyres."""
    return with_each_tyre(vehicle, lambda axle: axle.tyre.model_copy(update={"damping": damping}))


def _stability(vehicle: Vehicle) -> Check:
    ahead = vehicle.units[0].front_x
    growth = {
        (kmh, damping): float(driver_modes(vehicle, with_damping(vehicle, damping), kmh / 3.6, ahead).real.max())
        for damping in DAMPINGS
        for kmh in SPEEDS
    }
    kmh, damping = max(growth, key=lambda case: growth[case])
    loop = -_driver(vehicle, SPEEDS[-1] / 3.6, ahead) * _motion(vehicle, SPEEDS[-1] / 3.6)
    return Check(
        f"{vehicle.name}: largest growth rate, if any",
        max(0.0, growth[kmh, damping]),
        "1/s",
        tolerance=1e-6,
        source="all modes decay",
        remark=f"slowest decay {growth[kmh, damping]:.3f} 1/s at {kmh:g} km/h, damping {damping:g} s; "
        f"at {SPEEDS[-1]:g} km/h {margins(loop)}",
    )


def _straight(vehicle: Vehicle) -> Check:
    course = straight(front_x=_front(vehicle), length=_LENGTH)
    driven = _driven(vehicle, course, _STRAIGHT_SPEED, Surface(friction=0.8, cross_fall=_CROSS_FALL))
    return Check(
        f"{vehicle.name}: RMS of the front axle beside a straight road",
        _rms(_offsets(vehicle, course, driven)) if driven.outcome == "completed" else math.inf,
        "m",
        tolerance=0.01,
        source="the project's bar for a smooth road",
        remark=driven.outcome,
    )


def _lane_change(vehicle: Vehicle) -> Check:
    course = lane_change(axle_x=_front(vehicle), speed=_SPEED, peak_acceleration=_PEAK, exit=_EXIT)
    driven = _driven(vehicle, course, _SPEED, Surface(friction=0.8))
    return Check(
        f"{vehicle.name}: path error in ISO 14791's lane change",
        float(np.abs(_offsets(vehicle, course, driven)).max()) if driven.outcome == "completed" else math.inf,
        "m",
        tolerance=0.15,
        source="ISO 14791, from memory: path within 150 mm",
        remark=f"{driven.outcome}, largest load transfer of a unit {largest_load_transfer(vehicle, driven.log):.2f}",
    )


def _small_lane_change(vehicle: Vehicle) -> list[Check]:
    last = vehicle.units[-1]
    course = lane_change(axle_x=_front(vehicle), speed=_SPEED, peak_acceleration=_SMALL, exit=_EXIT)
    driven = _driven(vehicle, course, _SPEED, Surface(friction=0.8))
    offsets = _offsets(vehicle, course, driven)
    checks = [
        Check(
            f"{vehicle.name}: RMS of the front axle after a lane change",
            _rms(offsets[len(offsets) // 2 :]),
            "m",
            tolerance=0.01,
            source="the project's bar for a smooth road",
        )
    ]
    if len(vehicle.units) > 1:
        theory = linear_figures(vehicle)["rearward_amplification"]
        rear = lateral_acceleration(driven.log, last.name, last.cg_x)
        ratio = amplification(rear, lateral_acceleration(driven.log, vehicle.units[0].name, _front(vehicle)))
        name = f"{vehicle.name}: rearward amplification"
        source = "linear theory with the same lags, front axle on its path"
        checks.append(Check(name, ratio, "-", target=theory, tolerance=0.03 * theory, source=source))
    return checks


def _driven(vehicle: Vehicle, course: Course, speed: float, surface: Surface) -> Drive:
    """The course driven at a speed [m/s] with the front axle guided."""
    end = course.length - _front(vehicle)
    return drive_course(vehicle, course, surface, speed=speed, done=lambda truth: bool(truth.poses[0, 0] >= end))


def _front(vehicle: Vehicle) -> float:
    return vehicle.units[0].steered_axles[0].x


def _offsets(vehicle: Vehicle, course: Course, driven: Drive) -> FloatArray:
    """Lateral positions of the front axle beside the course's path [m], 500 to 1000 over the drive."""
    front = point_path(driven.log, vehicle.units[0].name, _front(vehicle))
    return np.array([_offset(course, *point) for point in front[:: max(1, len(front) // 500)].tolist()])


def _rms(offsets: FloatArray) -> float:
    return float(np.sqrt(np.mean(offsets**2)))


def _offset(course: Course, x: float, y: float) -> float:
    """Lateral position beside the course's path [m]."""
    return y - course.path.pose(course.path.project(x, y, x - course.reference[0])).y
