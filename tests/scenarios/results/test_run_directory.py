"""The summary has the promised names, and a run directory keeps what is finished."""

import dataclasses
import errno
import json
import math
import os
import shutil
import threading
from pathlib import Path

import numpy as np
import pytest

from offtrack.reports.run_files import write_run
from scenarios.results.log import Log, read_log, write_log
from scenarios.results.run_directory import (
    appearing_at_once,
    check_new_file,
    check_run_directory,
    claimed,
    mark_interrupted,
    next_run_directory,
    results_directory,
)
from scenarios.results.run_summary import Timing
from scenarios.results.trailer_result import RunResult
from vehicle.engine.compiler import engine_name

NAMES = {
    "off_tracking": [
        "true_rms_m",
        "true_max_m",
        "true_max_time_s",
        "estimate_error_rms_m",
        "estimate_error_max_m",
        "valid_fraction",
        "reference_error_rms_m",
        "estimate_against_reference_rms_m",
        "within_2_5_sigma",
        "ok_within_2_5_sigma",
        "nees_mean",
        "bridged_fraction",
        "longest_bridge_s",
    ],
    "swept_path": ["max_width_m", "min_inner_radius_m", "tail_swing_m", "tail_swing_entry_m", "tail_swing_exit_m"],
    "road": [f"wheel_clearance_{one}_{of}" for one in ("left", "right") for of in ("m", "time_s", "x_m", "y_m")],
    "steer": ["max_deg", "max_rate_deg_s"],
    "tyres": ["friction_used_max"],
    "odometry": ["matches_mean", "inliers_mean", "lost_frames", "longest_loss_s", "drift_percent"],
    "timing": ["simulated_s", "wall_s", "realtime_factor", "physics_s", "render_s", "odometry_s"],
}


def test_the_summary_has_the_fixed_names(camera_run: RunResult, blind_run: RunResult) -> None:
    """Users' scripts and our own checks read these names, with cameras or without."""
    for run in (camera_run, blind_run):
        numbers = run.summary()
        assert list(numbers) == ["outcome", "scenario", "seed", "warnings", *NAMES]
        assert {group: list(numbers[group]) for group in NAMES if isinstance(numbers[group], dict)} == NAMES  # type: ignore[arg-type]  # a dict, says the filter


def test_the_summary_tells_the_truth(camera_run: RunResult) -> None:
    numbers = json.loads(json.dumps(camera_run.summary(), allow_nan=False))
    log = camera_run.log
    assert numbers["off_tracking"]["true_max_m"] == pytest.approx(np.nanmax(np.abs(log["off_tracking_true"])), abs=1e-6)
    assert numbers["off_tracking"]["estimate_error_rms_m"] == pytest.approx(0.011, rel=0.3)  # [m] 250 samples of noise
    assert numbers["off_tracking"]["valid_fraction"] == 1.0
    assert numbers["odometry"]["lost_frames"] == 1
    assert numbers["odometry"]["drift_percent"] == pytest.approx(1.0, abs=0.1)  # made 1 % short; chord for arc
    assert numbers["odometry"]["inliers_mean"] == pytest.approx(300.0, abs=3.0)
    largest = max(np.max(np.abs(log[f"steer_trailer_{k}"])) for k in (1, 2, 3))
    assert numbers["steer"]["max_deg"] == pytest.approx(math.degrees(largest), abs=1e-6)
    assert numbers["timing"]["realtime_factor"] == pytest.approx(25.45 / 41.0, abs=1e-6)


def test_what_was_not_measured_is_null(blind_run: RunResult) -> None:
    numbers = blind_run.summary()
    assert numbers["odometry"] == dict.fromkeys(NAMES["odometry"])
    off_tracking = numbers["off_tracking"]
    assert isinstance(off_tracking, dict)
    assert off_tracking["estimate_error_rms_m"] is None
    assert off_tracking["true_rms_m"] is not None


