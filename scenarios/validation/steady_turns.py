"""Checks of steady turns against closed forms of rolling without slip."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from scenarios.results.metrics import true_off_tracking
from scenarios.validation import closed_forms
from scenarios.validation.check import Check, Plot, Section, Series
from scenarios.validation.driving import CREEP, poses_of, round_circle
from scenarios.validation.vehicles import gripping, tractor_and_trailer, with_steered_trailer
from vehicle.combination.description import Vehicle, load_vehicle
from vehicle.combination.truth import Truth
from vehicle.frames import FloatArray

_MILLIMETRE: Final = 1e-3
_WHEELBASE, _KINGPIN, _LENGTH = 3.8, 0.7744762, 7.7  # of the audited European combination [m]
_WHI: Final = {12.5: 3.3830, 15.0: 2.6765, 20.0: 1.9205, 30.0: 1.2447, 50.0: 0.7367, 100.0: 0.3663}  # R: OT [m]


def steady_turns(quick: bool) -> Section:
    """Trailers that have settled on circles."""
    whi = {radius: _WHI[radius] for radius in ([12.5, 20.0] if quick else _WHI)}
    simulated = {radius: _front_axle_off_tracking(radius) for radius in whi}
    return Section(
        title="Steady turns",
        text="The tractor drives on circles until the trailer has settled: off-tracking of the axle and of the follow "
        "point, the longest trailer in the EU roundabout, and the steer law that keeps the follow point on the path.",
        checks=(
            *(_whi_check(radius, simulated[radius], published) for radius, published in whi.items()),
            *(_follow_check(*case) for case in ((15.0, 9.0, 14.0),) + (() if quick else ((12.5, 7.7, 12.0),))),
            _roundabout_check(),
            *_path_following_checks(),
        ),
        plots=(_whi_plot(simulated),),
    )


def _rig(*, length: float, hitch_x: float, follow: float | None = None) -> Vehicle:
    return tractor_and_trailer(load_vehicle("eu_tractor_semitrailer"), length=length, hitch_x=hitch_x, follow=follow)


def _settled(vehicle: Vehicle, hitch_radius: float, length: float) -> list[Truth]:
    """Truth on a circle of the hitch, after all transients have decayed."""
    hitch_x = vehicle.units[0].hitch_x or 0.0
    decay = length / math.sqrt(1.0 - (length / hitch_radius) ** 2)  # distance over which transients decay by 1/e [m]
    radius = math.sqrt(hitch_radius**2 - hitch_x**2)
    return round_circle(vehicle, radius, CREEP, 4.0 * decay, approach=10.0 * decay, approach_speed_factor=4.0)


def _turning_radius(velocity: FloatArray, x: float) -> float:
    """Radius [m] on which the point x [m] of a unit moves, from v_x, v_y and yaw rate of its origin."""
    v_x, v_y, yaw_rate = velocity
    return math.hypot(v_x, v_y + x * yaw_rate) / float(yaw_rate)


def _front_axle_off_tracking(radius: float) -> float:
    """Off-tracking [m] of the trailer's axle from the front axle on a circle of this radius."""
    vehicle = gripping(_rig(length=_LENGTH, hitch_x=_KINGPIN))
    hitch_radius = math.sqrt(radius**2 - _WHEELBASE**2 + _KINGPIN**2)
    now = _settled(vehicle, hitch_radius, _LENGTH)[-1]
    return _turning_radius(now.velocities[0], _WHEELBASE) - _turning_radius(now.velocities[1], -_LENGTH)


def _whi_check(radius: float, value: float, published: float) -> Check:
    return Check(
        f"off-tracking of the trailer's axle, front axle on {radius:g} m",
        value,
        "m",
        target=published,
        tolerance=_MILLIMETRE,
        source="WHI and SAE formula: R - sqrt(R² - L1² + h² - L2²)",
    )


