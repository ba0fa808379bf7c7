"""Published figures of two linear single-track models besides those of ``offtrack validate``.

The audited 40 t set is rl_path_planning's (truck_params audit), the other the record TractorSemitrailer6x2 of OpenPBS
with its yaw inertias put right. Both have tyres in proportion to load and no drag.
"""

from __future__ import annotations

import math

import control
import numpy as np
import pytest

from offtrack.studies.validation.linear_checks import audited_vehicle
from offtrack.studies.validation.simple_drives import on_single_axles
from tests.vehicle.chains import with_axles
from vehicle.combination.data_sheet import coupling_loads
from vehicle.combination.description import GRAVITY, Vehicle, load_vehicle
from vehicle.combination.handling import peak_rearward_amplification, understeer_gradient, yaw_damping
from vehicle.combination.linear import lateral_model
from vehicle.combination.loads import static_axle_loads

LANE_CHANGE_SPEED = 88.0 / 3.6  # [m/s] ISO 14791


@pytest.fixture(scope="module")
def openpbs() -> Vehicle:
    """The shipped record without rolling resistance, each group of axles as one in its middle."""
    single = on_single_axles(load_vehicle("openpbs_tractor_semitrailer_6x2"))
    return with_axles(single, tyre={"rolling_resistance": 0.0})


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


def test_lane_change_of_the_audited_set() -> None:
    """ISO 14791 at 88 km/h: 1.4637 m aside, the trailer's axle 0.336 m beyond; peaks of 1.122 and 1.082 times."""
    got = lane_change(audited_vehicle(), rearmost_axle=2)
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
    kingpin = coupling_loads(openpbs)[1]
    assert kingpin is not None
    assert kingpin / GRAVITY == pytest.approx(14468.0, abs=0.5)


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
