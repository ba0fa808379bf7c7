"""Checks of slow turns against closed forms of rolling without slip: steady turns, tractrix, roundabout.

Radii are those of circles about the turning centre [m]. Angles are positive to the left; turns are to the left.
"""

import math
from typing import Final, NamedTuple

import numpy as np

from offtrack.studies.validation.check import Check, CheckSection, Plot, Series
from offtrack.studies.validation.no_slip_limit import poses_along, rolling_chain
from offtrack.studies.validation.simple_drives import (
    CREEP,
    along_path,
    gripping,
    poses_of,
    round_circle,
    tractor_and_trailer,
    with_steered_trailer,
)
from scenarios import courses
from scenarios.assembly.adapters import outlines
from scenarios.courses import Course
from scenarios.results.metrics import true_off_tracking
from scenarios.results.swept_path import placed, tail_swings
from vehicle.combination.description import Vehicle, load_vehicle
from vehicle.combination.truth import Truth
from vehicle.frames import FloatArray, Pose2


def tractrix_articulation(radius: float, length: float, turned: float) -> float:
    """Articulation [rad] of a trailer whose hitch enters a circle along a tangent and has ``turned`` by an angle [rad].

    gamma' = 1 - (R / L) sin(gamma) over the path's angle, from 0. The half-angle tangent gives a Riccati equation with
    constant coefficients. Valid for trailers shorter than the radius, R > L; longer ones jackknife.
    """
    k = radius / length
    b = math.sqrt(k * k - 1.0)
    t = math.tanh(0.5 * b * turned)
    return 2.0 * math.atan(t / (b + k * t))


def follow_point_off_tracking(radius: float, axle: float, follow: float) -> float:
    """Off-tracking [m] of a point ``follow`` behind the hitch, axle at ``axle``, hitch on a steady circle.

    Measured square to the trailer's axis, as by de Saxe, from the follow point to the hitch's circle.
    """
    return math.sqrt(radius**2 - (follow - axle) ** 2) - math.sqrt(radius**2 - axle**2)


def front_axle_off_tracking(radius: float, wheelbase: float, hitch: float, length: float) -> float:
    """Off-tracking [m] of the trailer's axle from the front axle's circle, after WHI and SAE J695.

    ``hitch`` is the kingpin's distance ahead of the tractor's rear axle.
    """
    return radius - math.sqrt(radius**2 - wheelbase**2 + hitch**2 - length**2)


def path_following_steer(radius: float, axle: float, follow: float) -> float:
    """Steer angle [rad] of an axle ``axle`` behind the hitch that keeps the follow point on the hitch's circle.

    Its tangent is (Lf / 2) / sqrt(R^2 - Lf^2 / 4) at the hitch, the opposite at the follow point, linear in between.
    """
    return math.atan(-(axle - 0.5 * follow) / math.sqrt(radius**2 - 0.25 * follow**2))


def longest_wheelbase_on_the_roundabout(width: float) -> float:
    """Longest distance from kingpin to axle [m] of a semi-trailer deemed to comply with the roundabout of 97/27/EC.

    The circles are of 12.5 m and 5.3 m; the kingpin lies 2.04 m behind the outer one.
    """
    return math.sqrt((12.5 - 2.04) ** 2 - (5.3 + 0.5 * width) ** 2)


_MILLIMETRE: Final = 1e-3
_WHEELBASE, _KINGPIN, _LENGTH = 3.8, 0.7744762, 7.7  # of the audited European combination [m]
_WHI: Final = {12.5: 3.3830, 15.0: 2.6765, 20.0: 1.9205, 30.0: 1.2447, 50.0: 0.7367, 100.0: 0.3663}  # R: OT [m]


