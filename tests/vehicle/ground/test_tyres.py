"""Tyres: each law's closed form is what the bristle settles to, and friction times load is the bound."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from vehicle.combination.description import Vehicle
from vehicle.tyres import Contact, Grip, Planar, Tyre, carcass, contact, laws, rolling_speed
from vehicle.tyres.laws import BrushTyre, LinearTyre, MagicFormulaTyre, TmeasyCurve, TmeasyTyre
from vehicle.tyres.property_file import tyre_of_file
from vehicle.tyres.tyre import slip_speed

FILES = Path(__file__).parent / "tyre_files"
loads = st.floats(2e3, 9e4)
frictions = st.floats(0.05, 1.2)
speeds = st.floats(-25.0, 25.0)

NOMINAL = 35e3  # [N]
CARCASS: Any = {
    "nominal_load": NOMINAL,
    "relaxation_length": 0.5,
    "damping": 0.04,
    "rolling_resistance": 0.006,
    "pneumatic_trail": 0.05,
}
DAMPED = 0.04  # of a carcass [s]
STIFFNESS: Any = {"cornering_stiffness": 5.948, "longitudinal_stiffness": 17.7, "load_sensitivity": 0.074}
# Project Chrono, TMeasy GuessTruck80Par, at nominal load and at twice of it.
TRUCK_TMEASY = TmeasyTyre(
    model="tmeasy",
    **CARCASS,
    reference_friction=0.8,
    lateral=TmeasyCurve(
        initial_slope=(5.948, 5.506),
        peak_slip=(0.38786, 0.38786),
        peak_force=(0.77253, 0.73048),
        sliding_slip=(0.82534, 0.91309),
        sliding_force=(0.71139, 0.66823),
    ),
    longitudinal=TmeasyCurve(
        initial_slope=(17.687, 13.805),
        peak_slip=(0.12, 0.15),
        peak_force=(0.88468, 0.7479),
        sliding_slip=(0.9, 0.95),
        sliding_force=(0.54397, 0.50365),
    ),
)
TYRES: dict[str, Tyre] = {
    "linear": LinearTyre(model="linear", **CARCASS, **STIFFNESS),
    "brush": BrushTyre(model="brush", **CARCASS, **STIFFNESS),
    "magic_formula": MagicFormulaTyre(model="magic_formula", **CARCASS, **STIFFNESS, shape=1.26, curvature=0.4),
    "tmeasy": TRUCK_TMEASY,
    "tyre_file": tyre_of_file({"model": "magic_formula", "file": "truck_61.tir"}, str(FILES / "a.toml"), "tyres.a"),
}


@pytest.fixture(scope="module", params=list(TYRES))
def tyre(request: pytest.FixtureRequest) -> Tyre:
    return TYRES[request.param]


@pytest.fixture(scope="module", params=[name for name in TYRES if name != "tyre_file"])
def truck_tyre(request: pytest.FixtureRequest) -> Tyre:
    """The laws of which the same stiffness, peak and trail were asked; a file has its own."""
    return TYRES[request.param]


def settled(rate: Planar, grip: Grip) -> Planar:
    """Deflection that no longer changes."""
    return Planar(rate.x / grip.decays.x, rate.y / grip.decays.y)


def sliding(tyre: Tyre, F_z: float, friction: float, gain: float, drift: float, v_x: float) -> tuple[Planar, Grip]:
    """Sliding rate and grip of a tyre that gains on the ground and drifts left [m/s] while rolling at v_x [m/s]."""
    rate = tyre.sliding_rate(gain, drift)
    return rate, tyre.grip(F_z, friction, rate, abs(v_x))


def standing(tyre: Tyre, F_z: float, friction: float, slip: float) -> Contact:
    """The contact of a tyre long under a lateral slip."""
    rate_in, grip = sliding(tyre, F_z, friction, 0.0, -slip, 1.0)
    n = settled(rate_in, grip)
    return contact(n, F_z, grip)


def test_every_law_of_the_catalogue_is_tested_here() -> None:
    assert {name: type(tyre) for name, tyre in TYRES.items()} == {**laws.TYRES, "tyre_file": laws.tyre_law("tyre_file")}


# --- the bristle, whatever the law ---


@given(F_z=loads, friction=frictions, v_x=speeds, gain=speeds, drift=speeds)
def test_a_deflection_at_rest_gives_the_steady_force(
    tyre: Tyre, F_z: float, friction: float, v_x: float, gain: float, drift: float
) -> None:
    """When the rate vanishes the force is that of the law, at any speed, within the bound of all contacts."""
    rate_in, grip = sliding(tyre, F_z, friction, gain, drift, v_x)
    n = settled(rate_in, grip)
    scale = 1e-12 * (1.0 + abs(float(rate_in.x)) + abs(float(rate_in.y)))  # rounding of a difference of two rates
    assert carcass(n, rate_in, grip, DAMPED, v_x).rate == pytest.approx((0.0, 0.0), abs=scale)
    pull = grip.factor_by_limit * math.hypot(rate_in.x, grip.skew * rate_in.y)
    assume(abs(v_x) > 0.05 or pull > 0.01)  # of a tyre that neither rolls nor slides no slip is defined
    over = slip_speed(abs(v_x), pull, tyre.relaxation_length)
    slip = Planar(gain / over, -drift / over)
    law = tyre.steady_force(slip, F_z, friction)
    # combined forces of a fit may exceed both peaks: at its least load this file's by a quarter, a contact by a fifth
    share = 1.0 / max(1.0, math.hypot(*law) * grip.factor_by_limit / (F_z * grip.factor))
    expected = (share * law.x, share * law.y)
    got = contact(n, F_z, grip).force
    assert tuple(got) == pytest.approx(expected, rel=1e-5, abs=1e-6 * F_z)  # the floor of 1e-6 1/s under the push
    assert share > 0.999 or tyre.model == "tyre_file"


def test_the_friction_circle_is_never_exceeded_in_random_states(tyre: Tyre) -> None:
    """In 20 000 random states of the carcass the force is at most friction times load."""
    rng = np.random.default_rng(1)
    # TMeasy's tables have their own peak, along and at no load 2 * 0.88468 - 0.7479 on the ground of reference, 0.8.
    most = 1.0214 / 0.8 if tyre.model == "tmeasy" else 1.0
    for _ in range(20_000):
        F_z, friction, v_x = rng.uniform(2e3, 9e4), rng.uniform(0.05, 1.2), rng.uniform(-25, 25)
        _, grip = sliding(tyre, F_z, friction, rng.uniform(-25, 25), rng.uniform(-25, 25), v_x)
        on = contact(Planar(*rng.uniform(-50, 50, 2)), F_z, grip)
        margin = 1.2 if tyre.model == "tyre_file" else 1.0  # fitted combined forces exceed both peaks by some percent
        assert math.hypot(*on.force) <= margin * grip.limit * F_z * (1.0 + 1e-12)
        assert 0.0 <= on.use_along <= 1.0 + 1e-12
        assert grip.limit <= most * friction * (1.0 + 1e-12)


@given(F_z=loads, friction=frictions, v_x=speeds, gain=speeds, drift=speeds)
def test_a_deflection_beyond_the_friction_shrinks(
    tyre: Tyre, F_z: float, friction: float, v_x: float, gain: float, drift: float
) -> None:
    """The bristle cannot wind up: in each direction it shrinks outside of the largest force, whatever the sliding."""
    rate_in, grip = sliding(tyre, F_z, friction, gain, drift, v_x)
    for sign in (-1.0, 1.0):
        u = 1.02 * sign * grip.limit / grip.factor
        rate = carcass(Planar(u, u / grip.skew), rate_in, grip, DAMPED, v_x).rate
        assert sign * rate.x < 0.0
        assert sign * rate.y < 0.0


@pytest.mark.parametrize("friction", [0.1, 0.3, 0.8])
def test_friction_scales_the_peak_and_leaves_the_initial_stiffness(truck_tyre: Tyre, friction: float) -> None:
    """Slope at no slip: stiffness times load; largest side force: friction times load, for TMeasy its table's part."""
    small = truck_tyre.steady_force(Planar(0.0, 1e-4), NOMINAL, friction)
    # falling off with C s / (mu * a number of the law below 1.5): 1e-2 at most here, for 5.9e-4 / 0.1
    assert small.y == pytest.approx(truck_tyre.stiffness(NOMINAL).y * NOMINAL * 1e-4, rel=1.5e-2 * 0.8 / friction * 0.2)
    forces = [truck_tyre.steady_force(Planar(0.0, s), NOMINAL, friction).y for s in np.linspace(1e-3, 5.0, 20001)]
    peak = 0.77253 / 0.8 if truck_tyre.model == "tmeasy" else 1.0
    assert max(forces) == pytest.approx(peak * friction * NOMINAL, rel=1e-4)  # the grid hits the flat top


