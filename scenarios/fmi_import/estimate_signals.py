"""Estimates of off-tracking and readings of the combination's sensors as numbered signals, and back."""

from __future__ import annotations

import math
from collections.abc import Mapping, Set
from typing import Final

import numpy as np

from estimators.estimates import Health, OffTracking
from scenarios.fmi_import.mapping import Signal
from sensors.messages import CombinationSignals
from vehicle.clock import TICK
from vehicle.frames import FloatArray

METRES: Final = 30  # of the hitch's path that an FMU can take, a metre apart
PATH_POINTS: Final = 200  # of the path as it is; a longer one is thinned out
NO_STD: Final = 1e3  # stands for an unknown standard deviation [m]
_HEALTH: Final = {Health.OK: 0.0, Health.DEGRADED: 1.0, Health.LOST: 2.0}
_OF_HEALTH: Final = {value: health for health, value in _HEALTH.items()}


def estimate_signals(*, coarse: bool) -> tuple[Signal, ...]:
    """Signals of an estimate; ``coarse``: with the path at every metre besides its own points."""
    metres, points = range(1, METRES + 1), range(1, PATH_POINTS + 1)
    path = [
        *(Signal(f"path_x_{k}", "m", f"hitch's path {k} m back, in the trailer's frame") for k in metres),
        *(Signal(f"path_y_{k}", "m", f"hitch's path {k} m back, in the trailer's frame") for k in metres),
    ]
    return (
        Signal("off_tracking", "m", "estimated off-tracking, + when the path of the hitch lies left"),
        Signal("off_tracking_std", "m", "its stated standard deviation; 1e3 if there is none"),
        Signal("off_tracking_known", "-", "1 once there is an estimate, also if it is lost"),
        Signal("off_tracking_valid", "-", "1 while there is an estimate that is not lost"),
        Signal("off_tracking_health", "-", "0 ok, 1 degraded, 2 lost"),
        Signal("off_tracking_age", "s", "since the image was taken"),
        Signal("off_tracking_time", "s", "at which the image was taken; -1: the age says it"),
        Signal("off_tracking_bridged", "s", "since the last motion that was measured, by dead reckoning"),
        Signal("path_tangent", "rad", "direction of the hitch's path at the follow point, in the trailer's frame"),
        Signal("hitch_direction", "rad", "direction of the hitch's travel in the trailer's frame, + left"),
        Signal("hitch_direction_rate", "rad/s", "its rate of change"),
        Signal("hitch_speed", "m/s", "estimated velocity of the hitch along the trailer's x axis"),
        Signal("hitch_lateral_speed", "m/s", "along its y axis"),
        Signal("trailer_yaw_rate", "rad/s", "estimated, of the trailer"),
        *(path if coarse else ()),
        Signal("path_points", "-", "number of points of the estimated path"),
        *(Signal(f"path_point_x_{k}", "m", f"point {k} of the path, newest first, trailer's frame") for k in points),
        *(Signal(f"path_point_y_{k}", "m", f"point {k} of the path, newest first, trailer's frame") for k in points),
    )


def reading_signals(n_steered: int, n_units: int) -> tuple[Signal, ...]:
    """Signals of the sensors for a trailer with ``n_steered`` steered axles in a combination of ``n_units``."""
    hitches, units, axles = range(1, n_units), range(1, n_units + 1), range(1, n_steered + 1)
    return (
        Signal("speed", "m/s", "of the tractor, by its wheels"),
        Signal("steer", "rad", "of the tractor's foremost steered axle, + left"),
        *(Signal(f"articulation_{k}", "rad", f"at hitch {k}: unit ahead minus unit behind") for k in hitches),
        *(Signal(f"yaw_rate_{k}", "rad/s", f"gyro of unit {k}, the tractor is 1") for k in units),
        Signal("lateral_acceleration", "m/s2", "of the trailer's body above its axles, + left"),
        *(Signal(f"steer_trailer_{k}", "rad", f"encoder of steered axle {k}") for k in axles),
    )


