"""Recordings of a run give the estimates of the run again; self-calibration in the loop."""

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from offtrack.commands.estimate import app
from offtrack.exchange.recordings.stereo_reader import open_recording
from offtrack.exchange.recordings.writers import recording_in
from scenarios.loop.runner import run
from scenarios.options.scenario import load_scenario
from scenarios.results.log import read_log


@pytest.mark.slow
def test_a_recorded_run_gives_the_estimates_of_its_loop(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The same images, calibration and odometry: equal but for the twelve digits of the focal length in calib.txt."""
    monkeypatch.chdir(tmp_path)
    length = ["course.length=20", "rig.width=640", "rig.height=200", "world.scenery_density=0.3"]
    result = run(load_scenario("constant-slip", length), 1, record=recording_in(tmp_path / "images"))
    options = ["--out", "out", "--no-video", "--quiet", "--no-self-calibration"]  # as in the run
    told = CliRunner().invoke(app, ["off-tracking", "images", *options])
    assert told.exit_code == 0, told.output
    log = read_log(tmp_path / "out" / "off_tracking.parquet")
    delivered = np.isfinite(result.signal("matches"))
    ticks = result.log["tick"][delivered].astype(int)
    rows = np.searchsorted(np.rint(1e3 * log["time"]), ticks)
    assert len(rows) > 30
    for ours, loops in (
        ("matches", "matches"),
        ("inliers", "inliers"),
        ("off_tracking", "off_tracking_estimate"),
        ("off_tracking_std", "off_tracking_std"),
    ):
        expected = result.signal(loops)[delivered]
        np.testing.assert_allclose(log[ours][rows], expected, rtol=1e-6, atol=1e-9)
    assert np.isfinite(log["off_tracking"]).sum() > 5
    # the recording's poses are the truth: the trailer is dragged at a constant slip angle
    poses = log["off_tracking_poses"]
    assert poses[np.isfinite(poses)] == pytest.approx(result.signal("off_tracking_true")[-1], abs=1e-6)
    # a right camera that is not turned is found not to be: 0.02 deg are some five stated standard deviations
    told = CliRunner().invoke(app, ["off-tracking", "images", "--out", "b", "--no-video", "--json"])
    assert told.exit_code == 0, told.output
    angles = json.loads(told.stdout)["self_calibration"]
    assert max(abs(angles[f"{name}_deg"]) for name in ("roll", "yaw", "pitch")) < 0.02
    # how the cameras face is seen by how they move
    (tmp_path / "images" / "rig.toml").unlink()
    assert "cameras face to the rear, found from their motion (--facing)" in open_recording(tmp_path / "images").assumed


@pytest.mark.slow
@pytest.mark.usefixtures("worlds")
def test_a_turned_camera_is_found_and_logged() -> None:
    """Half the resolution of the usual rig: twice its errors, so 0.01 deg after 20 m."""
    turned = {"roll": -0.15, "yaw": 0.10, "pitch": 0.05}  # [deg]
    small = ("rig.width=672", "rig.height=240", "course.length=20", "world.scenery_density=0.5")
    settings = (*small, "rig.self_calibration=true", f"rig.misrotation_deg={[*turned.values()]}")
    log = run(load_scenario("constant-slip", settings), seed=2).log
    for name, true in turned.items():
        found, std = (log[f"right_camera_{name}{end}"] for end in ("", "_std"))
        last = np.flatnonzero(np.isfinite(found))[-1]
        assert abs(np.degrees(found[last]) - true) < 0.01
        assert 0.0 < np.degrees(std[last]) < 0.02
