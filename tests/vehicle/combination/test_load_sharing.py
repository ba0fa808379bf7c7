"""Load sharing of axle groups on uneven road: how much an axle on a bump carries, and how it is equalised."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tests.vehicle.chains import named, outputs, rates
from vehicle.combination.description import Vehicle
from vehicle.combination.layout import Input, input_sizes, parts
from vehicle.combination.linear import straight_running
from vehicle.combination.plant import Plant, VehicleCommand
from vehicle.combination.unit import LoadSharing
from vehicle.frames import FloatArray, Pose2
from vehicle.surface import Surface

STIFFNESS, LAG, BUMP = 1.2e6, 3.0, 0.02  # [N/m], [s], [m]


@pytest.fixture(scope="module")
def shared(tractor_semitrailer: Vehicle) -> Vehicle:
    tractor, trailer = tractor_semitrailer.units
    slow = trailer.model_copy(update={"load_sharing": LoadSharing(stiffness=STIFFNESS, lag=LAG)})
    return tractor_semitrailer.model_copy(update={"units": (tractor, slow)})


def on_a_bump(vehicle: Vehicle, shift: tuple[float, ...] = ()) -> tuple[FloatArray, FloatArray]:
    """Loads of all axles [N] with the middle axle of the tridem on a bump, and the rate of the shifts [N/s]."""
    x, u = straight_running(vehicle, 10.0, 0.8)
    s, given = named(vehicle, x)._replace(load_shift=np.array(shift)), Input(*parts(u, input_sizes(vehicle)))
    road = np.zeros(vehicle.n_wheels)
    road[6:8] = BUMP
    at = vehicle, s, given._replace(road=road)
    return outputs(*at).load.reshape(-1, 2).sum(axis=1), rates(*at).load_shift


def test_an_axle_on_a_bump_takes_load_from_its_group(shared: Vehicle, tractor_semitrailer: Vehicle) -> None:
    """It stands 2 / 3 of the bump above the group's mean, the others 1 / 3 below, each times c."""
    equal, _ = on_a_bump(tractor_semitrailer)
    loads, rate = on_a_bump(shared, (0.0, 0.0, 0.0))
    np.testing.assert_allclose(equal[2:], equal[2], rtol=1e-12)
    expected = STIFFNESS * BUMP * np.array([-1.0, 2.0, -1.0]) / 3.0
    np.testing.assert_allclose((loads - equal)[2:], expected, atol=1e-6)  # the middle of the group keeps its place
    np.testing.assert_allclose(rate, expected / LAG, atol=1e-6)
    np.testing.assert_allclose(loads[:2], equal[:2], rtol=1e-9)  # the hitch's load is the same


def test_an_equalised_group_shares_equally(shared: Vehicle, tractor_semitrailer: Vehicle) -> None:
    """Once all additional load has been given back, uneven road makes no difference, and nothing moves."""
    back = tuple(STIFFNESS * BUMP * part / 3.0 for part in (-1.0, 2.0, -1.0))
    loads, rate = on_a_bump(shared, back)
    np.testing.assert_allclose(loads, on_a_bump(tractor_semitrailer)[0], rtol=1e-9)
    np.testing.assert_allclose(rate, 0.0, atol=1e-9)


def test_a_group_out_of_balance_loads_the_hitch(shared: Vehicle, tractor_semitrailer: Vehicle) -> None:
    """Load on the foremost axle instead of the rearmost one: moments about the hitch stay in balance."""
    x = np.array([axle.x for axle in shared.units[1].axles])
    equal, loads = on_a_bump(tractor_semitrailer)[0], on_a_bump(shared, (-9e3, 0.0, 9e3))[0]
    assert loads[2] > loads[4] + 1.7e4
    assert loads[2:] @ x == pytest.approx(equal[2:] @ x, rel=1e-9)
    assert loads.sum() == pytest.approx(equal.sum(), rel=1e-9)


def test_the_shift_follows_the_road_with_its_lag(shared: Vehicle) -> None:
    """In the plant on a plane nothing is shifted; a shift that is there decays with the lag."""
    plant = Plant(shared, Surface(friction=0.8), engine="interpreted")
    state = named(shared, plant.initial_state(Pose2(0.0, 0.0, 0.0), 10.0))
    start = np.concatenate(state._replace(load_shift=np.array([6e3, -3e3, -3e3])))
    later = plant.step(start, VehicleCommand(0.0, 0.06, ()), 1500)
    shift = named(shared, later).load_shift
    np.testing.assert_allclose(shift, math.exp(-0.5) * np.array([6e3, -3e3, -3e3]), rtol=1e-6)
