"""A kinematic tractor and semitrailer that roll without slip, to close the loop around a controller without a plant."""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import pytest

from controllers.driver import PreviewDriver
from controllers.equations import settle
from controllers.tractor import TractorGeometry
from controllers.trailer import TrailerGeometry, TrailerSteering
from estimators.estimates import OffTracking
from estimators.off_tracking.reference import ReferenceOffTracking
from scenarios.courses import Course
from scenarios.results.metrics import true_off_tracking
from sensors.messages import BodyPose, EgoState
from tests.trailers import signals as readings
from vehicle.clock import TICK
from vehicle.frames import FloatArray, Pose2, rotation_zyx, transform

STEP = 10  # of the integration [ticks]
CONTROL, CAMERA = 20, 100  # periods [ticks]
WHEELBASE, HITCH_X = 3.8, 0.6  # the tractor of the published roundabout figures [m]


class Run(NamedTuple):
    """Log of a drive, at every step of the controllers."""

    station: FloatArray  # of the guided point [m]
    off_tracking: FloatArray  # true; nan until the hitch path reaches the follow point [m]
    guided: FloatArray  # distance of the guided point from its path [m]
    tractor_steer: FloatArray  # [rad]
    steer: FloatArray  # (n, n_steered) of the trailer [rad]

    @property
    def rms(self) -> float:
        return math.sqrt(float(np.nanmean(self.off_tracking**2)))

    @property
    def worst(self) -> float:
        return float(np.nanmax(np.abs(self.off_tracking)))


def _tractor(course: Course) -> TractorGeometry:
    return TractorGeometry(
        wheelbase=WHEELBASE,
        x_ref=course.reference[0],
        y_ref=course.reference[1],
        max_steer=math.radians(45.0),
        max_steer_rate=math.radians(30.0),
        actuator_lag=0.1,
    )


@pytest.fixture(scope="session")
def drive() -> Callable[..., Run]:
    """Drives a course: ``drive(course, trailer, law, speed_kmh=10, latency=0.1, slip=...)``."""
    return _driven


def _driven(
    course: Course,
    trailer: TrailerGeometry,
    law: TrailerSteering[Any],
    *,
    speed_kmh: float = 10.0,
    latency: float = 0.1,  # of the estimates [s]
    slip: Callable[[float], float] = lambda lateral_acceleration: 0.0,  # mean slip of the trailer's axles [-]
    until: float = math.inf,  # [s]
) -> Run:
    v = speed_kmh / 3.6
    tractor = _tractor(course)
    driver = PreviewDriver(tractor, course.path, v)
    reference = ReferenceOffTracking(trailer.follow_distance)
    driving, steering, referring = driver.init(), law.init(), reference.init()
    axles, steered = np.array(trailer.axle_distances), np.array(trailer.steered_distances)
    X_WT, X_WS = course.start, course.start @ Pose2(HITCH_X, 0.0, 0.0)
    yaw_rate_T = yaw_rate_S = delta = delta_demand = 0.0
    angles = demand = np.zeros(len(steered))
    newest: OffTracking | None = None
    in_flight: list[tuple[int, OffTracking]] = []
    rows: list[tuple[Any, ...]] = []
    tick = 0
    while tick * TICK < until:
        if tick % CAMERA == 0:
            body = transform(rotation_zyx(X_WS.psi, 0.0, 0.0), np.array([X_WS.x, X_WS.y, 0.0]))
            referring, estimate = reference.step(referring, BodyPose(tick=tick, X_WB=body))
            if estimate is not None:
                in_flight.append((tick + round(latency / TICK), estimate))
        while in_flight and in_flight[0][0] <= tick:
            newest = in_flight.pop(0)[1]
        if tick % CONTROL == 0:
            ego = EgoState(tick=tick, x=X_WT.x, y=X_WT.y, psi=X_WT.psi, v_x=v, v_y=0.0, yaw_rate=yaw_rate_T)
            driving, command = driver.step(driving, tick, ego)
            delta_demand = command.steer
            signals = readings(
                tick,
                angles=angles.copy(),
                speed=v,
                steer=delta,
                articulation=np.array([X_WT.psi - X_WS.psi]),
                yaw_rates=np.array([yaw_rate_T, yaw_rate_S]),
                lateral_acceleration=v * yaw_rate_S,
            )
            steering, steer_command = law.step(steering, tick, newest, signals)
            demand = steer_command.angles
            guided = X_WT @ Pose2(*course.reference, 0.0)
            station = course.path.project(guided.x, guided.y, driving.station)
            on_path = course.path.pose(station)
            aside = math.hypot(guided.x - on_path.x, guided.y - on_path.y)
            rows.append((station, tuple(X_WS), aside, delta, angles.copy()))
            if station >= course.length:
                break
        dt = STEP * TICK
        delta = float(settle(delta, delta_demand, dt, lag=tractor.actuator_lag, max_rate=tractor.max_steer_rate))
        angles = settle(angles, demand, dt, lag=trailer.actuator_lag, max_rate=trailer.max_steer_rate)
        yaw_rate_T = v * math.tan(delta) / WHEELBASE
        gamma_h = X_WT.psi - X_WS.psi + math.atan2(yaw_rate_T * HITCH_X, v)
        v_h = math.hypot(v, yaw_rate_T * HITCH_X)
        # sum(x_i (tan beta_i - tan delta_i)) = slip sum(x_i) with tan beta_i = tan gamma_h - x_i r / v_x
        moment = math.tan(gamma_h) * axles.sum() - steered @ np.tan(angles) - slip(v * yaw_rate_S) * axles.sum()
        yaw_rate_S = v_h * math.cos(gamma_h) * float(moment) / float(axles @ axles)
        middle = X_WT.psi + 0.5 * yaw_rate_T * dt
        X_WT = Pose2(X_WT.x + v * dt * math.cos(middle), X_WT.y + v * dt * math.sin(middle), X_WT.psi + yaw_rate_T * dt)
        hitch = X_WT @ Pose2(HITCH_X, 0.0, 0.0)
        X_WS = Pose2(hitch.x, hitch.y, X_WS.psi + yaw_rate_S * dt)
        tick += STEP
    stations, hitches, *others = (np.array(column) for column in zip(*rows, strict=True))
    x, y, psi = hitches.T
    return Run(stations, true_off_tracking(x, y, psi, trailer.follow_distance), *others)