def test_a_run_that_ended_at_once_still_has_a_summary_and_a_directory(blind_run: RunResult, tmp_path: Path) -> None:
    for rows in (0, 1):
        log = Log(blind_run.log.signals, blind_run.log.rows[:rows])
        run = dataclasses.replace(blind_run, outcome="interrupted", log=log)
        json.dumps(run.summary(), allow_nan=False)
        write_run(run, tmp_path / f"run-{rows}")
        assert "Nothing to draw" in (tmp_path / f"run-{rows}" / "report.html").read_text(encoding="utf-8")


@pytest.mark.slow
def test_a_run_directory_is_complete(camera_run: RunResult, tmp_path: Path) -> None:
    short = dataclasses.replace(camera_run, log=Log(camera_run.log.signals, camera_run.log.rows[:900]))
    told: list[tuple[float, float]] = []

    def report(done: float, total: float, note: str = "", /) -> None:
        told.append((done, total))

    directory = write_run(short, tmp_path / "runs" / "a", progress=report)
    assert [path.name for path in tmp_path.joinpath("runs").iterdir()] == ["a"]
    names = {path.name for path in directory.iterdir()}
    assert names >= {"scenario.toml", "manifest.json", "signals.parquet", "summary.json", "report.html"}
    assert len(names) == 6  # and a video or a GIF
    assert read_log(directory / "signals.parquet") == short.log
    manifest = json.loads((directory / "manifest.json").read_text(encoding="utf-8"))
    assert manifest["signals_sha256"] == short.log.sha256()
    assert manifest["frames_sha256"] == "0" * 64
    assert set(manifest["versions"]) == {"python", "offtrack", "numpy", "casadi", "opencv", "engine"}
    assert manifest["versions"]["engine"] == engine_name()
    assert json.loads((directory / "summary.json").read_text(encoding="utf-8")) == short.summary()
    assert (directory / "scenario.toml").read_text(encoding="utf-8") == short.scenario_toml
    assert told[-1][0] == told[-1][1] > 0


def test_a_directory_with_something_in_it_is_refused_and_left_alone(blind_run: RunResult, tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "mine.txt").touch()
    with pytest.raises(ValueError, match="not empty"):
        write_run(blind_run, tmp_path / "a", video=False)
    assert [path.name for path in tmp_path.rglob("*")] == ["a", "mine.txt"]