def estimate_values(tick: int, estimate: OffTracking | None, used: Set[str]) -> dict[str, float]:
    """Signals [SI] of an estimate at a tick; without one all are 0, none is known and the health is lost.

    The points of the path are given only where they are ``used``.
    """
    if estimate is None:
        unknown = dict.fromkeys((name for name in used if name.startswith("path_")), 0.0)
        return unknown | {
            **dict.fromkeys(_ZEROS, 0.0),
            "off_tracking_std": NO_STD,
            "off_tracking_health": 2.0,
            "off_tracking_time": -1.0,
        }
    values = {
        "off_tracking": estimate.value,
        "off_tracking_std": min(estimate.std, NO_STD),
        "off_tracking_known": 1.0,
        "off_tracking_valid": float(estimate.health is not Health.LOST),
        "off_tracking_health": _HEALTH[estimate.health],
        "off_tracking_age": estimate.age(tick),
        "off_tracking_time": estimate.tick * TICK,
        "off_tracking_bridged": estimate.bridged,
        "path_tangent": estimate.path_tangent,
        "hitch_direction": estimate.hitch_direction,
        "hitch_direction_rate": estimate.hitch_direction_rate,
        "hitch_speed": estimate.v_x,
        "hitch_lateral_speed": estimate.v_y,
        "trailer_yaw_rate": estimate.yaw_rate,
    }
    if any(name.startswith(("path_x_", "path_y_")) for name in used):
        values |= _at_every_metre(estimate.path)
    if "path_points" in used:
        values |= _points(estimate.path)
    return values


_ZEROS: Final = ("off_tracking", "off_tracking_known", "off_tracking_valid", "off_tracking_age",
                 "off_tracking_bridged", "path_tangent", "hitch_direction", "hitch_direction_rate", "hitch_speed",
                 "hitch_lateral_speed", "trailer_yaw_rate")  # fmt: skip


def estimate_of(tick: int, values: Mapping[str, float]) -> OffTracking | None:
    """The estimate behind signals at a tick; None if none is known."""
    if values["off_tracking_known"] < 0.5:
        return None
    count = max(0, min(PATH_POINTS, round(values["path_points"])))
    points = range(1, count + 1)  # without any, the path is the hitch alone
    path = [[values[f"path_point_x_{k}"], values[f"path_point_y_{k}"]] for k in points] or [[0.0, 0.0]]
    std = values["off_tracking_std"]
    time, age = values["off_tracking_time"], values["off_tracking_age"]
    return OffTracking(
        tick=round(time / TICK) if time >= 0.0 else tick - round(age / TICK),
        value=values["off_tracking"],
        std=std if std < NO_STD else math.inf,
        health=_OF_HEALTH.get(values["off_tracking_health"], Health.LOST),
        path=np.array(path),
        hitch_direction=values["hitch_direction"],
        hitch_direction_rate=values["hitch_direction_rate"],
        path_tangent=values["path_tangent"],
        v_x=values["hitch_speed"],
        v_y=values["hitch_lateral_speed"],
        yaw_rate=values["trailer_yaw_rate"],
        bridged=values["off_tracking_bridged"],
    )


def reading_values(reading: CombinationSignals) -> dict[str, float]:
    """Signals [SI] of a reading of the sensors."""
    return {
        "speed": reading.speed,
        "steer": reading.steer,
        "lateral_acceleration": reading.lateral_acceleration,
        **numbered_values("articulation", reading.articulation),
        **numbered_values("yaw_rate", reading.yaw_rates),
        **numbered_values("steer_trailer", reading.angles),
    }


def reading_of(tick: int, values: Mapping[str, float], n_steered: int, n_units: int) -> CombinationSignals:
    """The reading behind signals."""

    def column(name: str, count: int) -> FloatArray:
        return np.array([values[f"{name}_{k}"] for k in range(1, count + 1)])

    return CombinationSignals(
        tick=tick,
        angles=column("steer_trailer", n_steered),
        speed=values["speed"],
        steer=values["steer"],
        articulation=column("articulation", n_units - 1),
        yaw_rates=column("yaw_rate", n_units),
        lateral_acceleration=values["lateral_acceleration"],
    )


def numbered_values(name: str, values: FloatArray) -> dict[str, float]:
    """Values by ``name_1``, ``name_2``, …."""
    return {f"{name}_{k}": float(value) for k, value in enumerate(values, start=1)}


def _at_every_metre(path: FloatArray) -> dict[str, float]:
    """Points of the hitch's path, a metre apart; past its end the last one."""
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(path, axis=0).T))])
    back = np.arange(1.0, METRES + 1.0)
    return {
        **numbered_values("path_x", np.interp(back, along, path[:, 0])),
        **numbered_values("path_y", np.interp(back, along, path[:, 1])),
    }


def _points(path: FloatArray) -> dict[str, float]:
    """The points themselves, thinned out if there are too many; behind them the last one."""
    count = len(path)
    if count > PATH_POINTS:
        path = path[np.linspace(0, count - 1, PATH_POINTS).round().astype(int)]
    kept = np.concatenate([path, np.repeat(path[-1:], PATH_POINTS - len(path), axis=0)])
    return {
        "path_points": float(len(path)),
        **numbered_values("path_point_x", kept[:, 0]),
        **numbered_values("path_point_y", kept[:, 1]),
    }
