"""Signals for other tools: read back by other people's programs without a deviation, by their original names."""

import csv
import hashlib
import importlib
import json
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pandas
import pytest
import yaml
from scipy.io import loadmat
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

from offtrack.commands.cli import app
from offtrack.exchange.exports.catalogue import EXPORT, plain_names
from offtrack.exchange.exports.scene import moving_bodies
from scenarios.assembly.adapters import course_of, vehicle_of
from scenarios.assembly.trailer_run import opened_ground
from scenarios.loop.runner import run as run_scenario
from scenarios.options.scenario import load_any_scenario, load_scenario
from scenarios.results.log import Log, Signal, read_log, write_log
from vehicle.frames import FloatArray

HOSTILE = (  # pairs of unit names; the first ones of some pairs would be the second ones in plain letters
    ("semi-trailer 2", "semi_trailer-2"),
    ("Anhänger", "Anhanger"),
    ("挂车", "прицеп"),
    ("Ä", "A"),
    ("a-b", "a b"),
    ("a__b", "a_b"),
    ("ﬁ²", "fi2"),
    ("İstanbul-1", "ß"),
    ("é" * 40, "e" * 39 + "1"),
    ("time", "x_tractor - tick"),
)
MOVING = ("x", "y", "psi", "v_x", "v_y", "yaw_rate", "pitch", "roll")
Read = dict[str, tuple[FloatArray, FloatArray]]  # times and values by original names, where there is a value


def finished_run(folder: Path, names: tuple[str, str] = ("tractor", "semitrailer"), *keys: str) -> Path:
    """A run's directory with a log of 0.4 s; every tenth row has an estimate, the last signal never a value."""
    vehicle = (Path("vehicle/parameters") / "eu_tractor_semitrailer.toml").read_text(encoding="utf-8")
    for was, now in zip(("tractor", "semitrailer"), names, strict=True):
        vehicle = vehicle.replace(f'\nname = "{was}"', f'\nname = "{now}"')
    (folder / "vehicle.toml").write_text(vehicle, encoding="utf-8")
    scenario = load_scenario("constant-slip", ("off_tracking=truth", f"vehicle={folder / 'vehicle.toml'}", *keys))
    (folder / "scenario.toml").write_text(scenario.to_toml(), encoding="utf-8")
    time = np.arange(0.0, 0.4, 0.01)
    rng = np.random.default_rng(1)
    columns = [("time", "s", time)]
    columns += [(f"{one}_{unit}", "m", rng.normal(size=len(time))) for unit in names for one in MOVING]
    estimate = np.where(np.arange(len(time)) % 10 == 0, 1.0 / 3.0 + time, np.nan)
    columns += [(f"off_tracking_estimate_{names[1]}", "m", estimate), ("steer_trailer_1", "rad", -time / 3.0)]
    columns += [("off_tracking_reference", "m", np.full(len(time), np.nan)), ("huge", "-", 1e300 * time)]
    signals = tuple(Signal(name, unit, f'"{name}", of Prüflauf') for name, unit, _ in columns)
    write_log(Log(signals, np.column_stack([values for *_, values in columns])), folder / "signals.parquet")
    return folder


def log_of(run: Path) -> Log:
    return read_log(run / "signals.parquet")


def exported(run: Path, kind: str, *options: str, name: str = "exported") -> Path:
    out = run / f"{name}.{kind}"
    answer = CliRunner().invoke(app, ["export", str(run), "--to", kind, "--out", str(out), *options])
    assert answer.exit_code == 0, answer.output
    return out


