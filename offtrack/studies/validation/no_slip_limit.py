"""Checks that the dynamic model tends to the kinematic one: turns, a slalom, and AASHTO's design vehicles.

The slalom needs the package commonroad-vehicle-models, a development dependency that nothing else needs.

Every unit rolls on one axle; a group of axles is replaced by one in its middle.
"""

import math
from collections.abc import Sequence
from importlib.util import find_spec
from types import SimpleNamespace
from typing import Final, NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline

from controllers.path import Path, arc, line
from offtrack.studies.validation import simple_drives
from offtrack.studies.validation.check import Check, CheckSection, Plot, Series
from scenarios.assembly.adapters import outlines
from scenarios.results.swept_path import placed
from vehicle.clock import TICK
from vehicle.combination.description import GRAVITY, Vehicle, load_vehicle
from vehicle.combination.truth import Truth
from vehicle.frames import FloatArray, Pose2
from vehicle.surface import Surface

_PACKAGE: Final = "commonroad-vehicle-models"
_WIDE: Final = 1e3  # limits of steering, speed and acceleration that are never reached, in any unit
_RADIUS, _LENGTH = 20.0, 7.7  # of the hitch's circle, hitch to axle [m]
_SLIP_STIFFNESS: Final = 4.6  # cornering stiffness over load of the trailer's tyres [1/rad]
_SPEEDS: Final = (0.5, 1.0, 2.0, 3.5, 5.0)  # [m/s]; at most 1.25 m/s2, 0.85 of the smallest friction
_FRICTIONS: Final = (0.15, 0.3, 1.5)  # snow, packed snow, the largest possible
_SLALOM_SPEED, _SLALOM_TIME = 0.5, 80.0  # [m/s], [s]


def no_slip_limit(quick: bool) -> CheckSection:
    """Slip on a circle over speed and friction, and a slalom compared with a published kinematic trailer model."""
    speeds, frictions = (_SPEEDS[1:], _FRICTIONS[::2]) if quick else (_SPEEDS, _FRICTIONS)
    turns = {friction: [_turn(speed, friction) for speed in speeds] for friction in frictions}
    return CheckSection(
        title="Kinematic limit",
        text="On its own tyres the combination turns with its hitch on a circle of 20 m. The result is the distance of "
        "the trailer's axle from its path without slip. In a slalom the motion is compared with the kinematic trailer "
        "model of an independent package.",
        checks=(*_limit_checks(turns), *slalom_checks()),
        plots=(_plot(turns),),
    )


class _SettledTurn(NamedTuple):
    """A settled turn."""

    speed: float  # of the hitch [m/s]
    distance: float  # of the trailer's axle from its path without slip, + outwards [m]


def _turn(speed: float, friction: float) -> _SettledTurn:
    """Settled turn of the combination on its own tyres."""
    vehicle = simple_drives.tractor_and_trailer(load_vehicle("eu_tractor_semitrailer"), length=_LENGTH, hitch_x=0.0)
    truths = simple_drives.round_circle(vehicle, _RADIUS, speed, 12.0 * _LENGTH, surface=Surface(friction=friction))
    v_x, v_y, turning = truths[-1].velocities[1].tolist()
    hitch, axle = math.hypot(v_x, v_y), math.hypot(v_x, v_y - _LENGTH * turning)
    return _SettledTurn(hitch, axle / turning - math.sqrt((hitch / turning) ** 2 - _LENGTH**2))


def _limit_checks(turns: dict[float, list[_SettledTurn]]) -> tuple[Check, ...]:
    most, least = max(turns), min(turns)
    speeds, distances = np.array(turns[most]).T
    return (
        Check(
            name=f"trailer's axle on friction {most:g}: order in speed of its distance from the no-slip path",
            value=float(np.polyfit(np.log(speeds), np.log(distances), 1)[0]),
            target=2.0,
            tolerance=0.03,  # at the highest speed the turn is a little wider
            source="side force and slip are proportional to the square of speed",
        ),
        Check(
            f"distance on friction {most:g} at {speeds[0]:.2g} m/s",
            float(distances[0]),
            "m",
            tolerance=0.01,
            source="no slip without side force",
        ),
        Check(
            f"distance on friction {most:g} over that on {least:g}, at {speeds[-1]:.2g} m/s",
            turns[most][-1].distance / turns[least][-1].distance,
            target=0.45,
            tolerance=0.45,
            source="less slip with more friction: between 0 and 0.9",
        ),
        Check(
            f"distance on friction {most:g} at {speeds[-1]:.2g} m/s over lever and slip angle of the axle",
            float(distances[-1]) / (_LENGTH * speeds[-1] ** 2 / _RADIUS / GRAVITY / _SLIP_STIFFNESS),
            target=1.0,
            tolerance=0.25,  # the axle runs inside of the hitch, and is heavily loaded
            source="slip angle: lateral acceleration in g over the tyres' stiffness over load",
        ),
    )


