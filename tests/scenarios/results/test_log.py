"""The log is a faithful, read-only table, in memory and on disk."""

from itertools import combinations
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

import offtrack
from scenarios.results.log import Log, Signal, read_log, write_log
from vehicle.combination.description import load_vehicle

SIGNALS = (Signal("time", "s", "time"), Signal("e", "m", "off-tracking, + left"), Signal("std", "m", "its deviation"))


def a_log() -> Log:
    return Log(SIGNALS, np.array([(0.0, np.nan, np.inf), (0.01, -0.0, 0.1), (0.02, 1.0 / 3.0, 1e-300)]))


@pytest.mark.parametrize("rows", [3, 0])
def test_a_log_survives_the_disk_bit_by_bit(tmp_path: Path, rows: int) -> None:
    """NaN, infinity, minus zero and the last bit of a third must come back, as hashes are compared across machines."""
    log = Log(SIGNALS, a_log().rows[:rows])
    write_log(log, tmp_path / "signals.parquet")
    back = read_log(tmp_path / "signals.parquet")
    assert back == log
    assert back.sha256() == log.sha256()


def test_missing_values_are_nulls_and_units_are_in_the_schema(tmp_path: Path) -> None:
    """Other programs read the file: they must see the missing estimate as missing, and the unit without our code."""
    write_log(a_log(), tmp_path / "signals.parquet")
    table = pq.read_table(tmp_path / "signals.parquet")
    assert table.column("e").null_count == 1
    assert table.column("std").null_count == 0
    assert table.schema.field("e").metadata == {b"unit": b"m", b"description": b"off-tracking, + left"}


def test_signals_are_read_by_name_and_can_not_be_changed() -> None:
    source = np.zeros((4, 3), order="F")  # as it is kept
    log = Log(SIGNALS, source)
    source[:] = 1.0
    assert log["e"].tolist() == [0.0, 0.0, 0.0, 0.0]
    with pytest.raises(ValueError, match="read-only"):
        log["e"][0] = 1.0
    with pytest.raises(KeyError, match="no signal 'nonsense'"):
        log["nonsense"]


def test_equality_and_hash_see_a_single_bit_and_a_unit() -> None:
    rows = a_log().rows.copy()
    rows[2, 1] = np.nextafter(rows[2, 1], 1.0)
    other_unit = (*SIGNALS[:2], Signal("std", "mm", "its deviation"))
    logs = a_log(), Log(SIGNALS, rows), Log(other_unit, a_log().rows)
    assert len({log.sha256() for log in logs}) == 3
    assert not any(one == other for one, other in combinations(logs, 2))


def test_every_nan_is_the_same_nan() -> None:
    """The sign of a NaN depends on how it came about and means nothing; it must not make equal runs unequal."""
    assert Log(SIGNALS, np.full((1, 3), -np.nan)) == Log(SIGNALS, np.full((1, 3), np.nan))


def test_a_signal_can_be_added_after_the_run() -> None:
    log = a_log().with_columns([(Signal("true", "m", "truth"), np.array([1.0, 2.0, 3.0]))])
    assert log.names == ("time", "e", "std", "true")
    assert log["true"].tolist() == [1.0, 2.0, 3.0]
    assert "true" in log
    assert "true" not in a_log()


def test_rows_that_do_not_fit_and_double_names_are_refused() -> None:
    with pytest.raises(ValueError, match="do not fit 3 signals"):
        Log(SIGNALS, np.zeros((4, 2)))
    with pytest.raises(ValueError, match="must differ"):
        Log((SIGNALS[0], SIGNALS[0]), np.zeros((4, 2)))


# Signals of loads, in a steady circle of closed form


@pytest.mark.slow
def test_signals_of_a_steady_circle_have_their_closed_forms() -> None:
    """Acceleration v r, its moment over weight times half the track within the roll, and friction v^2 / (R mu g)."""
    settings = {"speed_kmh": 25.0, "course.radius": 40.0, "course.turn_deg": 200.0, "trailer_steering": "none"}
    settings |= {"vehicle": "eu_tractor_semitrailer", "off_tracking": "truth"}
    circle, vehicle = offtrack.run("roundabout", settings=settings), load_vehicle("eu_tractor_semitrailer")
    np.testing.assert_allclose(circle["articulation_1"], circle["psi_tractor"] - circle["psi_semitrailer"], atol=1e-12)
    now = {name: circle[name][int(0.7 * len(circle.log))] for name in circle.log.names}
    for unit in vehicle.units:
        expected = now[f"v_x_{unit.name}"] * now[f"yaw_rate_{unit.name}"]
        assert now[f"lateral_acceleration_{unit.name}"] == pytest.approx(expected, abs=0.02)
    assert now["lateral_acceleration_tractor"] == pytest.approx((25 / 3.6) ** 2 / 38.0, rel=0.05)
    moment = sum(u.mass * u.cg_height * now[f"lateral_acceleration_{u.name}"] for u in vehicle.units)
    track = np.mean([axle.track for unit in vehicle.units for axle in unit.axles])
    measured = np.mean([now[f"load_transfer_{unit.name}"] for unit in vehicle.units])  # a left turn loads the right
    assert measured == pytest.approx(moment / (0.5 * track * vehicle.mass * 9.81), rel=0.25)
    of_axles = [value for name, value in now.items() if name.startswith("friction_used_") and name[-1].isdigit()]
    assert len(of_axles) == 5
    assert max(of_axles) <= now["friction_used_max"]
    needed = now["lateral_acceleration_tractor"] / (0.8 * 9.81)
    assert now["friction_used_tractor_1"] == pytest.approx(needed, rel=0.35)
