"""Checks that the dynamic model tends to the kinematic one at low speed and high friction.

The slalom needs the package commonroad-vehicle-models, a development dependency that nothing else needs.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from importlib.util import find_spec
from types import SimpleNamespace
from typing import Final, NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline

from scenarios.validation.check import Check, Plot, Section, Series
from scenarios.validation.driving import poses_of, round_circle, steered
from scenarios.validation.vehicles import gripping, tractor_and_trailer
from vehicle.clock import TICK
from vehicle.combination.description import Vehicle, load_vehicle
from vehicle.combination.truth import Truth
from vehicle.frames import FloatArray
from vehicle.surface import Surface

_PACKAGE: Final = "commonroad-vehicle-models"
_WIDE: Final = 1e3  # limits of steering, speed and acceleration that are never reached, in any unit
_RADIUS, _LENGTH = 20.0, 7.7  # of the hitch's circle, hitch to axle [m]
_SPEEDS: Final = (0.5, 1.0, 2.0, 3.5, 5.0)  # [m/s]; at most 1.25 m/s2, 0.85 of the smallest friction
_FRICTIONS: Final = (0.15, 0.3, 1.5)  # snow, packed snow, the largest possible
_SLALOM_SPEED, _SLALOM_TIME = 0.5, 80.0  # [m/s], [s]


def no_slip_limit(quick: bool) -> Section:
    """Slip on a circle over speed and friction, and a slalom compared with a published kinematic trailer model."""
    speeds, frictions = (_SPEEDS[1:], _FRICTIONS[::2]) if quick else (_SPEEDS, _FRICTIONS)
    turns = {friction: [_turn(speed, friction) for speed in speeds] for friction in frictions}
    return Section(
        title="Kinematic limit",
        text="On its own tyres the combination turns with its hitch on a circle of 20 m. The result is the distance of "
        "the trailer's axle from its path without slip. In a slalom the motion is compared with the kinematic trailer "
        "model of an independent package.",
        checks=(*_limit_checks(turns), *_slalom_checks()),
        plots=(_plot(turns),),
    )


class _Turn(NamedTuple):
    """A settled turn."""

    speed: float  # of the hitch [m/s]
    distance: float  # of the trailer's axle from its path without slip, + outwards [m]


def _turn(speed: float, friction: float) -> _Turn:
    """Settled turn of the combination on its own tyres."""
    vehicle = tractor_and_trailer(load_vehicle("eu_tractor_semitrailer"), length=_LENGTH, hitch_x=0.0)
    truths = round_circle(vehicle, _RADIUS, speed, 12.0 * _LENGTH, surface=Surface(friction=friction))
    v_x, v_y, turning = truths[-1].velocities[1].tolist()
    hitch, axle = math.hypot(v_x, v_y), math.hypot(v_x, v_y - _LENGTH * turning)
    return _Turn(hitch, axle / turning - math.sqrt((hitch / turning) ** 2 - _LENGTH**2))


def _limit_checks(turns: dict[float, list[_Turn]]) -> tuple[Check, ...]:
    most, least = max(turns), min(turns)
    speeds, distances = np.array(turns[most]).T
    return (
        Check(
            name=f"trailer's axle on friction {most:g}: order in speed of its distance from the no-slip path",
            value=float(np.polyfit(np.log(speeds), np.log(distances), 1)[0]),
            target=2.0,
            tolerance=0.03,  # at the highest speed the turn is a little wider
            unit="",
            source="side force and slip are proportional to the square of speed",
        ),
        Check(
            f"distance on friction {most:g} at {speeds[0]:.2g} m/s",
            float(distances[0]),
            "m",
            target=0.0,
            tolerance=0.01,
            source="no slip without side force",
        ),
        Check(
            f"distance on friction {most:g} over that on {least:g}, at {speeds[-1]:.2g} m/s",
            turns[most][-1].distance / turns[least][-1].distance,
            "",
            target=0.5,
            tolerance=0.5,
            source="less slip with more friction: between 0 and 1",
        ),
    )


def _plot(turns: dict[float, list[_Turn]]) -> Plot:
    speeds, distances = np.array(turns[max(turns)]).T
    return Plot(
        title="Distance of the trailer's axle from its path without slip",
        x_label="speed [m/s]",
        y_label="distance [m]",
        series=(
            *(_series(f"friction {friction:g}", at) for friction, at in turns.items()),
            Series("square of speed", speeds, distances[0] * (speeds / speeds[0]) ** 2, "reference"),
        ),
        logarithmic=True,
    )


def _series(label: str, turns: list[_Turn]) -> Series:
    speeds, distances = np.array(turns).T
    return Series(label, speeds, distances, "model")


def _slalom_checks() -> tuple[Check, ...]:
    """Largest differences from the package's model in a slalom."""
    differences: tuple[float | None, ...] = (None, None, None)
    if _installed():
        vehicle = gripping(tractor_and_trailer(load_vehicle("eu_tractor_semitrailer"), length=_LENGTH, hitch_x=0.0))
        truths = steered(vehicle, _slalom, _SLALOM_SPEED, _SLALOM_TIME)
        differences = _differences(poses_of(truths), kinematic_poses(vehicle, truths))
    rows = (("position", 0.01, "m"), ("yaw", 0.02, "°"), ("articulation", 0.02, "°"))
    return tuple(
        Check(
            f"slalom of {_SLALOM_SPEED * _SLALOM_TIME:g} m: largest difference of {name}",
            value,
            unit,
            target=0.0,
            tolerance=tolerance,
            source=f"{_PACKAGE}, kinematic single-track model with a trailer (KST)",
            remark="" if _installed() else "not installed: pip install commonroad-vehicle-models",
        )
        for (name, tolerance, unit), value in zip(rows, differences, strict=True)
    )


