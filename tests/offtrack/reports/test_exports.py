"""Signals for other tools: read back by other packages without a deviation, with their units."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas
import pytest
from scipy.io import loadmat
from typer.testing import CliRunner

from offtrack.commands.cli import app
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


@pytest.mark.slow
def test_mf4_is_read_by_mdfreader(run: Path, tmp_path: Path) -> None:
    """In a process of its own: its XML reader does not bear what other readers have loaded."""
    pytest.importorskip("asammdf", reason="MF4 needs the extra 'export'")
    pytest.importorskip("mdfreader", reason="not installed: pip install mdfreader")
    code = (
        "import json, sys, numpy, mdfreader\n"
        "source, target, *names = sys.argv[1:]\n"
        "file = mdfreader.Mdf(source)\n"
        "numpy.savez(target, **{name: file.get_channel_data(name) for name in names})\n"
        "print(json.dumps([[file.get_channel_unit(name), str(file.get_channel_desc(name))] for name in names]))\n"
    )
    target, names = tmp_path / "read.npz", [signal.name for signal in LOG.signals[1:]]
    command = [sys.executable, "-W", "ignore", "-c", code, str(exported(run, "mf4")), str(target), *names]
    printed = subprocess.run(command, check=True, capture_output=True, text=True).stdout.splitlines()[-1]
    with np.load(target) as content:
        for signal, (unit, description) in zip(LOG.signals[1:], json.loads(printed), strict=True):
            np.testing.assert_array_equal(content[signal.name], LOG[signal.name])
            assert unit == signal.unit
            assert signal.description in description
