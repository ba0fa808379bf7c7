"""Service brakes: pressures behind their lags, limits of torque, and ABS."""

from __future__ import annotations

import numpy as np
import pytest

from offtrack.studies.validation.stopping_checks import braked, without_abs
from vehicle.combination.data_sheet import data_sheet
from vehicle.combination.description import GRAVITY, Vehicle, brake_channels
from vehicle.combination.loads import static_axle_loads
from vehicle.combination.unit import Distribution
from vehicle.surface import SplitFriction, Surface

DRY = Surface(friction=0.8)
FULL = 9.0  # demand of a full brake application [m/s2]


def changed(vehicle: Vehicle, **numbers: object) -> Vehicle:
    assert vehicle.brakes is not None
    return vehicle.model_copy(update={"brakes": vehicle.brakes.model_copy(update=numbers)})


def test_wheels_share_modulators_as_the_file_says(tractor_semitrailer: Vehicle) -> None:
    """Steer axle select-low, drive axle by wheel, the tridem by side; without ABS a channel per group of axles."""
    channels = brake_channels(tractor_semitrailer)
    found = [(c.unit, c.axles, c.side, c.valve, c.mirrored) for c in channels]
    assert found == [
        (0, (0,), 0, 0, 0),
        (0, (1,), +1, 1, 2),
        (0, (1,), -1, 2, 1),
        (1, (0, 1, 2), +1, 3, 4),
        (1, (0, 1, 2), -1, 4, 3),
    ]
    plain = brake_channels(without_abs(tractor_semitrailer))
    assert [(c.unit, c.axles, c.side, c.valve) for c in plain] == [
        (0, (0,), 0, None),
        (0, (1,), 0, None),
        (1, (0, 1, 2), 0, None),
    ]


def test_pressure_rises_behind_two_lags(tractor_semitrailer: Vehicle) -> None:
    """Two lags a and b in series: 1 - (a exp(-t/a) - b exp(-t/b)) / (a - b)."""
    demand = 1.0
    stop = braked(tractor_semitrailer, DRY, 20.0, demand, seconds=1.0)
    a, b, t = 0.08, 0.10, 0.01 * np.arange(len(stop.speed))
    steer = static_axle_loads(tractor_semitrailer)[0][0] / GRAVITY * demand * 0.5 / 40e3
    expected = steer * (1.0 - (a * np.exp(-t / a) - b * np.exp(-t / b)) / (a - b))
    # The pressure is stepped by Euler's rule at 1 ms, 1 % of its lag.
    np.testing.assert_allclose(stop.pressure[:, 0], expected, atol=0.01 * steer)


def test_a_full_application_fills_the_chambers_at_their_rate(tractor_semitrailer: Vehicle) -> None:
    """4 /s at most, so three quarters of the pressure take at least 0.19 s; the delays of both lags come on top."""
    stop = braked(tractor_semitrailer, DRY, 20.0, FULL, seconds=1.0)
    assert np.max(np.diff(stop.pressure[:, 1])) == pytest.approx(0.04, rel=1e-6)
    delay = 0.01 * float(np.argmax(stop.pressure[:, 1] > 0.75))
    assert 0.2 < delay < 0.5


@pytest.mark.parametrize("distribution", ["load", "pressure"])
def test_the_demanded_deceleration_is_reached(tractor_semitrailer: Vehicle, distribution: Distribution) -> None:
    """Brake forces sum up to mass times demand; rolling resistance helps by 0.006 g, turning wheels slow by 1.3 %."""
    stop = braked(changed(tractor_semitrailer, distribution=distribution), DRY, 20.0, 2.0, seconds=3.0)
    slowing = (stop.speed[150] - stop.speed[290]) / 1.4
    assert slowing == pytest.approx((2.0 + 0.006 * GRAVITY) / 1.013, rel=0.005)
    assert bool(np.ptp(stop.pressure[-1]) < 1e-3) == (distribution == "pressure")


def test_torque_ends_at_full_pressure(tractor_semitrailer: Vehicle) -> None:
    """On ground that holds everything 340 kN stop 40 t: 8.5 m/s2 and rolling resistance, whatever the demand."""
    eager = tractor_semitrailer.model_copy(
        update={"drive": tractor_semitrailer.drive.model_copy(update={"max_deceleration": 20.0})}
    )
    stop = braked(without_abs(eager), Surface(friction=1.5), 25.0, 20.0, seconds=2.0)
    slowing = (stop.speed[100] - stop.speed[150]) / 0.5
    assert stop.pressure[-1] == pytest.approx(1.0, abs=1e-5)
    assert slowing == pytest.approx((340e3 / 40e3 + 0.006 * GRAVITY) / 1.013, rel=0.01)


def test_select_low_keeps_both_sides_at_the_pressure_of_the_slippery_one(tractor_semitrailer: Vehicle) -> None:
    """0.8 left, 0.2 right: the steer axle brakes by the right wheel, the others each by its own."""
    line = np.array([[0.0, 0.0], [1.0, 0.0]])
    split = Surface(friction=SplitFriction(left=0.8, right=0.2, line=line))
    stop = braked(tractor_semitrailer, split, 20.0, FULL, seconds=0.8)  # before it has turned off the line
    steer, left, right = stop.pressure[50:, :3].mean(axis=0)
    assert steer < 0.35
    assert left > 2.0 * right
    assert stop.slips(above=5.0, after=0.5).max() < 0.2


def test_brake_data_without_a_table_of_the_system_are_named(tractor_semitrailer: Vehicle) -> None:
    sheet = data_sheet(tractor_semitrailer.model_copy(update={"brakes": None}))
    assert any("without a table [brakes]" in warning for warning in sheet.warnings)


def test_axles_that_share_modulators_have_the_same_lag(tractor_semitrailer: Vehicle) -> None:
    trailer = tractor_semitrailer.units[1]
    first = trailer.axles[0].brake
    assert first is not None
    slower = trailer.axles[0].model_copy(update={"brake": first.model_copy(update={"lag": 0.3})})
    units = (tractor_semitrailer.units[0], trailer.model_copy(update={"axles": (slower, *trailer.axles[1:])}))
    with pytest.raises(ValueError, match=r"units\.1\.axles\.1: brakes of abs_group 'axles' must have the same lag"):
        Vehicle(name="x", drive=tractor_semitrailer.drive, brakes=tractor_semitrailer.brakes, units=units)