def known(time: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    there = ~np.isnan(values)
    return time[there], values[there]


def assert_the_same(read: Read, log: Log, without: tuple[str, ...] = ()) -> None:
    """Every signal by its original name, bitwise."""
    assert set(read) == set(log.names) - set(without)
    for name, (times, values) in read.items():
        wanted_times, wanted = known(log["time"], log[name])
        np.testing.assert_array_equal(values, wanted, err_msg=name)
        np.testing.assert_array_equal(times, wanted_times, err_msg=name)


def by_pandas(path: Path, _: Log, **options: Any) -> Read:
    table = pandas.read_csv(path, **options)
    units = pandas.read_csv(path.with_suffix(".units.csv"), index_col="name", **options)
    assert units.loc["steer_trailer_1"].tolist() == ["rad", '"steer_trailer_1", of Prüflauf']
    return {name: known(table["time"].to_numpy(), table[name].to_numpy()) for name in table.columns}


def by_openpyxl(path: Path, _: Log) -> Read:
    openpyxl = pytest.importorskip("openpyxl", reason="not installed: pip install openpyxl")
    book = openpyxl.load_workbook(path)
    names, *rows = book["signals"].iter_rows(values_only=True)
    table = np.array([[np.nan if cell is None else float(cell) for cell in row] for row in rows])
    assert ("steer_trailer_1", "rad", '"steer_trailer_1", of Prüflauf') in list(book["units"].values)
    return {name: known(table[:, names.index("time")], table[:, k]) for k, name in enumerate(names)}


def by_scipy(path: Path, log: Log) -> Read:
    read = loadmat(path, squeeze_me=True, struct_as_record=False)
    return _of_mat(lambda structure, field: getattr(read[structure], field), read["names"]._fieldnames, log)


def by_pymatreader(path: Path, log: Log) -> Read:
    read = pytest.importorskip("pymatreader", reason="not installed: pip install pymatreader").read_mat(path)

    def value(structure: str, field: str) -> Any:
        return read[structure][field]

    return _of_mat(value, list(read["names"]), log)


def _of_mat(value: Callable[[str, str], Any], fields: list[str], log: Log) -> Read:
    """Signals with gaps by their own time vectors, which agree with the rows of NaN."""
    of_mat, signals = dict[str, tuple[FloatArray, FloatArray]](), {one.name: one for one in log.signals}
    for field in fields:
        assert re.fullmatch(r"[A-Za-z]\w{0,62}", field, re.ASCII)
        name = value("names", field)
        assert value("units", field) == signals[name].unit
        assert value("meanings", field) == signals[name].description
        of_mat[name] = known(value("signals", "time"), value("signals", field))
        if 0 < np.isnan(log[name]).sum() < len(log):
            sampled = value("sampled", field)
            time, own = (
                (sampled[key] if isinstance(sampled, dict) else getattr(sampled, key)) for key in ("time", "value")
            )
            of_mat[name] = np.atleast_1d(time), np.atleast_1d(own)
    return of_mat


def by_asammdf(path: Path, log: Log) -> Read:
    asammdf = pytest.importorskip("asammdf", reason="MF4 needs the extra 'export'")
    with asammdf.MDF(path) as file:
        read = {name: file.get(name) for name in log.names if name != "time"}
    assert read["steer_trailer_1"].unit == "rad"
    assert read["steer_trailer_1"].comment == '"steer_trailer_1", of Prüflauf'
    (estimate,) = (name for name in read if name.startswith("off_tracking_estimate"))
    assert len(read[estimate].samples) == 4  # a group of its own: no NaN between the values
    return {name: known(signal.timestamps, signal.samples) for name, signal in read.items()}


def by_mdfreader(path: Path, log: Log) -> Read:
    """In a process of its own: its XML reader does not bear what other readers have loaded."""
    pytest.importorskip("mdfreader", reason="not installed: pip install mdfreader")
    code = (
        "import json, sys, numpy, mdfreader\n"
        "source, target, *names = sys.argv[1:]\n"
        "file = mdfreader.Mdf(source)\n"
        "time = {name: file.get_channel_data(file.get_channel_master(name)) for name in names}\n"
        "numpy.savez(target, *[one for name in names for one in (time[name], file.get_channel_data(name))])\n"
        "print(json.dumps([[file.get_channel_unit(name), str(file.get_channel_desc(name))] for name in names]))\n"
    )
    target, names = path.with_suffix(".npz"), [name for name in log.names if name != "time"]
    command = [sys.executable, "-W", "ignore", "-c", code, str(path), str(target), *names]
    printed = subprocess.run(command, check=True, capture_output=True, text=True).stdout.splitlines()[-1]
    for signal, (unit, description) in zip(log.signals[1:], json.loads(printed), strict=True):
        assert unit == signal.unit
        assert signal.description in description
    with np.load(target) as content:
        arrays = [np.atleast_1d(content[f"arr_{k}"]) for k in range(2 * len(names))]
    return {name: known(arrays[2 * k], arrays[2 * k + 1]) for k, name in enumerate(names)}


def by_mcap(path: Path, _: Log) -> Read:
    reader = pytest.importorskip("mcap.reader", reason="not installed: pip install mcap")
    read: dict[str, list[tuple[float, float]]] = {}
    with path.open("rb") as file:
        for schema, channel, message in reader.make_reader(file).iter_messages(topics=["/signals"]):
            properties = json.loads(schema.data)["properties"]
            assert all(re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", name) for name in properties)  # of a message path
            for name, value in json.loads(message.data).items():
                read.setdefault(channel.metadata[f"name.{name}"], []).append((1e-9 * message.log_time, value))
    assert channel.metadata["unit.steer_trailer_1"] == "rad"
    assert properties["steer_trailer_1"]["title"] == '"steer_trailer_1", of Prüflauf [rad]'
    missing: dict[str, list[tuple[float, float]]] = {channel.metadata[f"name.{name}"]: [] for name in properties}
    return _rounded({**missing, **read})


def by_rosbags(path: Path, log: Log) -> Read:
    highlevel = pytest.importorskip("rosbags.highlevel", reason="bags need the extra 'export'")
    read: dict[str, list[tuple[float, float]]] = {name: [] for name in log.names}
    with highlevel.AnyReader([path]) as reader:
        (units,) = (c for c in reader.connections if c.topic == "/signals_units")
        _, _, data = next(reader.messages([units]))
        table = json.loads(reader.deserialize(data, units.msgtype).data)
        names = {one["topic"]: name for name, one in table.items()}
        for connection, stamp, data in reader.messages(connections=[c for c in reader.connections if c.topic in names]):
            read[names[connection.topic]].append((1e-9 * stamp, reader.deserialize(data, connection.msgtype).data))
        for connection in reader.connections:  # what ROS 2 takes as the name of a topic
            assert re.fullmatch(r"(/[A-Za-z][A-Za-z0-9_]*)+", connection.topic)
            assert "__" not in connection.topic
    assert table["steer_trailer_1"]["unit"] == "rad"
    return _rounded(read)


def _rounded(read: dict[str, list[tuple[float, float]]]) -> Read:
    """Times as the log has them, in hundredths of a second."""
    arrays = {name: np.array(pairs).reshape(-1, 2) for name, pairs in read.items()}
    return {name: (np.round(pairs[:, 0] / 0.01) * 0.01, pairs[:, 1]) for name, pairs in arrays.items()}


READERS: list[tuple[str, Callable[..., Read]]] = [
    ("csv", by_pandas),
    ("xlsx", by_openpyxl),
    ("mat", by_scipy),
    ("mat", by_pymatreader),
    ("mf4", by_asammdf),
    ("mf4", by_mdfreader),
    ("mcap", by_mcap),
    ("rosbag2", by_rosbags),
]


@pytest.mark.parametrize("names", HOSTILE, ids=lambda names: "-".join(plain_names(names).values())[:30])
@pytest.mark.slow
def test_every_format_gives_all_signals_of_any_units_by_their_names(tmp_path: Path, names: tuple[str, str]) -> None:
    run = finished_run(tmp_path, names)
    log = log_of(run)
    for kind, reader in READERS:
        path = run / f"exported.{kind}"
        read = reader(path if path.exists() else exported(run, kind), log)
        assert_the_same(read, log, ("time",) if kind == "mf4" else ())


def test_tables_are_read_by_pandas_and_scipy(tmp_path: Path) -> None:
    run = finished_run(tmp_path)
    assert_the_same(by_pandas(exported(run, "csv"), log_of(run)), log_of(run))
    assert_the_same(by_scipy(exported(run, "mat"), log_of(run)), log_of(run))


def test_a_decimal_comma_makes_cells_of_numbers(tmp_path: Path) -> None:
    run = finished_run(tmp_path)
    path = exported(run, "csv", "--decimal", ",")
    assert path.read_bytes().startswith(b"\xef\xbb\xbf")  # by which spreadsheets know UTF-8
    assert_the_same(by_pandas(path, log_of(run), sep=";", decimal=","), log_of(run))
    with path.open(encoding="utf-8-sig", newline="") as file:
        assert len(next(csv.reader(file, delimiter=";"))) == len(log_of(run).names)


@pytest.mark.parametrize("kind", EXPORT)
def test_a_writer_is_one_short_file(kind: str) -> None:
    module = importlib.import_module(EXPORT[kind].partition(":")[0])
    assert Path(str(module.__file__)).read_text(encoding="utf-8").count("\n") <= 260


@pytest.mark.slow
@pytest.mark.parametrize("kind", EXPORT)
def test_the_same_run_gives_the_same_bytes(tmp_path: Path, kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also after years, in another folder."""
    pytest.importorskip({"mf4": "asammdf", "mcap": "foxglove", "rosbag2": "rosbags"}.get(kind, "xlsxwriter"))
    contents = []
    for folder in (tmp_path / "one", tmp_path / "other"):
        folder.mkdir()
        path = exported(finished_run(folder), kind)
        files = sorted(path.iterdir()) if path.is_dir() else [path]
        contents.append([(file.name, file.read_bytes()) for file in files])

        monkeypatch.setattr("time.time", lambda: 2e9)
    assert contents[0] == contents[1]


@pytest.mark.parametrize(
    ("patterns", "names"),
    [
        ("steer*", ["time", "steer_trailer_1"]),
        ("off_tracking*, huge", ["time", "off_tracking_estimate_semitrailer", "off_tracking_reference", "huge"]),
    ],
)
def test_signals_are_picked_and_listed(tmp_path: Path, patterns: str, names: list[str]) -> None:
    run = finished_run(tmp_path)
    assert list(pandas.read_csv(exported(run, "csv", "--signals", patterns)).columns) == names
    answer = CliRunner().invoke(app, ["export", str(run), "--list", "--signals", patterns])
    lines = answer.output.splitlines()
    assert [line.split()[0] for line in lines if not line.startswith(" ")] == names
    assert re.search(r"time +s +\"time\", of Prüflauf", lines[0])


def test_a_pattern_without_a_signal_is_refused_with_the_nearest_name(tmp_path: Path) -> None:
    answer = CliRunner().invoke(app, ["export", str(finished_run(tmp_path)), "--signals", "steer_trialer_1"])
    assert answer.exit_code == 2
    assert "did you mean 'steer_trailer_1'?" in answer.stderr


@pytest.mark.slow
def test_units_of_parquet_files_are_seen_by_polars_duckdb_and_pandas(tmp_path: Path) -> None:
    polars = pytest.importorskip("polars", reason="not installed: pip install polars")
    duckdb = pytest.importorskip("duckdb", reason="not installed: pip install duckdb")
    path = finished_run(tmp_path) / "signals.parquet"
    ((text,),) = duckdb.sql(f"SELECT value FROM parquet_kv_metadata('{path}') WHERE key = 'signals'").fetchall()
    for signals in (
        json.loads(polars.read_parquet_metadata(path)["signals"]),
        json.loads(text),
        pandas.read_parquet(path).attrs["signals"],
    ):
        assert signals["steer_trailer_1"] == {"unit": "rad", "meaning": '"steer_trailer_1", of Prüflauf'}
    values = np.ravel(duckdb.sql(f"SELECT huge FROM '{path}'").fetchall())
    np.testing.assert_array_equal(values, log_of(tmp_path)["huge"])
    np.testing.assert_array_equal(polars.read_parquet(path)["huge"].to_numpy(), log_of(tmp_path)["huge"])


def lichtblick_fields(schema: dict[str, Any]) -> list[str]:
    """Names of the fields that Lichtblick makes of a JSON schema; what it does not take is refused as there.

    By packages/mcap-support/src/parseJsonSchema.ts of Lichtblick: the type is one text; arrays have items of one type.
    """
    assert schema["type"] == "object"
    fields = []
    for name, field in schema["properties"].items():
        kind = field["type"]
        if kind == "object":
            lichtblick_fields(field)
        elif kind == "array":
            assert field["items"]["type"] in ("boolean", "string", "number", "integer", "object")
        else:
            assert kind in ("boolean", "string", "number", "integer"), f"Unsupported type {kind}"
        fields.append(name)
    return fields


@pytest.mark.slow
def test_lichtblick_takes_the_schema_of_the_signals(tmp_path: Path) -> None:
    reader = pytest.importorskip("mcap.reader", reason="not installed: pip install mcap")
    run = finished_run(tmp_path)
    with exported(run, "mcap").open("rb") as file:
        schemas = reader.make_reader(file).get_summary().schemas.values()
        of_json = [json.loads(schema.data) for schema in schemas if schema.encoding == "jsonschema"]
    assert [lichtblick_fields(schema) for schema in of_json] == [list(log_of(run).names)]


def humble_metadata(folder: Path) -> dict[str, Any]:
    """The metadata of a bag as Humble's rosbag2 decodes them; a wrong type is its "bad conversion".

    By rosbag2_storage/include/rosbag2_storage/yaml.hpp of ROS 2 Humble; that of Jazzy takes the same text.
    """
    bag = yaml.safe_load((folder / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert isinstance(bag["version"], int)
    assert bag["version"] <= 8
    for key in ("storage_identifier", "compression_format", "compression_mode", "ros_distro"):
        assert isinstance(bag[key], str), f"{key}: bad conversion"
    for one in (bag, *bag["files"]):
        assert isinstance(one["duration"]["nanoseconds"], int)
        assert isinstance(one["starting_time"]["nanoseconds_since_epoch"], int)
        assert isinstance(one["message_count"], int)
    assert all(isinstance(path, str) for path in bag["relative_file_paths"])
    assert bag["custom_data"] is None or all(isinstance(text, str) for text in bag["custom_data"].values())
    for topic in bag["topics_with_message_count"]:
        assert isinstance(topic["message_count"], int)
        for key in ("name", "type", "serialization_format", "offered_qos_profiles", "type_description_hash"):
            assert isinstance(topic["topic_metadata"][key], str), f"{key}: bad conversion"
        for profile in yaml.safe_load(topic["topic_metadata"]["offered_qos_profiles"]) or []:
            assert all(isinstance(profile[key], int) for key in ("history", "depth", "reliability", "durability"))
            assert all(isinstance(profile["deadline"][key], int) for key in ("sec", "nsec"))
    return dict(bag)


def recorded(run: Path) -> Path:
    """A stereo recording of three frames that the run's manifest knows."""
    folder, digest = run / "images", hashlib.sha256()
    for side in (0, 1):
        (folder / f"image_{side}").mkdir(parents=True)
    for k in range(3):
        for side in (0, 1):
            image = np.random.default_rng((k, side)).integers(0, 256, (48, 64), dtype=np.uint8)
            cv2.imwrite(str(folder / f"image_{side}" / f"{k:06d}.png"), image)
            digest.update(image.data)
    (folder / "times.txt").write_text("0.0\n0.1\n0.2\n", encoding="utf-8")
    calibration = "".join(f"P{k}: 60 0 31.5 {-30.0 * k} 0 60 23.5 0 0 0 1 0\n" for k in (0, 1))
    (folder / "calib.txt").write_text(calibration, encoding="utf-8")
    pose = "X_SC = [[0.0, 0.0, -1.0, -14.0], [1.0, 0.0, 0.0, -0.25], [0.0, -1.0, 0.0, 3.0], [0.0, 0.0, 0.0, 1.0]]\n"
    (folder / "rig.toml").write_text(pose, encoding="utf-8")
    (run / "manifest.json").write_text(json.dumps({"recording_sha256": digest.hexdigest()}), encoding="utf-8")
    return folder


SLOPE = ("surface.grade=0.05", "surface.cross_fall=-0.02")
X_SC = np.array([[0.0, 0.0, -1.0, -14.0], [1.0, 0.0, 0.0, -0.25], [0.0, -1.0, 0.0, 3.0], [0.0, 0.0, 0.0, 1.0]])


@pytest.mark.slow
def test_a_bag_has_the_metadata_of_humble_and_the_poses_of_cameras_on_a_slope(tmp_path: Path) -> None:
    highlevel = pytest.importorskip("rosbags.highlevel", reason="bags need the extra 'export'")
    run = finished_run(tmp_path, ("tractor", "semitrailer"), *SLOPE)
    path = exported(run, "rosbag2", "--images", str(recorded(run)))
    topics = {
        one["topic_metadata"]["name"]: one["topic_metadata"]
        for one in humble_metadata(path)["topics_with_message_count"]
    }
    (profile,) = yaml.safe_load(topics["/tf_static"]["offered_qos_profiles"])
    assert profile["durability"] == 1  # transient local: kept for subscribers that come later
    frames: dict[str, tuple[str, FloatArray]] = {}
    images = set[str]()
    with highlevel.AnyReader([path]) as reader:
        for connection, _, data in reader.messages():
            if connection.topic in ("/tf_static", "/tf"):
                for one in reader.deserialize(data, connection.msgtype).transforms:
                    move, turn = one.transform.translation, one.transform.rotation
                    pose = pose_of((move.x, move.y, move.z), (turn.x, turn.y, turn.z, turn.w))
                    frames.setdefault(one.child_frame_id, (one.header.frame_id, pose))
            elif connection.topic.endswith(("image_raw", "camera_info")):
                images.add(reader.deserialize(data, connection.msgtype).header.frame_id)
    assert images == {"camera_left", "camera_right"}
    check_frames(run, frames, "map")


@pytest.mark.slow
def test_an_mcap_file_has_calibrations_and_the_poses_of_cameras_on_a_slope(tmp_path: Path) -> None:
    decoder = pytest.importorskip("mcap_protobuf.decoder", reason="not installed: pip install mcap-protobuf-support")
    from mcap.reader import make_reader

    run = finished_run(tmp_path, ("tractor", "semitrailer"), *SLOPE)
    frames: dict[str, tuple[str, FloatArray]] = {}
    calibrations = dict[str, Any]()
    with exported(run, "mcap", "--images", str(recorded(run))).open("rb") as file:
        reader = make_reader(file, decoder_factories=[decoder.DecoderFactory()])
        for _, channel, _, told in reader.iter_decoded_messages(
            topics=["/tf", "/camera/left/calibration", "/camera/right/calibration"]
        ):
            if channel.topic == "/tf":
                for one in told.transforms:
                    move, turn = one.translation, one.rotation
                    pose = pose_of((move.x, move.y, move.z), (turn.x, turn.y, turn.z, turn.w))
                    frames.setdefault(one.child_frame_id, (one.parent_frame_id, pose))
            else:
                calibrations[told.frame_id] = told
    assert set(calibrations) == {"camera_left", "camera_right"}
    assert calibrations["camera_right"].P[3] == -30.0
    assert calibrations["camera_left"].K[0] == 60.0
    check_frames(run, frames, "W")


def pose_of(position: tuple[float, ...], turn: tuple[float, ...]) -> FloatArray:
    X = np.eye(4)
    X[:3, 3], X[:3, :3] = position, Rotation.from_quat(turn).as_matrix()
    return X


def check_frames(run: Path, frames: dict[str, tuple[str, FloatArray]], world: str) -> None:
    """Cameras are fixed to the trailer; the trailer is on the ground, with the attitude that the log has."""
    log, scenario = log_of(run), load_scenario(str(run / "scenario.toml"))
    parent, X_SCl = frames["camera_left"]
    assert parent == "semitrailer"
    np.testing.assert_allclose(X_SCl, X_SC, atol=1e-12)
    parent, X_SCr = frames["camera_right"]
    assert parent == "semitrailer"
    np.testing.assert_allclose(np.linalg.inv(X_SCl) @ X_SCr, pose_of((0.5, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)), atol=1e-12)
    parent, X_WS = frames["semitrailer"]
    assert parent == world
    x, y, yaw, pitch, roll = (log[f"{name}_semitrailer"][0] for name in ("x", "y", "psi", "pitch", "roll"))
    ground, _ = opened_ground(scenario, course_of(scenario, vehicle_of(scenario)), 1)
    np.testing.assert_allclose(X_WS[:3, 3], [x, y, ground.height(x, y)], atol=1e-12)
    assert abs(X_WS[2, 3]) > 0.01
    axes = X_WS[2, :3]  # as the log's roll and pitch are defined
    assert np.arctan2(axes[1], axes[2]) == pytest.approx(roll, abs=1e-12)
    assert -np.arcsin(axes[0]) == pytest.approx(pitch, abs=1e-12)
    assert np.arctan2(X_WS[1, 0], X_WS[0, 0]) == pytest.approx(yaw, abs=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["mcap", "rosbag2"])
def test_a_recording_of_another_run_is_refused(tmp_path: Path, kind: str) -> None:
    run = finished_run(tmp_path)
    images = recorded(run)
    cv2.imwrite(str(images / "image_0" / "000001.png"), np.zeros((48, 64), dtype=np.uint8))
    answer = CliRunner().invoke(app, ["export", str(run), "--to", kind, "--images", str(images)])
    assert answer.exit_code == 2
    assert "are not those of the run" in answer.stderr
    assert not list(run.glob("*.mcap"))
    assert not (run / "rosbag2").exists()


def test_nothing_is_said_where_no_home_can_be_written(tmp_path: Path) -> None:
    run = finished_run(tmp_path)
    (tmp_path / "file").write_text("")
    homeless = dict.fromkeys(("HOME", "XDG_CACHE_HOME", "XDG_CONFIG_HOME"), str(tmp_path / "file" / "home"))
    command = [sys.executable, "-m", "offtrack", "export", str(run), "--quiet"]
    done = subprocess.run(command, env={"PATH": "", "PYTHONPATH": ":".join(sys.path), **homeless}, capture_output=True)
    assert (done.returncode, done.stdout, done.stderr) == (0, b"", b"")


class Seen:
    """Recorder of the true poses of the body that carries the camera, and of the images that a run sees."""

    def __init__(self) -> None:
        self.poses: list[FloatArray] = []
        self.ticks: list[int] = []

    def __enter__(self) -> "Seen":
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def add(self, message: Any, capture: Any) -> None:
        self.poses.append(getattr(capture, "X_WB", capture))
        self.ticks.append(message.tick)

    def end(self) -> None:
        pass


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "keys"),
    [
        (
            "roundabout",
            [*SLOPE, "course.turn_deg=30", "course.entry=20", "course.exit=5", "rig.width=160", "rig.height=120"],
        ),
        ("rover-craters", ["course.length=1.5"]),
    ],
)
def test_bodies_are_where_they_were(tmp_path: Path, name: str, keys: list[str]) -> None:
    """The true poses of the body under the camera: within the heave of its springs, and 0.05 deg."""
    seen, scenario = Seen(), load_any_scenario(name, keys)
    log = run_scenario(scenario, 1, record=lambda _: seen).log
    (tmp_path / "scenario.toml").write_text(scenario.to_toml(), encoding="utf-8")
    body = moving_bodies(log, tmp_path / "scenario.toml")[-1]
    rows = np.searchsorted(log["tick"], seen.ticks)
    assert len(rows) > 10
    places, turns = body.positions[rows], Rotation.from_quat(body.turns[rows]).as_matrix()
    true = np.array(seen.poses)
    assert np.ptp(true[:, 2, 3]) > 0.01
    np.testing.assert_allclose(places, true[:, :3, 3], atol=0.012)
    angles = Rotation.from_matrix(np.swapaxes(turns, 1, 2) @ true[:, :3, :3]).magnitude()
    assert np.degrees(angles).max() < 0.05


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["mcap", "rosbag2"])
def test_a_rover_s_camera_is_exported(tmp_path: Path, kind: str) -> None:
    """With its images, its lens and its place on the body; a stereo recording is not taken for it."""
    highlevel = pytest.importorskip("rosbags.highlevel", reason="bags need the extra 'export'")
    foxglove = pytest.importorskip("mcap_protobuf.decoder", reason="not installed: pip install mcap-protobuf-support")
    from mcap.reader import make_reader

    folder, images = tmp_path / "run", tmp_path / "images"
    options = ["--set", "course.length=0.5", "--record", str(images), "--no-video", "--quiet", "--out", str(folder)]
    answer = CliRunner().invoke(app, ["run", "rover-slope", *options])
    assert answer.exit_code == 0, answer.output
    path, found = exported(folder, kind, "--images", str(images)), dict[str, list[Any]]()
    if kind == "mcap":
        with path.open("rb") as file:
            reader = make_reader(file, decoder_factories=[foxglove.DecoderFactory()])
            for _, channel, _, told in reader.iter_decoded_messages(topics=["/camera", "/camera/calibration", "/tf"]):
                found.setdefault(channel.topic, []).append(told)
        frames, calibration = found["/camera"], found["/camera/calibration"][0]
        told = [cv2.imdecode(np.frombuffer(one.data, np.uint8), cv2.IMREAD_UNCHANGED) for one in frames]
        focal, lens = calibration.K[0], calibration.D[0]
        fixed = next(one for one in found["/tf"][0].transforms if one.child_frame_id == "camera").translation
    else:
        with highlevel.AnyReader([path]) as reader:
            for connection, _, data in reader.messages():
                if connection.topic.startswith(("/camera", "/tf_static")):
                    found.setdefault(connection.topic, []).append(reader.deserialize(data, connection.msgtype))
        told = [one.data.reshape(one.height, one.width) for one in found["/camera/image_raw"]]
        focal, lens = found["/camera/camera_info"][0].k[0], found["/camera/camera_info"][0].d[0]
        fixed = found["/tf_static"][0].transforms[0].transform.translation
    files = sorted((images / "images").iterdir())
    for image, recorded_file in zip(told, files, strict=True):
        np.testing.assert_array_equal(image, cv2.imread(str(recorded_file), cv2.IMREAD_UNCHANGED))
    assert (focal, lens) == (620.0, -0.09)
    assert (fixed.x, fixed.y, fixed.z) == (-0.4, 0.275, 0.75)
