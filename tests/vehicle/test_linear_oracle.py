"""Published and independently computed figures of two linear single-track models, from the chain's own symbols.

The audited 40 t set is rl_path_planning's (truck_params audit, 24 m/s), the other the record TractorSemitrailer6x2 of
OpenPBS with its yaw inertias put right. Both have tyres in proportion to load and no drag.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import control
import numpy as np
import pytest

from vehicle.combination.description import GRAVITY, Vehicle, load_vehicle
from vehicle.combination.handling import (
    peak_rearward_amplification,
    rearward_amplification,
    understeer_gradient,
    yaw_damping,
)
from vehicle.combination.linear import lateral_model
from vehicle.combination.loads import static_axle_loads
from vehicle.combination.unit import Axle
from vehicle.tyres.laws import LinearTyre

SPEED = 24.0  # [m/s] of the audit
LANE_CHANGE_SPEED = 88.0 / 3.6  # [m/s] ISO 14791
STIFFNESS = (280_693.53, 581_536.8, 970_209.0)  # of the axles [N/rad]


@pytest.fixture(scope="module")
def audited() -> Vehicle:
    """The 40 t combination, its tridem as one axle, with the audit's axle stiffnesses."""
    shipped = load_vehicle("eu_tractor_semitrailer")
    tractor, trailer = shipped.units
    trailer = trailer.model_copy(update={"axles": (trailer.axles[1],)})
    bare = shipped.model_copy(update={"units": (tractor, trailer)})
    stiffness = iter(STIFFNESS)
    units = []
    for unit, loads in zip(bare.units, static_axle_loads(bare), strict=True):
        axles = tuple(
            axle.model_copy(update={"tyre": linear_tyre(next(stiffness) / load, load)})
            for axle, load in zip(unit.axles, loads, strict=True)
        )
        units.append(unit.model_copy(update={"axles": axles}))
    return bare.model_copy(update={"units": tuple(units)})


@pytest.fixture(scope="module")
def openpbs() -> Vehicle:
    """The shipped record without rolling resistance, each group of axles as one in its middle."""
    shipped = load_vehicle("openpbs_tractor_semitrailer_6x2")
    tractor, trailer = shipped.units
    front, *rear = tractor.axles
    groups = ((front,), rear), (trailer.axles,)
    units = [
        unit.model_copy(update={"axles": tuple(in_the_middle(group) for group in of_unit)})
        for unit, of_unit in zip(shipped.units, groups, strict=True)
    ]
    return shipped.model_copy(update={"units": tuple(units)})


def in_the_middle(group: Sequence[Axle]) -> Axle:
    """One axle, free of drag, in the place of a group."""
    tyre = group[0].tyre.model_copy(update={"rolling_resistance": 0.0})
    middle = sum(axle.x for axle in group) / len(group)
    return group[0].model_copy(update={"x": middle, "tyre": tyre, "bogie": None})


def linear_tyre(stiffness: float, axle_load: float) -> LinearTyre:
    return LinearTyre(
        model="linear",
        cornering_stiffness=stiffness,
        longitudinal_stiffness=15.0,
        nominal_load=axle_load / 2,
        load_sensitivity=0.0,
        relaxation_length=0.5,
        damping=0.0,
        rolling_resistance=0.0,
        pneumatic_trail=0.0,
    )


def test_static_loads_of_the_audited_set(audited: Vehicle) -> None:
    """Steer 7.10 t, drive 11.40 t, tridem 21.50 t: re-derived from the masses and lengths."""
    loads = np.concatenate(static_axle_loads(audited)) / GRAVITY
    np.testing.assert_allclose(loads, [7100.0, 11400.0, 21500.0], atol=0.5)  # [kg]; lengths are given to 0.1 mm


def test_eigenvalues_of_the_audited_set(audited: Vehicle) -> None:
    """-2.46082646 +- 2.01398867j and -0.82568020 +- 2.21590363j 1/s."""
    published = np.array([-2.46082646 + 2.01398867j, -0.82568020 + 2.21590363j])
    got = lateral_model(audited, SPEED).eigenvalues()
    # Printed to 1e-8; the trailer's inertia, printed as 450 666.67, is known to 7e-9 of itself.
    np.testing.assert_allclose(got[[1, 3]], published, rtol=1e-8)
    np.testing.assert_allclose(got[[0, 2]], published.conj(), rtol=1e-8)


def test_damping_and_frequency_of_the_trailer_mode(audited: Vehicle) -> None:
    """zeta 0.349164 and omega_n 2.364736 rad/s."""
    assert yaw_damping(audited, SPEED) == pytest.approx(0.349164, abs=5e-7)  # as printed
    assert np.abs(lateral_model(audited, SPEED).eigenvalues()[3]) == pytest.approx(2.364736, abs=5e-7)  # as printed


def test_steady_gains_of_the_audited_set(audited: Vehicle) -> None:
    """Yaw rate over steer 3.390708813 1/s, articulation over steer 44.13828 deg/rad, understeer 3.1989 deg/g."""
    model = lateral_model(audited, SPEED)
    assert model.steady_gain("yaw_rate_0") == pytest.approx(3.390708813, rel=3e-8)  # the hitch is given to 1e-7 m
    assert math.degrees(model.steady_gain("articulation_1")) == pytest.approx(44.13828, abs=5e-6)  # as printed
    in_degrees = math.degrees(understeer_gradient(audited, SPEED)) * GRAVITY
    assert in_degrees == pytest.approx(3.1989, abs=5e-5)  # as printed