def test_stiffness_falls_with_load(truck_tyre: Tyre) -> None:
    """7.4 % of it from one to two nominal loads; more along in TMeasy's tables."""
    one, two = truck_tyre.stiffness(NOMINAL), truck_tyre.stiffness(2.0 * NOMINAL)
    along = 13.805 / 17.687 if truck_tyre.model == "tmeasy" else 0.926
    assert (two.x / one.x, two.y / one.y) == pytest.approx((along, 0.926), abs=4e-4)  # 5.506 / 5.948 is 0.9257


def test_the_aligning_lever_is_the_trail_at_small_slip_and_gone_in_sliding(truck_tyre: Tyre) -> None:
    """At nominal load; at twice of it half as large again, as the tangent to the root of the load says."""
    assert sliding(truck_tyre, NOMINAL, 0.8, 0.0, 1e-5, 1.0)[1].trail == pytest.approx(
        0.05, rel=1e-3
    )  # C s / mu of it gone
    assert sliding(truck_tyre, 2.0 * NOMINAL, 0.8, 0.0, 1e-5, 1.0)[1].trail == pytest.approx(0.075, rel=1e-3)
    levers = [float(sliding(truck_tyre, NOMINAL, 0.8, 0.0, s, 1.0)[1].trail) for s in np.linspace(1e-4, 0.35, 101)]
    assert (np.diff(levers) <= 1e-12).all()  # up to the peak of every one of these curves
    # what a curve has fallen off beyond its peak comes back: 8 % of the magic formula's, 8 % of TMeasy's
    assert 0.0 <= sliding(truck_tyre, NOMINAL, 0.8, 0.0, 5.0, 1.0)[1].trail <= 0.05 * 0.09