def steady_turns(quick: bool) -> CheckSection:
    """Trailers that have settled on circles."""
    whi = {radius: _WHI[radius] for radius in ([12.5, 20.0] if quick else _WHI)}
    simulated = {radius: _front_axle_off_tracking(radius) for radius in whi}
    return CheckSection(
        title="Steady turns",
        text="The tractor drives on circles until the trailer has settled: off-tracking of the axle and of the follow "
        "point, the longest trailer in the EU roundabout, and the steer law that keeps the follow point on the path.",
        checks=(
            *(
                Check(
                    f"off-tracking of the trailer's axle, front axle on {radius:g} m",
                    simulated[radius],
                    "m",
                    target=published,
                    tolerance=_MILLIMETRE,
                    source="WHI and SAE formula: R - sqrt(R² - L1² + h² - L2²)",
                )
                for radius, published in whi.items()
            ),
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


def _whi_plot(simulated: dict[float, float]) -> Plot:
    radii = np.geomspace(12.5, 100.0, 60)
    exact = [front_axle_off_tracking(R, _WHEELBASE, _KINGPIN, _LENGTH) for R in radii]
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
        target=follow_point_off_tracking(radius, axle, follow),
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
        target=longest_wheelbase_on_the_roundabout(width),  # 8.135 m
        tolerance=2e-3,
        unit="m",
        source="97/27/EC, deemed-to-comply formula for semi-trailers (wording from memory)",
    )


def _path_following_checks() -> tuple[Check, ...]:
    """All trailer axles steered by the closed form: the follow point retraces the hitch's path without wheel slip."""
    hitch_radius, follow, distances = 10.46, 14.0, (8.0, 9.31, 10.62)
    rig = tractor_and_trailer(load_vehicle("uk_longer_semitrailer"), length=distances[1], hitch_x=0.0)
    vehicle = gripping(with_steered_trailer(rig, distances, follow))
    angles = tuple(path_following_steer(hitch_radius, x, follow) for x in distances)
    truths = round_circle(
        vehicle, hitch_radius, CREEP, 1.2 * follow, approach=350.0, approach_speed_factor=2.0, trailer_steer=angles
    )
    wheels = truths[-1].wheel_slip_angles[-2 * len(distances) :]
    return (
        Check(
            f"off-tracking {follow:g} m behind a hitch on {hitch_radius:g} m, all axles by the path-following law",
            _off_tracking(truths, follow),
            "m",
            tolerance=_MILLIMETRE,
            source="tan δ(x) = -(x - Lf/2) / sqrt(R² - Lf²/4) at each axle",
        ),
        Check(
            "path-following law: largest slip angle of the trailer's wheels",
            math.degrees(float(np.abs(wheels).max())),
            "°",
            tolerance=0.01,
            source="common turning centre: no wheel slips",
        ),
    )


_TRACTRIX_CASES: Final = (  # radius, hitch to axle [m], articulation after 90 and after 180 degrees [deg]
    (12.5, 8.0, 34.785, 39.055),
    (10.0, 8.0, 41.105, 49.744),
    (12.5, 12.0, 46.330, 60.283),
)


def tractrix(quick: bool) -> CheckSection:
    """Trailers whose hitch enters a circle along a tangent."""
    cases = _TRACTRIX_CASES[:1] if quick else _TRACTRIX_CASES
    checks: list[Check] = []
    series: list[Series] = []
    for case in cases:
        radius, length, at_90, at_180 = case
        turned, articulation = _driven(radius, length)
        exact = np.array([tractrix_articulation(radius, length, phi) for phi in turned])
        checks += [
            _angle(f"R = {radius:g} m, L = {length:g} m: articulation after 90°", turned, articulation, 90.0, at_90),
            _angle(f"R = {radius:g} m, L = {length:g} m: articulation after 180°", turned, articulation, 180.0, at_180),
            Check(
                f"R = {radius:g} m, L = {length:g} m: largest distance from the closed form",
                math.degrees(float(np.abs(articulation - exact).max())),
                "°",
                tolerance=1e-3,
                source="tractrix onto a circle, closed form with the half-angle tangent",
            ),
        ]
        series += [
            Series(f"R = {radius:g} m, L = {length:g} m", np.degrees(turned), np.degrees(articulation), "model"),
            Series("closed form" if case is cases[-1] else "", np.degrees(turned), np.degrees(exact), "reference"),
        ]
    return CheckSection(
        title="Tractrix",
        text="The hitch of a tractor on stiff tyres enters a circle along a tangent. The trailer's articulation is "
        "compared with the closed form for an axle that does not slide sideways.",
        checks=tuple(checks),
        plots=(
            Plot(
                title="Articulation over the turn of the hitch",
                x_label="turn of the hitch's path [°]",
                y_label="articulation [°]",
                series=tuple(series),
            ),
        ),
    )


def _angle(name: str, turned: FloatArray, articulation: FloatArray, at: float, published: float) -> Check:
    return Check(
        name=name,
        value=float(np.interp(at, np.degrees(turned), np.degrees(articulation))),
        target=published,
        tolerance=1.5e-3,  # 1e-3 for the model, plus the rounding of the target
        unit="°",
        source="calculated from the closed form, to three decimals",
    )


def _driven(radius: float, length: float) -> tuple[FloatArray, FloatArray]:
    """Turn of the hitch's path and articulation to it [rad], over half a circle."""
    vehicle = gripping(tractor_and_trailer(load_vehicle("eu_tractor_semitrailer"), length=length, hitch_x=0.0))
    truths = round_circle(vehicle, radius, CREEP, math.pi * radius + 0.1)
    hitch = np.array([now.velocities[1] for now in truths])
    articulation = np.arctan2(hitch[:, 1], hitch[:, 0])
    return poses_of(truths)[:, 1, 2] + articulation, articulation


_RADIUS, _WIDTH = 12.5, 2.55  # [m]
_SPEED: Final = 1.0  # [m/s]; on stiff tyres slip moves a 12 m trailer outwards by 1 mm
_ENTRY: Final = 3.0  # [m], for the driver to settle
_SOURCE: Final = "independent kinematic calculation of the same turn"


class _RoundaboutCase(NamedTuple):
    """A trailer and its calculated reference figures."""

    name: str
    hitch_x: float  # kingpin ahead of the drive axle [m]
    length: float  # kingpin to axle [m]
    rear: float  # kingpin to rear end [m]
    inner: float  # smallest radius of the inner end of the axle [m]
    swept: float  # outer minus inner radius [m]
    swing: float  # of the rear corner [m]
    articulation: float  # at the end of the turn [deg]


_ROUNDABOUT_CASES: Final = (
    _RoundaboutCase("7.7 m trailer, kingpin 0.6 m ahead", 0.6, 7.7, 12.0, 5.313, 7.187, 0.257, 45.93),
    _RoundaboutCase("7.7 m trailer, kingpin 0.77 m ahead", 0.7744762, 7.7, 11.9, 5.330, 7.170, 0.241, 44.88),
    _RoundaboutCase("9.3 m trailer, kingpin 0.6 m ahead", 0.6, 9.3, 14.04, 3.133, 9.367, 0.317, 60.79),
)


def roundabout(quick: bool) -> CheckSection:
    """Turns of 360 degrees, entered along the tangent, with three trailers."""
    turns = [(case, *_turned(case)) for case in (_ROUNDABOUT_CASES[-1:] if quick else _ROUNDABOUT_CASES)]
    return CheckSection(
        title="Roundabout",
        text="The driver guides the tractor's outer front corner from the tangent once around a circle of 12.5 m, on "
        "stiff tyres at walking pace. The evaluation ends with the full circle.",
        checks=tuple(check for turn in turns for check in _checks(*turn)),
        plots=(_plan(*turns[-1]),),
    )


def _turned(case: _RoundaboutCase) -> tuple[Vehicle, Course, FloatArray]:
    vehicle = gripping(
        tractor_and_trailer(
            load_vehicle("eu_tractor_semitrailer"),
            length=case.length,
            hitch_x=case.hitch_x,
            rear=case.rear,
            width=_WIDTH,
        )
    )
    course = courses.roundabout(front_x=vehicle.units[0].front_x, width=_WIDTH, radius=_RADIUS, entry=_ENTRY, exit=1e-3)
    return vehicle, course, poses_of(along_path(vehicle, course.path, course.reference, _SPEED))


def _checks(case: _RoundaboutCase, vehicle: Vehicle, course: Course, poses: FloatArray) -> tuple[Check, ...]:
    inner, outer = _radii(vehicle, course, poses)
    swing = max(tail_swings(outlines(vehicle), (poses[:, 0], poses[:, 1])))
    rows = (
        ("smallest radius of the axle's inner end", inner, case.inner, 5e-3, "m"),
        ("swept width", outer - inner, case.swept, 10e-3, "m"),
        ("tail swing", swing, case.swing, 5e-3, "m"),
        ("articulation at the end", math.degrees(poses[-1, 0, 2] - poses[-1, 1, 2]), case.articulation, 0.05, "°"),
    )
    return tuple(
        Check(f"{case.name}: {name}", value, unit, target=target, tolerance=tolerance, source=_SOURCE)
        for name, value, target, tolerance, unit in rows
    )


def _radii(vehicle: Vehicle, course: Course, poses: FloatArray) -> tuple[float, float]:
    """Smallest radius of the trailer axle's inner end, and largest of the tractor's outer front corner [m]."""
    centre = course.path.start @ Pose2(_ENTRY, _RADIUS, 0.0)
    corner, inner = (np.hypot(path[:, 0] - centre.x, path[:, 1] - centre.y) for path in _paths(vehicle, poses))
    # it approaches along x, from outside the circle
    on_circle = int(np.argmax(_paths(vehicle, poses)[0][:, 0] >= centre.x))
    return float(inner.min()), float(corner[on_circle:].max())


def _paths(vehicle: Vehicle, poses: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Paths (n, 2) of the tractor's outer front corner and the trailer axle's inner end."""
    tractor, trailer = vehicle.units
    corner = placed(np.array([[tractor.front_x, -0.5 * _WIDTH]]), poses[:, 0])[:, 0]
    return corner, placed(np.array([[trailer.axles[0].x, 0.5 * _WIDTH]]), poses[:, 1])[:, 0]


def _plan(case: _RoundaboutCase, vehicle: Vehicle, course: Course, poses: FloatArray) -> Plot:
    corner, inner = _paths(vehicle, poses)
    _, rolled = _paths(vehicle, poses_along(rolling_chain(vehicle), course.path, course.reference))
    return Plot(
        title=f"{case.name}: from above",
        x_label="x [m]",
        y_label="y [m]",
        series=(
            Series("tractor's front corner", corner[:, 0], corner[:, 1], "faint"),
            Series("inner end of the trailer's axle", inner[:, 0], inner[:, 1], "model"),
            Series("the same without slip", rolled[::20, 0], rolled[::20, 1], "reference points"),
        ),
        to_scale=True,
    )
