"""Estimates, sensor readings, motion and ground of a combination as numbered signals, and back."""

import math
from collections.abc import Callable, Iterable, Mapping, Set
from typing import Final

import numpy as np

from estimators.estimates import Health, OffTracking
from offtrack.exchange.fmi_import.mapping import Signal, numbered
from sensors.messages import CombinationSignals
from vehicle.clock import TICK
from vehicle.combination.chain import Kinematics, SmoothGround, kinematics_sizes, smooth_ground_sizes
from vehicle.combination.description import Vehicle
from vehicle.combination.layout import GroundInputs, ground_input_sizes, slices, wheels
from vehicle.combination.loads import static_axle_loads
from vehicle.combination.plant import SurfaceLookup
from vehicle.combination.truth import Truth
from vehicle.frames import FloatArray, rotation_zyx, transform
from vehicle.surface import Surface

METRES: Final = 30  # of the hitch's path that an FMU can take, a metre apart
PATH_POINTS: Final = 200  # of the path as it is; a longer one is thinned out
NO_STD: Final = 1e3  # stands for an unknown standard deviation [m]
_HEALTH: Final = {Health.OK: 0.0, Health.DEGRADED: 1.0, Health.LOST: 2.0}
_OF_HEALTH: Final = {value: health for health, value in _HEALTH.items()}


MOTION: Final = (
    Signal("x", "m", "position of the tractor's rear axle"),
    Signal("y", "m", "position of the tractor's rear axle"),
    Signal("psi", "rad", "heading of the tractor, + left"),
    Signal("v_x", "m/s", "velocity of its rear axle along its x axis"),
    Signal("v_y", "m/s", "along its y axis"),
    Signal("yaw_rate", "rad/s", "of the tractor, + left"),
)  # of the tractor, as its driver knows it


def articulation_signals(n_units: int) -> tuple[Signal, ...]:
    """Signals of the articulation angles of a combination of ``n_units``."""
    hitches = range(1, n_units)
    return tuple(Signal(f"articulation_{k}", "rad", f"at hitch {k}: unit ahead minus unit behind") for k in hitches)