def _whi_plot(simulated: dict[float, float]) -> Plot:
    radii = np.geomspace(12.5, 100.0, 60)
    exact = [closed_forms.front_axle_off_tracking(R, _WHEELBASE, _KINGPIN, _LENGTH) for R in radii]
    return Plot(
        title="Steady off-tracking over the radius of the front axle",
        x_label="radius [m]",
        y_label="off-tracking [m]",
        series=(
            Series("WHI and SAE formula", radii, np.array(exact), "reference"),
            Series("model", np.array(list(simulated)), np.array(list(simulated.values())), "model points"),
        ),
        logarithmic=True,
    )


def _follow_check(radius: float, axle: float, follow: float) -> Check:
    vehicle = gripping(_rig(length=axle, hitch_x=0.0, follow=follow))
    return Check(
        f"off-tracking of the follow point {follow:g} m behind a hitch on {radius:g} m, axle at {axle:g} m",
        -_off_tracking(_settled(vehicle, radius, axle), follow),
        "m",
        target=closed_forms.follow_point_off_tracking(radius, axle, follow),
        tolerance=_MILLIMETRE,
        source="sqrt(R² - (Lf - La)²) - sqrt(R² - La²), square to the trailer's axis",
    )


def _off_tracking(truths: list[Truth], follow: float) -> float:
    """Final off-tracking [m] of the follow point, + if the path is to its left."""
    x, y, psi = poses_of(truths)[:, 1].T
    return float(true_off_tracking(x, y, psi, follow)[-1])


def _roundabout_check() -> Check:
    """Length at which the inner side just touches the inner circle, interpolated between two simulated ones."""
    width, inner_circle, hitch_radius = 2.55, 5.3, 12.5 - 2.04
    lengths = np.array([8.10, 8.17])  # [m]; linear interpolation of the inner radius is accurate to 0.2 mm
    inner = [
        _turning_radius(_settled(gripping(_rig(length=L, hitch_x=0.0)), hitch_radius, L)[-1].velocities[1], -L)
        - 0.5 * width
        for L in lengths.tolist()
    ]
    return Check(
        name="longest kingpin-to-axle distance between circles of 12.50 m and 5.30 m, width 2.55 m",
        value=float(np.interp(-inner_circle, [-radius for radius in inner], lengths)),
        target=closed_forms.longest_wheelbase_on_the_roundabout(width),  # 8.135 m
        tolerance=2e-3,
        unit="m",
        source="97/27/EC, deemed-to-comply formula for semi-trailers (wording from memory)",
    )


def _path_following_checks() -> tuple[Check, ...]:
    """All trailer axles steered by the closed form: the follow point retraces the hitch's path without wheel slip."""
    hitch_radius, follow, distances = 10.46, 14.0, (8.0, 9.31, 10.62)
    vehicle = gripping(with_steered_trailer(_rig_of("uk_longer_semitrailer", length=distances[1]), distances, follow))
    angles = tuple(closed_forms.path_following_steer(hitch_radius, x, follow) for x in distances)
    truths = round_circle(
        vehicle, hitch_radius, CREEP, 1.2 * follow, approach=350.0, approach_speed_factor=2.0, trailer_steer=angles
    )
    wheels = truths[-1].wheel_slip_angles[-2 * len(distances) :]
    return (
        Check(
            f"off-tracking {follow:g} m behind a hitch on {hitch_radius:g} m, all axles by the path-following law",
            _off_tracking(truths, follow),
            "m",
            target=0.0,
            tolerance=_MILLIMETRE,
            source="tan δ(x) = -(x - Lf/2) / sqrt(R² - Lf²/4) at each axle",
        ),
        Check(
            "path-following law: largest slip angle of the trailer's wheels",
            math.degrees(float(np.abs(wheels).max())),
            "°",
            target=0.0,
            tolerance=0.01,
            source="common turning centre: no wheel slips",
        ),
    )


def _rig_of(name: str, *, length: float) -> Vehicle:
    return tractor_and_trailer(load_vehicle(name), length=length, hitch_x=0.0)