@pytest.mark.parametrize(("name", "apart"), [("brush", 1e-6), ("magic_formula", 0.15), ("tmeasy", 0.15)])
def test_the_lever_is_about_that_of_a_brush(name: str, apart: float) -> None:
    """(1 - t)^3 / (1 - t + t^2 / 3) of it is left where a share t of a brush's patch slides, t = linear force / 3."""
    tyre = TYRES[name]
    for t in (0.05, 0.2, 0.5, 0.9):
        slip = 3.0 * t * 0.8 / float(tyre.stiffness(NOMINAL).y)
        left = sliding(tyre, NOMINAL, 0.8, 0.0, slip, 1.0)[1].trail / 0.05
        brush = (1.0 - t) ** 3 / (1.0 - t + t**2 / 3.0)
        assert left == pytest.approx(brush, abs=apart)  # for the curves a stated simplification


def test_damping_across_the_wheel_is_that_of_creeping() -> None:
    """All of it at rest, nothing of it from 5 km/h on, in both directions of travel; along the wheel it stays."""

    def damping(v_x: float) -> Planar:
        """From the force that a push of 1 1/s in both directions adds to none, as nothing relaxes yet."""
        felt = carcass(Planar(0.0, 0.0), Planar(1.0, 1.0), 0.0, DAMPED, v_x).felt
        return Planar(float(felt.x), float(felt.y))

    assert damping(0.0) == (DAMPED, DAMPED)
    assert 0.02 < damping(-0.6).y < DAMPED
    for v_x in (5.0 / 3.6, -5.0 / 3.6, 30.0):
        assert damping(v_x) == (DAMPED, 0.0)


