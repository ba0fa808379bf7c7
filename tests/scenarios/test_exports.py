"""Signals for other tools: read back by other packages without a deviation, with their units."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas
import pytest
from scipy.io import loadmat
from typer.testing import CliRunner

from scenarios.cli import app
from scenarios.results.log import Log, Signal, write_log

LOG = Log(
    (
        Signal("time", "s", "time"),
        Signal("x_tractor", "m", "tractor: position east"),
        Signal("off_tracking_estimate_semitrailer", "m", 'semitrailer: "estimated", off-tracking'),
    ),
    np.array([[0.0, 1.0 / 3.0, np.nan], [0.01, -1e-300, 0.1], [0.02, 1e300, np.nan]]),
)


@pytest.fixture
def run(tmp_path: Path) -> Path:
    write_log(LOG, tmp_path / "signals.parquet")
    return tmp_path


def exported(run: Path, kind: str) -> Path:
    answer = CliRunner().invoke(app, ["export", str(run), "--to", kind])
    assert answer.exit_code == 0, answer.output
    return run / f"signals.{kind}"


def test_csv_is_read_by_pandas(run: Path) -> None:
    table = pandas.read_csv(exported(run, "csv"))
    assert tuple(table.columns) == LOG.names
    np.testing.assert_array_equal(table.to_numpy(), LOG.rows)
    units = pandas.read_csv(run / "signals.units.csv", index_col="name")
    assert units.loc["x_tractor", "unit"] == "m"
    assert units.loc["off_tracking_estimate_semitrailer", "meaning"] == LOG.signals[2].description


def test_mat_is_read_by_scipy(run: Path) -> None:
    content = loadmat(exported(run, "mat"), squeeze_me=True, struct_as_record=False)
    for signal in LOG.signals:
        np.testing.assert_array_equal(getattr(content["signals"], signal.name), LOG[signal.name])
        assert getattr(content["units"], signal.name) == signal.unit
        assert getattr(content["meanings"], signal.name) == signal.description


def test_mf4_has_units_and_comments(run: Path) -> None:
    mdf = pytest.importorskip("asammdf", reason="MF4 needs the extra 'export'")
    with mdf.MDF(exported(run, "mf4")) as file:
        for signal in LOG.signals[1:]:
            read = file.get(signal.name)
            np.testing.assert_array_equal(read.samples, LOG[signal.name])
            np.testing.assert_array_equal(read.timestamps, LOG["time"])
            assert (read.unit, read.comment) == (signal.unit, signal.description)


def test_what_can_not_be_exported_is_one_line(run: Path) -> None:
    exported(run, "csv")
    cases = (
        ([str(run), "--to", "csv"], "exists already"),
        ([str(run / "none")], "is no directory of a finished run"),
        ([str(run), "--to", "mat", "--out", str(run / "none" / "x.mat")], "there is no folder"),
        ([str(run), "--to", "xls"], "xls"),
    )
    for arguments, line in cases:
        answer = CliRunner().invoke(app, ["export", *arguments])
        assert answer.exit_code == 2
        assert line in answer.stderr
        assert len(answer.stderr.splitlines()) == 1
    assert sorted(path.name for path in run.iterdir()) == ["signals.csv", "signals.parquet", "signals.units.csv"]