def _plot(turns: dict[float, list[_SettledTurn]]) -> Plot:
    speeds, distances = np.array(turns[max(turns)]).T
    return Plot(
        title="Distance of the trailer's axle from its path without slip",
        x_label="speed [m/s]",
        y_label="distance [m]",
        series=(
            *(Series(f"friction {friction:g}", *_xy(np.array(at)), "model") for friction, at in turns.items()),
            Series("square of speed", speeds, distances[0] * (speeds / speeds[0]) ** 2, "reference"),
        ),
        logarithmic=True,
    )


def slalom_checks() -> tuple[Check, ...]:
    """Largest differences from the package's model in a slalom."""
    differences: tuple[float | None, ...] = (None, None, None)
    if installed():
        vehicle = simple_drives.gripping(
            simple_drives.tractor_and_trailer(load_vehicle("eu_tractor_semitrailer"), length=_LENGTH, hitch_x=0.0)
        )
        truths = simple_drives.steered(vehicle, _slalom, _SLALOM_SPEED, _SLALOM_TIME)
        differences = _differences(simple_drives.poses_of(truths), kinematic_poses(vehicle, truths))
    rows = (("position", 0.01, "m"), ("yaw", 0.02, "°"), ("articulation", 0.02, "°"))
    return tuple(
        Check(
            f"slalom of {_SLALOM_SPEED * _SLALOM_TIME:g} m: largest difference of {name}",
            value,
            unit,
            tolerance=tolerance,
            source=f"{_PACKAGE}, kinematic single-track model with a trailer (KST)",
            remark="" if installed() else "not installed: pip install commonroad-vehicle-models",
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


def installed() -> bool:
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
    states = [np.array([x_0, y_0, float(steer(0.0)), float(speed(0.0)), psi_0, truths[0].poses[1, 2] - psi_0])]
    for t, h in zip(time[:-1].tolist(), np.diff(time).tolist(), strict=True):
        states.append(simple_drives.runge_kutta(rate, t, states[-1], h))
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


_SPACING: Final = 0.05  # step size along the path [m]: a jump of the curvature costs some 5e-6 rad


class NoSlipChain(NamedTuple):
    """Lengths of a combination that rolls without slip."""

    hitches: tuple[float, ...]  # x of the hitch of every unit but the last [m]
    lengths: tuple[float, ...]  # hitch to axle of every towed unit [m]


def rolling_chain(vehicle: Vehicle) -> NoSlipChain:
    """Lengths of a vehicle, with one axle in the middle of the axles of each towed unit."""
    return NoSlipChain(
        hitches=tuple(unit.hitch_x or 0.0 for unit in vehicle.units[:-1]),
        lengths=tuple(-float(np.mean([axle.x for axle in unit.axles])) for unit in vehicle.units[1:]),
    )


def poses_along(chain: NoSlipChain, path: Path, reference: tuple[float, float]) -> FloatArray:
    """x [m], y [m], psi [rad] of every unit's frame, (n, N, 3), while a point of the tractor moves along a path.

    ``reference`` is the position of that point in the tractor [m]. The combination is straight at the start.
    """
    steps = int(np.ceil(path.length / _SPACING))
    h = path.length / steps
    psi = np.full(1 + len(chain.lengths), path.start.psi)
    poses = [_poses(chain, path, reference, 0.0, psi)]
    for k in range(steps):
        psi = simple_drives.runge_kutta(lambda s, psi: _turning(chain, path, reference, s, psi), k * h, psi, h)
        poses.append(_poses(chain, path, reference, (k + 1) * h, psi))
    return np.array(poses)


def _turning(chain: NoSlipChain, path: Path, reference: tuple[float, float], s: float, psi: FloatArray) -> FloatArray:
    """Yaw of each unit per distance of the guided point [rad/m], with no axle moving sideways."""
    x_ref, y_ref = reference
    chi = path.pose(s).psi - psi[0]
    turning = np.empty(len(psi))
    turning[0] = np.sin(chi) / x_ref
    forward, left = np.cos(chi) + turning[0] * y_ref, 0.0  # velocity of the unit's origin over that of the guided point
    for k, (hitch, length) in enumerate(zip(chain.hitches, chain.lengths, strict=True)):
        left = left + turning[k] * hitch
        gamma = psi[k] - psi[k + 1]
        c, sn = np.cos(gamma), np.sin(gamma)
        forward, left = c * forward - sn * left, sn * forward + c * left
        turning[k + 1] = left / length
    return turning


def _poses(chain: NoSlipChain, path: Path, reference: tuple[float, float], s: float, psi: FloatArray) -> FloatArray:
    point = path.pose(s)
    c, sn = np.cos(psi), np.sin(psi)
    x = point.x - c[0] * reference[0] + sn[0] * reference[1]
    y = point.y - sn[0] * reference[0] - c[0] * reference[1]
    ahead = np.array(chain.hitches)
    x_of = x + np.concatenate([[0.0], np.cumsum(ahead * c[:-1])])
    y_of = y + np.concatenate([[0.0], np.cumsum(ahead * sn[:-1])])
    return np.column_stack([x_of, y_of, psi])


_FOOT: Final = 0.3048  # [m]
_HALF_WIDTH: Final = 4.25 * _FOOT  # of every design vehicle's trailer, 8.5 ft [m]
_SPEED: Final = 0.5  # [m/s]; slip moves the trailer's path outwards by 4 mm, and by four times that at 1 m/s
_ENTRY, _EXIT = 4.0, 20.0  # [m]; the trailer is closest when the tractor has left the turn by up to a trailer length


class _Design(NamedTuple):
    name: str
    vehicle: Vehicle
    radius: float  # of the front axle's centre: centreline turning radius [ft]
    inside: float  # published [ft]
    tolerance: float  # [ft]
    source: str


def design_vehicles(quick: bool) -> CheckSection:
    """Turns of 180 degrees on the template's centreline radius, with the whole dynamic model at walking pace."""
    turns = [(design, *_turned(design)) for design in _designs()[: 2 if quick else 3]]
    checks = tuple(
        Check(
            f"{design.name}: minimum inside radius, 180° turn on {design.radius:g} ft",
            float(_radii(design, centre, poses).min()) / _FOOT,
            "ft",
            target=design.inside,
            tolerance=design.tolerance,
            source=design.source,
        )
        for design, centre, poses in turns
    )
    return CheckSection(
        title="Design vehicles",
        text="The dynamic model drives each vehicle's template turn at walking pace, the centre of its front axle on "
        "the centreline radius. Result: smallest distance of the inner end of the trailer's axle from the centre.",
        checks=checks,
        plots=tuple(_plan(design, centre, poses) for design, centre, poses in turns[:1]),
    )


def _designs() -> list[_Design]:
    wb62, table = load_vehicle("wb62"), "AASHTO Green Book table, as printed by sddc.army.mil"
    wb40 = simple_drives.tractor_and_trailer(wb62, wheelbase=12.5 * _FOOT, hitch_x=0.0, length=25.5 * _FOOT)
    return [
        _Design("WB-62", wb62, 41.0, 7.4, 0.1, table),
        _Design("WB-67", load_vehicle("wb67"), 41.0, 1.9, 0.1, "AASHTO Green Book 2011, from memory"),
        _Design("WB-40", wb40, 36.4, 19.3, 0.4, f"{table}, with lengths from memory"),
    ]


def _turned(design: _Design) -> tuple[Pose2, FloatArray]:
    """Centre of the turn, and the poses of both units during it."""
    path, front = _template(design)
    truths = simple_drives.along_path(design.vehicle, path, (front, 0.0), _SPEED)
    return path.start @ Pose2(_ENTRY, design.radius * _FOOT, 0.0), simple_drives.poses_of(truths)


def _template(design: _Design) -> tuple[Path, float]:
    """Path of the front axle's centre, and its position in T [m]."""
    radius, front = design.radius * _FOOT, design.vehicle.units[0].steered_axles[0].x
    return Path(Pose2(front, 0.0, 0.0), (line(_ENTRY), arc(math.pi * radius, 1.0 / radius), line(_EXIT))), front


def _inner_end(design: _Design, poses: FloatArray) -> FloatArray:
    """Path of the inner end of the trailer's axle, (n, 2)."""
    axle = design.vehicle.units[1].axles[0].x
    return placed(np.array([[axle, _HALF_WIDTH]]), poses[:, 1])[:, 0]


def _radii(design: _Design, centre: Pose2, poses: FloatArray) -> FloatArray:
    """Distance of this end from the centre of the turn, (n,) [m]."""
    path = _inner_end(design, poses)
    return np.hypot(path[:, 0] - centre.x, path[:, 1] - centre.y)


def _bodies(design: _Design, poses: FloatArray) -> list[FloatArray]:
    """Closed outlines (5, 2) of the units at poses (N, 3)."""
    bodies = zip(outlines(design.vehicle), poses, strict=True)
    return [placed(body.corners[[0, 1, 2, 3, 0]], pose[None])[0] for body, pose in bodies]


def _plan(design: _Design, centre: Pose2, poses: FloatArray) -> Plot:
    path, front = _template(design)
    rolled = poses_along(rolling_chain(design.vehicle), path, (front, 0.0))
    around = np.linspace(0.0, 2.0 * math.pi, 100)
    published = design.inside * _FOOT * np.column_stack([np.cos(around), np.sin(around)]) + centre[:2]
    closest = int(np.argmin(_radii(design, centre, poses)))
    front_axle = placed(np.array([[front, 0.0]]), poses[:, 0])[:, 0]
    return Plot(
        title=f"{design.name}: 180° turn from above, and the combination where its axle is closest",
        x_label="x [m]",
        y_label="y [m]",
        series=(
            *(Series("", *_xy(body), "faint") for body in _bodies(design, poses[closest])),
            Series("centre of the front axle", *_xy(front_axle), "faint"),
            Series("inner end of the trailer's axle", *_xy(_inner_end(design, poses)), "model"),
            Series("the same without slip", *_xy(_inner_end(design, rolled)[::20]), "reference points"),
            Series("published inside radius", *_xy(published), "reference"),
        ),
        to_scale=True,
    )


def _xy(points: FloatArray) -> tuple[FloatArray, FloatArray]:
    return points[:, 0], points[:, 1]