def test_a_standing_tyre_keeps_its_force(truck_tyre: Tyre) -> None:
    """At rest nothing relaxes it; slowly sliding it holds about its largest force, faster that of sliding."""
    _, still = sliding(truck_tyre, NOMINAL, 0.8, 0.0, 0.0, 0.0)
    assert still.decay < 1e-5  # [1/s]: 0.6 % in ten minutes
    assert (rolling_speed(0.0), rolling_speed(-1.0)) == (0.05, 1.0)  # so slip is finite
    for drift in (1e-5, 1e-4, 1e-3):
        rate, grip = sliding(truck_tyre, NOMINAL, 0.8, 0.0, drift, 0.0)
        held = abs(float(rate.y)) / grip.decay * grip.factor * grip.skew
        largest = (
            truck_tyre.steady_force(Planar(0.0, 3.0 * 0.8 / truck_tyre.stiffness(NOMINAL).y), NOMINAL, 0.8).y / NOMINAL
        )
        assert held == pytest.approx(largest, rel=0.04)  # the peak of TMeasy's side force is 0.965 of the limit
    rate, grip = sliding(truck_tyre, NOMINAL, 0.8, 0.0, 1.0, 0.0)
    fast = abs(float(rate.y)) / grip.decay * grip.factor * grip.skew
    assert fast == pytest.approx(truck_tyre.steady_force(Planar(0.0, 20.0), NOMINAL, 0.8).y / NOMINAL, rel=1e-6)


# --- each law's own form ---


def test_the_linear_tyre_is_linear_up_to_the_circle() -> None:
    """F = C F_z s, and friction times load beyond, in any direction."""
    tyre = TYRES["linear"]
    F = tyre.steady_force(Planar(0.01, 0.05), NOMINAL, 0.8)
    assert tuple(F) == pytest.approx((17.7 * 0.01 * NOMINAL, 5.948 * 0.05 * NOMINAL))
    assert math.hypot(*tyre.steady_force(Planar(0.3, 0.4), NOMINAL, 0.8)) == pytest.approx(0.8 * NOMINAL)
    assert sliding(tyre, NOMINAL, 0.8, 0.0, 0.99 * 0.8 / 5.948, 1.0)[1].trail == pytest.approx(0.05)  # until there


@pytest.mark.parametrize("slip", [0.01, 0.1, 0.3, 0.8])
def test_the_brush_tyre_is_the_integral_over_its_bristles(slip: float) -> None:
    """Parabolic pressure, bristles stick up to mu p and slide from there: the force summed up bristle by bristle.

    Over the patch (length 2 a, from the front) p = 3 F_z / (4 a) (1 - (x/a)^2), shear c s (a - x) with C F_z = 2 a^2 c.
    """
    tyre, friction, a = TYRES["brush"], 0.6, 1.0
    x = np.linspace(a, -a, 200001)
    c = 5.948 * NOMINAL / (2.0 * a**2)
    pressure = friction * 3.0 * NOMINAL / (4.0 * a) * (1.0 - (x / a) ** 2)
    F = -np.trapezoid(np.minimum(c * slip * (a - x), pressure), x)
    assert tyre.steady_force(Planar(0.0, slip), NOMINAL, friction).y == pytest.approx(F, rel=1e-6)
    assert standing(tyre, NOMINAL, friction, slip).force.y == pytest.approx(F, rel=1e-6)