def estimate_signals(*, coarse: bool) -> tuple[Signal, ...]:
    """Signals of an estimate; they start as without one. ``coarse``: with the path at every metre too."""
    metres, points = range(1, METRES + 1), range(1, PATH_POINTS + 1)
    path = [
        *(Signal(f"path_x_{k}", "m", f"hitch's path {k} m back, in the trailer's frame") for k in metres),
        *(Signal(f"path_y_{k}", "m", f"hitch's path {k} m back, in the trailer's frame") for k in metres),
    ]
    return (
        Signal("off_tracking", "m", "estimated off-tracking, + when the path of the hitch lies left"),
        Signal("off_tracking_std", "m", "its stated standard deviation; 1e3 if there is none", NO_STD),
        Signal("off_tracking_known", "-", "1 once there is an estimate, also if it is lost"),
        Signal("off_tracking_valid", "-", "1 while there is an estimate that is not lost"),
        Signal("off_tracking_health", "-", "0 ok, 1 degraded, 2 lost", 2.0),
        Signal("off_tracking_age", "s", "since the image was taken"),
        Signal("off_tracking_time", "s", "at which the image was taken; -1: the age says it", -1.0),
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
    units, axles = range(1, n_units + 1), range(1, n_steered + 1)
    return (
        Signal("speed", "m/s", "of the tractor, by its wheels"),
        Signal("steer", "rad", "of the tractor's foremost steered axle, + left"),
        *articulation_signals(n_units),
        *(Signal(f"yaw_rate_{k}", "rad/s", f"gyro of unit {k}, the tractor is 1") for k in units),
        Signal("lateral_acceleration", "m/s2", "of the trailer's body above its axles, + left"),
        *(Signal(f"steer_trailer_{k}", "rad", f"encoder of steered axle {k}") for k in axles),
    )


def estimate_values(tick: int, estimate: OffTracking | None, used: Set[str]) -> dict[str, float]:
    """Signals [SI] of an estimate at a tick; without one all are 0, none is known and the health is lost.

    The points of the path are given only where they are ``used``.
    """
    if estimate is None:
        return {name: start for name, start in _UNKNOWN.items() if name in used or not name.startswith("path_")}
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


_UNKNOWN: Final = {one.name: one.start for one in estimate_signals(coarse=True)}


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
    return CombinationSignals(
        tick=tick,
        angles=column(values, "steer_trailer", n_steered),
        speed=values["speed"],
        steer=values["steer"],
        articulation=column(values, "articulation", n_units - 1),
        yaw_rates=column(values, "yaw_rate", n_units),
        lateral_acceleration=values["lateral_acceleration"],
    )


def column(values: Mapping[str, float], name: str, count: int) -> FloatArray:
    """Signals (count,) of a name by their numbers."""
    return np.array([values[f"{name}_{k}"] for k in range(1, count + 1)])


def columns(values: Mapping[str, float], names: Iterable[str], count: int) -> FloatArray:
    """Signals of several names side by side (count, number of names)."""
    return np.column_stack([column(values, name, count) for name in names])


def numbered_values(name: str, values: Iterable[float]) -> dict[str, float]:
    """Values by ``name_1``, ``name_2``, …."""
    return {f"{name}_{k}": float(value) for k, value in enumerate(values, start=1)}


def _numbered_columns(names: Iterable[str], table: FloatArray) -> dict[str, float]:
    """Columns of a table by their names, numbered by its rows."""
    columns = zip(names, table.T, strict=True)
    return {key: value for name, column in columns for key, value in numbered_values(name, column).items()}


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
    return {"path_points": float(len(path)), **_numbered_columns(("path_point_x", "path_point_y"), kept)}


_BODY = ("x", "y", "z", "roll", "pitch", "yaw")
OnGround = Callable[[int, float, float, float], FloatArray]


def motion_signals(vehicle: Vehicle) -> tuple[Signal, ...]:
    """Everything that ``Truth`` has, a body's pose as position and angles; units count from 1, the tractor."""
    units, tyres = [unit.name for unit in vehicle.units], wheel_names(vehicle)
    axles = [(unit.name, k) for unit in vehicle.units for k, _ in enumerate(unit.steered_axles, start=1)]
    origin = [f"position of {name}: {'its front hitch' if k else 'its rear axle'}" for k, name in enumerate(units)]
    return (
        *numbered("x", "m", origin),
        *numbered("y", "m", origin),
        *numbered("psi", "rad", [f"heading of {name}, + left, continuous" for name in units]),
        *numbered("v_x", "m/s", [f"velocity of that point along the x axis of {name}" for name in units]),
        *numbered("v_y", "m/s", [f"velocity of that point along the y axis of {name}" for name in units]),
        *numbered("yaw_rate", "rad/s", [f"of {name}" for name in units]),
        *numbered("heave", "m", [f"of the body of {name} above the ground's height, + up" for name in units]),
        *numbered("pitch", "rad", [f"of the body of {name} against the ground, + nose down" for name in units]),
        *numbered("roll", "rad", [f"of the body of {name} against the ground, + left side up" for name in units]),
        *(
            signal
            for k, name in enumerate(units, start=1)
            for signal in (
                *(Signal(f"body_{axis}_{k}", "m", f"origin of the body of {name} in the world") for axis in "xyz"),
                Signal(f"body_roll_{k}", "rad", f"of the body of {name}, about its x axis, third"),
                Signal(f"body_pitch_{k}", "rad", f"of the body of {name}, about the y axis, second, + nose down"),
                Signal(f"body_yaw_{k}", "rad", f"of the body of {name}, about the z axis, first; -pi to pi"),
            )
        ),
        *numbered("steer_angle", "rad", [f"angle of steered axle {k} of {name}, + left" for name, k in axles]),
        *numbered("wheel_load", "N", [f"vertical force of {tyre}" for tyre in tyres]),
        *numbered("wheel_slip_angle", "rad", [f"of {tyre}" for tyre in tyres]),
        *numbered("friction_used", "-", [f"horizontal force of {tyre} over friction times load" for tyre in tyres]),
        *numbered("load_transfer", "-", [f"of {name}: right less left wheel loads over all" for name in units]),
        *numbered("wheel_speed", "m/s", [f"of the tread of {tyre}, by its rotation" for tyre in tyres]),
        *numbered("articulation", "rad", [f"heading of {name} less that of the next unit" for name in units[:-1]]),
    )  # fmt: skip


def kind_of(signal: Signal) -> str:
    """Name of a numbered signal without its number."""
    return signal.name.rstrip("0123456789").rstrip("_")


def wheel_names(vehicle: Vehicle) -> list[str]:
    """The wheels in words, in their order."""
    return [
        f"the {'left' if wheel.side > 0 else 'right'} wheel of axle {wheel.axle_in_unit + 1} of "
        f"{vehicle.units[wheel.unit].name}"
        for wheel in wheels(vehicle)
    ]


def truth_signals(vehicle: Vehicle) -> tuple[Signal, ...]:
    """Signals of the motion that ``truth_of`` needs.

    A body whose pose is all 0 stands on the ground. Wheels roll where all of their speeds are 0.
    """
    motion = {"x", "y", "psi", "v_x", "v_y", "yaw_rate", "steer_angle", "wheel_speed"}
    needed = motion | {f"body_{axis}" for axis in _BODY}
    return tuple(signal for signal in motion_signals(vehicle) if kind_of(signal) in needed)


def truth_values(truth: Truth) -> dict[str, float]:
    """Signals [SI] of a ground truth."""
    return {
        **_numbered_columns(("x", "y", "psi"), truth.poses),
        **_numbered_columns(("v_x", "v_y", "yaw_rate"), truth.velocities),
        **_numbered_columns([f"body_{axis}" for axis in _BODY], np.array([_six(body) for body in truth.bodies])),
        **numbered_values("steer_angle", truth.steer),
        **numbered_values("wheel_speed", 0.0 * truth.wheel_loads if truth.wheel_speeds is None else truth.wheel_speeds),
    }


def truth_of(tick: int, values: Mapping[str, float], vehicle: Vehicle, on_ground: OnGround) -> Truth:
    """The ground truth behind signals; wheel loads are the static ones, slip angles and friction used are 0.

    Args:
        tick: its time.
        values: signals by name.
        vehicle: the vehicle that moves.
        on_ground: pose (4, 4) of the body of a unit that stands on the ground at x, y, psi.
    """
    n, steered = len(vehicle.units), sum(len(unit.steered_axles) for unit in vehicle.units)
    poses = columns(values, ("x", "y", "psi"), n)
    bodies = []
    for k, (x, y, psi) in enumerate(poses.tolist()):
        six = [values[f"body_{axis}_{k + 1}"] for axis in _BODY]
        is_given = any(six)
        R_WB = rotation_zyx(six[5], six[4], six[3])
        bodies.append(transform(R_WB, np.array(six[:3])) if is_given else on_ground(k, x, y, psi))
    speeds = column(values, "wheel_speed", vehicle.n_wheels)
    return Truth(
        tick=tick,
        poses=poses,
        velocities=columns(values, ("v_x", "v_y", "yaw_rate"), n),
        bodies=np.array(bodies),
        steer=column(values, "steer_angle", steered),
        wheel_loads=np.repeat(0.5 * np.concatenate(static_axle_loads(vehicle)), 2),
        wheel_slip_angles=np.zeros(vehicle.n_wheels),
        friction_used=np.zeros(vehicle.n_wheels),
        load_transfer=np.zeros(n),
        wheel_speeds=speeds if speeds.any() else None,
    )


def _six(X: FloatArray) -> list[float]:
    """Position [m], then roll, pitch and yaw [rad] of a pose (4, 4)."""
    x, y, z = X[:3, 3].tolist()
    roll = math.atan2(X[2, 1], X[2, 2])
    pitch = math.atan2(-X[2, 0], math.hypot(X[2, 1], X[2, 2]))
    return [x, y, z, roll, pitch, math.atan2(X[1, 0], X[0, 0])]


_NAMES = GroundInputs("friction_wheel", "ground_slope_x", "ground_slope_y", "road_height", "wind")
_HEIGHT = "ground_height"


def ground_signals(vehicle: Vehicle) -> tuple[Signal, ...]:
    """Signals of the ground under a vehicle, in the order of ``GroundInputs``; then what lifts and tilts its bodies."""
    units, tyres = [unit.name for unit in vehicle.units], wheel_names(vehicle)
    supports = [f"{end} support of {name}" for name in units for end in ("front", "rear")]
    tilt = "on curved ground: mean rise at the supports of {} less that under its centre of gravity: tilts its body"
    return (
        *numbered("friction_wheel", "-", [f"friction coefficient under {tyre}; 0: as at the start" for tyre in tyres]),
        *numbered("ground_slope_x", "-", [f"rise of the ground under {name} along x of the world" for name in units]),
        *numbered("ground_slope_y", "-", [f"rise of the ground under {name} along y of the world" for name in units]),
        *numbered("road_height", "m", [f"height of the road under {tyre} above the smooth one" for tyre in tyres]),
        *numbered("wind", "m/s", [f"wind at {name} along y of the world" for name in units if vehicle.exposed]),
        *numbered(_HEIGHT, "m", [f"height of the smooth ground at the {at}: lifts its body" for at in supports]),
        *numbered("body_slope_x", "-", [f"{tilt.format(name)} along x of the world" for name in units]),
        *numbered("body_slope_y", "-", [f"{tilt.format(name)} along y of the world" for name in units]),
    )


class GroundUnder:
    """Ground of a surface under the wheels, centres of gravity and supports of a vehicle."""

    def __init__(self, surface: Surface, vehicle: Vehicle) -> None:
        self._lookup = SurfaceLookup(surface, vehicle)
        self._into = Kinematics(*slices(kinematics_sizes(vehicle)))
        self._parts = GroundInputs(*slices(ground_input_sizes(vehicle)))
        self._smooth = SmoothGround(*slices(smooth_ground_sizes(vehicle)))
        self._size = sum(kinematics_sizes(vehicle))
        units = range(len(vehicle.units))
        self._centres = np.array([(k, vehicle.units[k].cg_x, 0.0) for k in units])
        self._wheels = np.array([(wheel.unit, wheel.axle.x, wheel.y) for wheel in wheels(vehicle)])
        self._supports = np.array([(k, x, 0.0) for k in units for x in vehicle.supports(k)])

    def values(self, poses: FloatArray) -> dict[str, float]:
        """Signals [SI] under units at these poses (N, 3)."""
        at, into = np.zeros(self._size), self._into
        at[into.centre_x], at[into.centre_y] = _places(poses, self._centres)
        at[into.wheel_x], at[into.wheel_y] = _places(poses, self._wheels)
        at[into.support_x], at[into.support_y] = _places(poses, self._supports)
        inputs, smooth = self._lookup.ground_inputs(at), self._lookup.smooth_ground(at)
        columns = dict(zip(_NAMES, (inputs[part] for part in self._parts), strict=True))
        columns[_HEIGHT] = smooth[self._smooth.height]
        for axis, of_supports in (("x", self._smooth.slope_x), ("y", self._smooth.slope_y)):
            means = smooth[of_supports].reshape(-1, 2).mean(axis=1)  # of the front and rear support of every unit
            columns[f"body_slope_{axis}"] = means - columns[f"ground_slope_{axis}"]
        return {key: x for name, column in columns.items() for key, x in numbered_values(name, column).items()}


def _places(poses: FloatArray, points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Positions x, y in the world of points (unit, x, y) in the frames of their units."""
    x, y, psi = poses[points[:, 0].astype(int)].T
    _, along, left = points.T
    c, s = np.cos(psi), np.sin(psi)
    return x + (c * along - s * left), y + (s * along + c * left)
