"""Signals for other tools: read back by other packages without a deviation, with their units."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pandas
import pytest
from scipy.io import loadmat
from typer.testing import CliRunner

from offtrack.commands.cli import app
from scenarios.options.scenario import load_scenario
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
def test_mf4_has_units_and_comments(run: Path) -> None:
    mdf = pytest.importorskip("asammdf", reason="MF4 needs the extra 'export'")
    with mdf.MDF(exported(run, "mf4")) as file:
        for signal in LOG.signals[1:]:
            read = file.get(signal.name)
            np.testing.assert_array_equal(read.samples, LOG[signal.name])
            np.testing.assert_array_equal(read.timestamps, LOG["time"])
            assert (read.unit, read.comment) == (signal.unit, signal.description)


@pytest.mark.slow
def test_mat_is_read_by_pymatreader(run: Path) -> None:
    reader = pytest.importorskip("pymatreader", reason="not installed: pip install pymatreader")
    content = reader.read_mat(exported(run, "mat"))
    for signal in LOG.signals:
        np.testing.assert_array_equal(content["signals"][signal.name], LOG[signal.name])
        assert content["units"][signal.name] == signal.unit


@pytest.mark.slow
def test_mf4_is_read_by_mdfreader(run: Path) -> None:
    pytest.importorskip("asammdf", reason="MF4 needs the extra 'export'")
    reader = pytest.importorskip("mdfreader", reason="not installed: pip install mdfreader")
    content = reader.Mdf(str(exported(run, "mf4")))
    for signal in LOG.signals[1:]:
        np.testing.assert_array_equal(content.get_channel_data(signal.name), LOG[signal.name])
        assert content.get_channel_unit(signal.name) == signal.unit
        assert signal.description in str(content.get_channel_desc(signal.name))


@pytest.mark.slow
def test_mcap_has_frames_bodies_paths_signals_and_images(tmp_path: Path) -> None:
    """A run and its recording, read by another package: every value, unit, pose and byte."""
    pytest.importorskip("foxglove", reason="MCAP needs the extra 'export'")
    reader_of = pytest.importorskip("mcap.reader", reason="not installed: pip install mcap mcap-protobuf-support")
    decoder = pytest.importorskip("mcap_protobuf.decoder", reason="not installed: pip install mcap-protobuf-support")
    scenario = load_scenario("constant-slip", ("off_tracking=truth",))
    (tmp_path / "scenario.toml").write_text(scenario.to_toml(), encoding="utf-8")
    names = [f"{name}_{unit}" for unit in ("tractor", "semitrailer") for name in ("x", "y", "psi")]
    time = np.arange(0.0, 1.0, 0.01)
    rows = np.column_stack([time, *(time + k for k in range(6)), np.where(time < 0.5, np.nan, time)])
    signals = [Signal("time", "s", "time"), *(Signal(name, "m", name) for name in names), Signal("value", "m", "v")]
    write_log(Log(tuple(signals), rows), tmp_path / "signals.parquet")
    images = tmp_path / "images"
    for side in (0, 1):
        (images / f"image_{side}").mkdir(parents=True)
        for k in range(3):
            cv2.imwrite(str(images / f"image_{side}" / f"{k:06d}.png"), np.full((4, 6), 10 * k + side, dtype=np.uint8))
    (images / "times.txt").write_text("0.0\n0.1\n0.2\n", encoding="utf-8")
    answer = CliRunner().invoke(app, ["export", str(tmp_path), "--to", "mcap", "--images", str(images), "--quiet"])
    assert answer.exit_code == 0, answer.output
    found: dict[str, list[tuple[int, Any]]] = {}
    with (tmp_path / "signals.mcap").open("rb") as file:
        reader = reader_of.make_reader(file, decoder_factories=[decoder.DecoderFactory()])
        for schema, channel, message, decoded in _messages(reader):
            found.setdefault(channel.topic, []).append((message.log_time, decoded))
            if channel.topic == "/signals":
                assert channel.metadata["unit.value"] == "m"
                assert b'"v [m]"' in schema.data
    assert [len(found[topic]) for topic in ("/signals", "/tf", "/scene", "/camera/left")] == [100, 50, 1, 3]
    for k, (stamp, told) in enumerate(found["/signals"]):
        assert stamp == round(1e9 * time[k])
        row = dict(zip((signal.name for signal in signals), rows[k].tolist(), strict=True))
        assert told == {name: value for name, value in row.items() if not math.isnan(value)}
    transform = found["/tf"][1][1].transforms[1]
    assert (transform.parent_frame_id, transform.child_frame_id) == ("W", "semitrailer")
    assert transform.translation.x == pytest.approx(0.02 + 3.0)
    assert 2.0 * math.atan2(transform.rotation.z, transform.rotation.w) == pytest.approx(0.02 + 5.0)
    assert {entity.id for entity in found["/scene"][0][1].entities} >= {"tractor", "semitrailer", "path of the hitch"}
    assert found["/camera/right"][2][1].data == (images / "image_1" / "000002.png").read_bytes()


def _messages(reader: Any) -> Iterator[tuple[Any, Any, Any, Any]]:
    """Messages of all topics; JSON is decoded here."""
    for schema, channel, message in reader.iter_messages():
        if channel.message_encoding == "json":
            yield schema, channel, message, json.loads(message.data)
    for schema, channel, message, decoded in reader.iter_decoded_messages(
        topics=["/tf", "/scene", "/camera/left", "/camera/right"]
    ):
        yield schema, channel, message, decoded
