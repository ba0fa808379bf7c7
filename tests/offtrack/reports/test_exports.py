"""Signals for other tools: read back by other packages without a deviation, with their units."""

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
@pytest.mark.filterwarnings("ignore:Could not parse:UserWarning")  # of a comment, which mdfreader does not need
def test_mf4_is_read_by_mdfreader(run: Path) -> None:
    pytest.importorskip("asammdf", reason="MF4 needs the extra 'export'")
    reader = pytest.importorskip("mdfreader", reason="not installed: pip install mdfreader")
    content = reader.Mdf(str(exported(run, "mf4")))
    for signal in LOG.signals[1:]:
        np.testing.assert_array_equal(content.get_channel_data(signal.name), LOG[signal.name])
        assert content.get_channel_unit(signal.name) == signal.unit
        assert signal.description in str(content.get_channel_desc(signal.name))