def _slalom(time: float) -> float:
    """Steer demand [rad]: waves of 20 m, from 12 degrees right to 20 degrees left."""
    return math.radians(4.0 + 16.0 * math.sin(math.tau * time * _SLALOM_SPEED / 20.0))


def _differences(dynamic: FloatArray, kinematic: FloatArray) -> tuple[float, ...]:
    """Largest distance [m] between the tractors, and largest differences of yaw and articulation [deg]."""
    distance = np.hypot(*(dynamic - kinematic)[:, 0, :2].T)
    yaw, trailer_yaw = np.degrees(dynamic - kinematic)[:, :, 2].T
    return float(distance.max()), float(np.abs(yaw).max()), float(np.abs(yaw - trailer_yaw).max())


def _installed() -> bool:
    """True if the package is installed."""
    return find_spec("vehiclemodels") is not None


def kinematic_poses(vehicle: Vehicle, truths: Sequence[Truth]) -> FloatArray:
    """Poses (n, 2, 3) of a tractor and a trailer hitched to its rear axle, steered and driven like the dynamic model.

    Steer rate and acceleration come from splines through the steer angles and speeds of the dynamic model.
    """
    from vehiclemodels.vehicle_dynamics_kst import vehicle_dynamics_kst

    time = np.array([now.tick for now in truths]) * TICK
    steer = CubicSpline(time, [now.steer[0] for now in truths])
    speed = CubicSpline(time, [now.velocities[0, 0] for now in truths])
    parameters, (steer_rate, acceleration) = _parameters(vehicle), (steer.derivative(), speed.derivative())

    def rate(t: float, x: FloatArray) -> FloatArray:
        inputs = [float(steer_rate(t)), float(acceleration(t))]
        return np.array(vehicle_dynamics_kst(x.tolist(), inputs, parameters))

    x_0, y_0, psi_0 = truths[0].poses[0]
    # the package's hitch angle is the trailer's yaw minus the tractor's
    x = np.array([x_0, y_0, float(steer(0.0)), float(speed(0.0)), psi_0, truths[0].poses[1, 2] - psi_0])
    states = [x]
    for t, h in zip(time[:-1].tolist(), np.diff(time).tolist(), strict=True):
        k_1 = rate(t, x)
        k_2 = rate(t + 0.5 * h, x + 0.5 * h * k_1)
        k_3 = rate(t + 0.5 * h, x + 0.5 * h * k_2)
        k_4 = rate(t + h, x + h * k_3)
        x = x + h / 6.0 * (k_1 + 2.0 * k_2 + 2.0 * k_3 + k_4)
        states.append(x)
    x_T, y_T, _, _, psi_T, hitch = np.array(states).T
    return np.stack([np.stack([x_T, y_T, psi_T], axis=1), np.stack([x_T, y_T, psi_T + hitch], axis=1)], axis=1)


def _parameters(vehicle: Vehicle) -> SimpleNamespace:
    """Parameters of the package's model; only the sum of ``a`` and ``b``, the wheelbase, matters."""
    return SimpleNamespace(
        a=vehicle.units[0].steered_axles[0].x,
        b=0.0,
        trailer=SimpleNamespace(l_wb=-vehicle.units[1].axles[0].x),
        steering=SimpleNamespace(min=-_WIDE, max=_WIDE, v_min=-_WIDE, v_max=_WIDE),
        longitudinal=SimpleNamespace(v_min=-_WIDE, v_max=_WIDE, v_switch=_WIDE, a_max=_WIDE),
    )