def test_rearward_amplification_of_the_audited_set(audited: Vehicle) -> None:
    """Lateral acceleration, centre of gravity over centre of gravity; peak 1.257008 at 0.2975 Hz."""
    frequencies = [0.1, 0.2, 0.3, 0.4, 0.5, 0.8, 1.0]  # [Hz]
    printed = [1.0381, 1.1522, 1.2569, 1.0052, 0.5772, 0.3562, 0.2657]
    np.testing.assert_allclose(rearward_amplification(audited, SPEED, frequencies), printed, atol=5e-5)  # as printed
    peak = peak_rearward_amplification(audited, SPEED)
    assert peak.gain == pytest.approx(1.257008, rel=1e-6)  # as printed
    assert peak.frequency == pytest.approx(0.2975, abs=5e-5)  # as printed


def test_a_steered_trailer_axle_turns_the_trailer_alone(audited: Vehicle) -> None:
    """Its steady steer angle leaves the tractor straight: articulation equals the angle, yaw rate stays zero."""
    tractor, trailer = audited.units
    axle = trailer.axles[0].model_copy(update={"steered": True})
    trailer = trailer.model_copy(update={"axles": (axle,), "steering": tractor.steering})
    model = lateral_model(audited.model_copy(update={"units": (tractor, trailer)}), SPEED)
    assert model.steady_gain("articulation_1", "trailer_steer_0") == pytest.approx(1.0, abs=1e-9)  # rounding
    assert model.steady_gain("yaw_rate_0", "trailer_steer_0") == pytest.approx(0.0, abs=1e-9)  # rounding


def lane_change(vehicle: Vehicle, rearmost_axle: int) -> dict[str, float]:
    """Figures of ISO 14791's single lane change: one sine, 0.4 Hz, 0.15 g, prescribed at the front axle.

    The front axle's acceleration is C A A x + C A B delta, C its place beside the path: solved for the steer angle
    delta, that is the input. Overshoot is of the axle numbered, beyond where the front axle ends.
    """
    frequency, amplitude = 0.4, 0.15 * GRAVITY
    model = lateral_model(
        vehicle, LANE_CHANGE_SPEED, path=True, outputs=("axle_position", "lateral_acceleration", "yaw_rate")
    )
    front = model.C[0] @ model.A
    feedback, gain = front @ model.A, (front @ model.B)[0]
    A, B = model.A - model.B @ feedback[None] / gain, model.B / gain
    C, D = model.C - model.D @ feedback[None] / gain, model.D / gain
    time = np.arange(0.0, 12.0, 1e-3)
    sine = np.where(time < 1.0 / frequency, amplitude * np.sin(2.0 * np.pi * frequency * time), 0.0)
    y = dict(zip(model.outputs, control.forced_response(control.ss(A, B, C, D), time, sine).outputs, strict=True))
    end = y["axle_position_0"][-1]
    return {
        "final": end,
        "overshoot": y[f"axle_position_{rearmost_axle}"].max() - end,
        "acceleration": np.abs(y["lateral_acceleration_1"]).max() / amplitude,
        "yaw_rate": np.abs(y["yaw_rate_1"]).max() / np.abs(y["yaw_rate_0"]).max(),
    }


def test_lane_change_of_the_audited_set(audited: Vehicle) -> None:
    """ISO 14791 at 88 km/h: 1.4637 m aside, the trailer's axle 0.336 m beyond; peaks of 1.122 and 1.082 times."""
    got = lane_change(audited, rearmost_axle=2)
    assert got["final"] == pytest.approx(0.15 * GRAVITY / (2.0 * math.pi * 0.4**2), abs=1e-4)  # input held over 1 ms
    assert got["overshoot"] == pytest.approx(0.336, abs=5e-4)  # as printed
    assert got["acceleration"] == pytest.approx(1.122, abs=5e-4)  # as printed
    assert got["yaw_rate"] == pytest.approx(1.082, abs=5e-4)  # as printed


def test_openpbs_loads(openpbs: Vehicle) -> None:
    """Steer 7.315 t, drive and tag axle 16.994 t, tridem 18.633 t."""
    tractor, trailer = (np.array(loads) / GRAVITY for loads in static_axle_loads(openpbs))
    assert tractor[0] == pytest.approx(7315.0, abs=0.5)  # as printed
    assert tractor[1:].sum() == pytest.approx(16994.0, abs=0.5)
    assert trailer.sum() == pytest.approx(18633.0, abs=0.5)


def test_openpbs_stability(openpbs: Vehicle) -> None:
    """Neutral steer, as all its tyres are alike over load; at 88 km/h damping 0.335, amplification 1.192 at 0.30 Hz."""
    assert understeer_gradient(openpbs, LANE_CHANGE_SPEED) == pytest.approx(0.0, abs=1e-12)  # rounding
    assert yaw_damping(openpbs, LANE_CHANGE_SPEED) == pytest.approx(0.335, abs=5e-4)  # as printed
    peak = peak_rearward_amplification(openpbs, LANE_CHANGE_SPEED)
    assert peak.gain == pytest.approx(1.192, abs=5e-4)  # as printed
    assert peak.frequency == pytest.approx(0.30, abs=5e-3)  # as printed
    assert lane_change(openpbs, rearmost_axle=2)["overshoot"] == pytest.approx(0.302, abs=5e-4)  # as printed


def test_axles_in_a_group_damp_more_than_one_in_their_middle(openpbs: Vehicle) -> None:
    """Apart by d they resist yaw with C d^2 / V each: so the record as it is shipped is damped better."""
    spread = load_vehicle("openpbs_tractor_semitrailer_6x2")
    assert yaw_damping(spread, LANE_CHANGE_SPEED) > yaw_damping(openpbs, LANE_CHANGE_SPEED) + 0.01  # 0.355 to 0.335