def test_what_can_not_become_a_run_directory_is_refused_beforehand(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").touch()
    (tmp_path / "circle").symlink_to("circle")
    refused = {"file": "is a file", "circle": "circle is a file or a broken link: choose another name"}
    for name, words in (refused | {f"{name}/a": f"{name}/a can not be made" for name in refused}).items():
        with pytest.raises(ValueError, match=words):
            check_run_directory(tmp_path / name)
    with pytest.raises(ValueError, match=r"a\.csv: there is no folder .*file to write in"):
        check_new_file(tmp_path / "file" / "a.csv")
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    with pytest.raises(ValueError, match="name a new folder inside it"):
        check_run_directory(Path())
    (tmp_path / "empty").mkdir()
    check_run_directory(tmp_path / "empty")
    check_run_directory(tmp_path / "new" / "deep")
    assert not (tmp_path / "new").exists()
    monkeypatch.setattr(os, "access", lambda *_: False)
    with pytest.raises(ValueError, match=r"new\.csv: no permission to write in .*: choose another file"):
        check_new_file(tmp_path / "new.csv")


def test_nothing_is_left_when_writing_fails(tmp_path: Path) -> None:

    def half_way() -> None:
        with appearing_at_once(tmp_path / "a") as folder:
            (folder / "signals.parquet").touch()
            raise OSError("disk full")

    with pytest.raises(OSError, match="disk full"):
        half_way()
    assert list(tmp_path.iterdir()) == []


def test_an_empty_directory_is_used(tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    with appearing_at_once(tmp_path / "a") as folder:
        (folder / "x").touch()
        assert os.listdir(tmp_path / "a") == []
    assert os.listdir(tmp_path / "a") == ["x"]


def test_run_directories_are_numbered_beyond_those_there_are(tmp_path: Path) -> None:
    assert next_run_directory("roundabout", tmp_path) == tmp_path / "roundabout-1"
    for name in ("roundabout-1", "roundabout-9", "roundabout-right-30", "roundabout-x"):
        (tmp_path / name).mkdir()
    assert next_run_directory("roundabout", tmp_path) == tmp_path / "roundabout-10"


def test_a_number_is_taken_at_the_start(tmp_path: Path) -> None:
    """Two commands at once have directories of their own; one that writes nothing leaves nothing behind."""
    runs = tmp_path / "runs"
    with results_directory(None, "a", runs) as first, results_directory(None, "a", runs) as second:
        assert (first, second) == (runs / "a-1", runs / "a-2")
        with appearing_at_once(first) as folder:
            (folder / "x").touch()
    assert [path.relative_to(runs).as_posix() for path in sorted(runs.rglob("*"))] == ["a-1", "a-1/x"]
    with pytest.raises(KeyboardInterrupt), results_directory(None, "b", tmp_path / "others"):
        raise KeyboardInterrupt
    assert not (tmp_path / "others").exists()


@pytest.mark.slow
def test_the_run_is_written_before_its_video_is_drawn(
    camera_run: RunResult, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Remains of a process that is killed then may be replaced; an interrupt keeps all that is finished."""
    run, seen = tmp_path / "run", list[str]()

    def write_video(_: object, __: object, ___: object, target: Path, ____: object) -> None:
        target.with_suffix(".mp4").write_bytes(b"half of it")
        shutil.copytree(run, tmp_path / "killed")
        for path in run.rglob("*"):
            if path.is_file():
                shutil.copystat(path, tmp_path / "killed" / path.relative_to(run))
        seen.extend(path.name for path in run.iterdir() if not path.name.startswith("."))
        raise KeyboardInterrupt

    monkeypatch.setattr("offtrack.reports.run_files.write_video", write_video)
    with pytest.raises(KeyboardInterrupt):
        write_run(camera_run, run)
    kept = ["manifest.json", "report.html", "scenario.toml", "signals.parquet", "summary.json"]
    assert sorted(seen) == kept
    assert sorted(path.name for path in run.iterdir()) == [".interrupted", *kept]
    for directory in (tmp_path / "killed", run):
        check_run_directory(directory)
    write_run(camera_run, tmp_path / "killed", video=False)
    assert sorted(path.name for path in (tmp_path / "killed").iterdir()) == kept


def test_a_directory_in_use_is_refused_until_its_results_are_drawn(
    blind_run: RunResult, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """From the start of a command; the lock stays with the name when the results take the place of the empty folder."""
    out, refusals = tmp_path / "out", list[str]()

    def try_it(*_: object) -> None:
        try:
            with claimed(out):
                refusals.append("")
        except ValueError as error:
            refusals.append(str(error))

    def others_try(*_: object) -> None:
        thread = threading.Thread(target=try_it)
        thread.start()
        thread.join()

    monkeypatch.setattr("offtrack.reports.run_files.write_video", others_try)
    with results_directory(out, "x") as directory:
        others_try()
        write_run(blind_run, directory)
        others_try()
    others_try()
    assert [f"{out}: another process works in it" in refusal for refusal in refusals] == [True, True, False, False]
    assert "is not empty" in refusals[-1]
    assert not (out / "traceback.txt").exists()


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EIO])
def test_results_that_a_disk_does_not_take_go_elsewhere(
    number: int, blind_run: RunResult, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A library's error names no file: the line does, and where the results are."""
    here = tmp_path / "here"
    here.mkdir()
    monkeypatch.chdir(here)

    def write(log: Log, path: Path) -> None:
        if "full" in path.parts:
            path.touch()
            raise OSError(number, "Error writing bytes")
        write_log(log, path)

    monkeypatch.setattr("offtrack.reports.run_files.write_log", write)
    with pytest.raises(ValueError, match=rf"full/out: {os.strerror(number)}; all else is in .*here/offtrack-out-1"):
        write_run(blind_run, tmp_path / "full" / "out", video=False)
    assert not (tmp_path / "full").exists()
    rescued = {path.name for path in (here / "offtrack-out-1").iterdir()}
    assert rescued == {"scenario.toml", "manifest.json", "signals.parquet", "summary.json", "report.html"}


def test_a_disk_with_too_little_space_is_refused_beforehand(tmp_path: Path) -> None:
    with (
        pytest.raises(ValueError, match=r"out: .* MB are free, and the results may take 1e\+12 MB: make room"),
        results_directory(tmp_path / "out", "x", space=1e18),
    ):
        pass
    assert not list(tmp_path.iterdir())


def test_a_recording_gives_way_until_its_run_is_drawn(
    blind_run: RunResult, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A process that is killed while it draws leaves both to the same command."""
    recording, marked = tmp_path / "recording", list[bool]()

    def write_video(*_: object) -> None:
        marked.append((recording / ".interrupted").exists())

    monkeypatch.setattr("offtrack.reports.run_files.write_video", write_video)
    with appearing_at_once(recording) as folder:
        (folder / "image").touch()
        mark_interrupted(folder)
    write_run(blind_run, tmp_path / "out", recording=recording)
    assert marked == [True]
    assert not (recording / ".interrupted").exists()


def test_timing_adds_up() -> None:
    timing = Timing(simulated_s=10.0, wall_s=5.0, physics_s=1.0, render_s=2.0, odometry_s=0.5)
    assert timing.rest_s == pytest.approx(1.5)
    parallel = dataclasses.replace(timing, odometry_parallel_s=0.4)
    assert parallel.rest_s == pytest.approx(1.9)  # what ran parallel to the loop took no time from it
    assert timing.realtime_factor == 2.0
    assert math.isnan(dataclasses.replace(timing, wall_s=0.0).realtime_factor)


def test_steer_signals_and_axles_belong_together(blind_run: RunResult) -> None:
    """Three steered axles of three; an axle without a signal is drawn straight."""
    assert blind_run.steer_signals() == tuple(f"steer_trailer_{k}_trailer" for k in (1, 2, 3))
    assert blind_run.steer_signals("trailer") == blind_run.steer_signals()
    np.testing.assert_array_equal(blind_run.trailer.axle_steer(blind_run.log)[:, 2], blind_run.log["steer_trailer_3"])
    np.testing.assert_array_equal(blind_run.units[0].axle_steer(blind_run.log)[:, 0], blind_run.log["steer_tractor"])
    rearmost = dataclasses.replace(blind_run.trailer, steer_signals=(None, None, "steer_trailer_3_trailer"))
    one = dataclasses.replace(blind_run, units=(blind_run.units[0], rearmost))
    np.testing.assert_array_equal(one.trailer.axle_steer(one.log)[:, 2], one.log["steer_trailer_3"])
    assert not one.trailer.axle_steer(one.log)[:, :2].any()


def test_only_untouched_results_of_an_interrupted_command_are_replaced(tmp_path: Path) -> None:

    def written(text: str) -> None:
        with appearing_at_once(tmp_path / "out") as folder:
            (folder / "numbers.txt").write_text(text)
            mark_interrupted(folder)

    written("first")
    written("second one")
    assert (tmp_path / "out" / "numbers.txt").read_text() == "second one"
    (tmp_path / "out" / "note.txt").write_text("mine")
    with pytest.raises(ValueError, match="not empty"):
        check_run_directory(tmp_path / "out")
    (tmp_path / "out" / "note.txt").unlink()
    check_run_directory(tmp_path / "out")
    (tmp_path / "out" / "numbers.txt").write_text("improved")
    with pytest.raises(ValueError, match="not empty"):
        written("third")
    assert (tmp_path / "out" / "numbers.txt").read_text() == "improved"
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_results_are_kept_if_their_directory_was_filled_meanwhile(tmp_path: Path) -> None:
    """Two commands of the same name at the same time: the second to end keeps its results, and says where."""

    def slow() -> None:
        with appearing_at_once(tmp_path / "out") as folder:
            (folder / "mine").touch()
            (tmp_path / "out" / "another").touch()

    with pytest.raises(ValueError, match=r"the results are in .*out-1"):
        slow()
    assert {path.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("*")} == {
        "out", "out/another", "out-1", "out-1/mine",
    }  # fmt: skip