@pytest.mark.parametrize("slip", [0.003, 0.03, 0.3, 3.0])
def test_the_magic_formula_is_the_magic_formula(slip: float) -> None:
    """D sin(C atan(B s - E (B s - atan(B s)))) with D the friction and B C D the stiffness, all over the load."""
    B = 5.948 / (1.26 * 0.5)
    expected = 0.5 * math.sin(1.26 * math.atan(B * slip - 0.4 * (B * slip - math.atan(B * slip))))
    got = TYRES["magic_formula"].steady_force(Planar(0.0, slip), NOMINAL, 0.5).y / NOMINAL
    assert got == pytest.approx(expected, rel=1e-6)  # the floor of the linear force, 1e-6


# Side force over load at nominal load, computed apart from this program from the published curve.
TABLE = {
    0.80: (0.0508, 0.0992, 0.1894, 0.3436, 0.4663, 0.6337, 0.7383, 0.7715),
    0.55: (0.0502, 0.0971, 0.1812, 0.3133, 0.4049, 0.5019, 0.5311, 0.5208),
    0.30: (0.0488, 0.0917, 0.1605, 0.2439, 0.2797, 0.2876, 0.2704, 0.2668),
    0.20: (0.0473, 0.0858, 0.1399, 0.1864, 0.1929, 0.1807, 0.1778, 0.1778),
}
ANGLES = (0.5, 1.0, 2.0, 4.0, 6.0, 10.0, 15.0, 20.0)  # [deg]


@pytest.mark.parametrize("friction", list(TABLE))
def test_tmeasy_gives_the_published_truck_tyre_on_every_ground(friction: float) -> None:
    """Friction stretches force and slip of peak and sliding; the initial slope stays."""
    got = [
        float(TRUCK_TMEASY.steady_force(Planar(0.0, math.tan(math.radians(angle))), NOMINAL, friction).y) / NOMINAL
        for angle in ANGLES
    ]
    np.testing.assert_allclose(got, TABLE[friction], atol=0.6e-4)  # the table's last digit


@pytest.mark.parametrize("k", [0, 1])
@pytest.mark.parametrize(("curve", "axis"), [(TRUCK_TMEASY.longitudinal, 0), (TRUCK_TMEASY.lateral, 1)])
def test_tmeasy_goes_through_its_points_along_and_across_and_at_both_loads(
    curve: TmeasyCurve, axis: int, k: int
) -> None:
    """Peak at its slip and sliding force from its slip on, as the tables say."""
    F_z, sliding_slip, sliding_force = (1 + k) * NOMINAL, curve.sliding_slip[k], curve.sliding_force[k]
    points = {curve.peak_slip[k]: curve.peak_force[k], sliding_slip: sliding_force, 1.3 * sliding_slip: sliding_force}
    for slip, expected in points.items():
        force = TRUCK_TMEASY.steady_force(Planar(*(slip * np.eye(2)[axis]).tolist()), F_z, 0.8)
        assert force[axis] / F_z == pytest.approx(expected, rel=1e-6)  # rounding of the direction


def test_the_magic_formula_of_the_shipped_trucks_is_like_tmeasy(tractor_semitrailer: Vehicle) -> None:
    """Its shape was fitted to TMeasy's truck tyre within 0.03 of the load; stiffness and peak are put in."""
    for tyre in (axle.tyre for unit in tractor_semitrailer.units for axle in unit.axles):
        like = tyre.model_copy(update={"cornering_stiffness": 5.948})
        for angle, expected in zip(ANGLES, TABLE[0.80], strict=True):
            s = Planar(0.0, math.tan(math.radians(angle)))
            got = like.steady_force(s, tyre.nominal_load, 0.77253).y / tyre.nominal_load
            assert got == pytest.approx(expected, abs=0.03)
