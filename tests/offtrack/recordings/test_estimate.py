"""Off-tracking from recordings: files, estimators of one's own, refusals, and the recording of a run."""

import csv
import importlib.util
import json
import math
import shutil
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pyarrow.parquet as pq
import pytest
from typer.testing import CliRunner, Result

from estimators.context import TrailerContext
from estimators.estimates import Health, Motion, OffTracking, lost_motion
from offtrack.commands.cli import app
from offtrack.exchange.recordings import stereo_sequence
from offtrack.exchange.recordings.stereo_reader import open_recording
from offtrack.exchange.recordings.writers import RecordingWriter, recording_in
from offtrack.reports.canvas import Picture
from offtrack.reports.film import Film
from scenarios.loop.runner import run
from scenarios.options.scenario import load_scenario
from scenarios.results.log import read_log
from scenarios.results.metrics import true_off_tracking
from sensors.camera.rig import StereoCalibration, StereoRig
from sensors.messages import StereoFrame
from tests import trailers
from vehicle.frames import FloatArray, inverse, rotation_zyx, transform
from vehicle.option import Option, option_values

RIG = StereoRig(facing="rear", width=160, height=96, hfov=math.radians(100), x=-10.0, y=0.0, z=3.0, baseline=0.5)
FOLLOW = 10.0  # [m]
FRAMES, STEP = 80, 0.5  # 40 m of way
WRITTEN = {
    "manifest.json",
    "off_tracking.csv",
    "off_tracking.parquet",
    "report.html",
    "summary.json",
    "trajectory_kitti.txt",
    "trajectory_tum.txt",
}


def trailer_pose(k: int) -> FloatArray:
    """Straight ahead, then a left turn of 20 m, the trailer pointing outwards by up to 0.1 rad: some off-tracking."""
    s = STEP * k
    turned = max(0.0, s - 15.0) / 20.0
    x, y = min(s, 15.0) + 20.0 * math.sin(turned), 20.0 * (1.0 - math.cos(turned))
    return transform(rotation_zyx(turned - 0.1 * math.sin(turned), 0.0, 0.0), np.array([x, y, 0.0]))


def textured(k: int, side: int) -> np.ndarray:
    """A distant wall; the right camera sees it 8 px further left."""
    noise = np.random.default_rng(k // 20).integers(0, 256, (RIG.height // 8, RIG.width // 8), dtype=np.uint8)
    return np.roll(cv2.resize(noise, (RIG.width, RIG.height), interpolation=cv2.INTER_CUBIC), -8 * side, axis=1)


@pytest.fixture(scope="module")
def original(tmp_path_factory: pytest.TempPathFactory) -> Path:
    directory = tmp_path_factory.mktemp("recordings") / "yard"
    with RecordingWriter(directory, RIG.calibration(), FOLLOW) as recording:
        for k in range(FRAMES):
            frame = StereoFrame(tick=100 * k, left=textured(k, 0), right=textured(k, 1))
            recording.add(frame, trailer_pose(k))
    return directory


@pytest.fixture
def drawn_yard(original: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A recording of one's own to break, in the working directory."""
    monkeypatch.chdir(tmp_path)
    return Path(shutil.copytree(original, tmp_path / "yard")).relative_to(tmp_path)


@pytest.fixture
def yard(drawn_yard: Path, undrawn: None) -> Path:
    """The same, for tests that do not look at the figures of a report."""
    return drawn_yard


class Oracle:
    """An odometry that knows the motion, but for what is asked to be wrong with it."""

    short = 0.0  # share of every translation that is missing
    lost: tuple[int, ...] = ()  # frames in which it is lost

    def __init__(self, calibration: StereoCalibration) -> None:
        self._X_SC = calibration.X_SC

    def init(self) -> None:
        return None

    def step(self, memory: int | None, frame: StereoFrame) -> tuple[int, Motion | None]:
        k = frame.tick // 100
        if memory is None:
            return k, None
        X_PC = inverse(trailer_pose(memory) @ self._X_SC) @ trailer_pose(k) @ self._X_SC
        X_PC[:3, 3] *= 1.0 - self.short
        lost, inliers = lost_motion(frame.tick, 100 * memory), 240 + k % 40  # most of them in images 39 and 79
        tracks, covariance = np.full((inliers, 4), 30.0, np.float32), np.diag([1e-10] * 3 + [1e-6] * 3)
        known: dict[str, Any] = {
            "X_PC": X_PC,
            "covariance": covariance,
            "tracks": tracks,
            "matches": 300,
            "inliers": inliers,
        }
        return k, lost if k in self.lost else replace(lost, **known, health=Health.OK)


class ShortOracle(Oracle):
    short = 0.01


class LosingOracle(Oracle):
    lost = (40, 41)


class HeldValue:
    """An off-tracking estimator that knows no motions: every second estimate is the constant of its option."""

    sensor = "stereo_camera"
    options = (Option("value", 0.1, "off-tracking", "m", low=-1.0, high=1.0),)

    def __init__(self, value: float, follow_distance: float) -> None:
        self.value, self.follow_distance = value, follow_distance

    @classmethod
    def of(cls, context: TrailerContext) -> "HeldValue":
        assert context.roll_axis_height == 0.0
        assert context.odometry is not None
        return cls(float(option_values(cls.options, context.options, "estimator")["value"]), context.follow_distance)

    def init(self) -> int:
        return 0

    def step(self, memory: int, frame: StereoFrame) -> tuple[int, OffTracking | None]:
        if self.value < 0.0:
            raise RuntimeError("no such off-tracking")
        if memory % 2 == 0:
            return memory + 1, None
        path = np.array([[0.0, 0.0], [-self.follow_distance, self.value]])
        return memory + 1, trailers.estimate(frame.tick, value=self.value, path=path)


class OfPoses(HeldValue):
    sensor = "reference_pose"


@pytest.fixture(autouse=True)
def importable(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "oracles", sys.modules[__name__])


def estimated(*arguments: str | Path, odometry: str = "oracles:Oracle") -> Result:
    return CliRunner().invoke(app, ["estimate", "off-tracking", *map(str, arguments), "--odometry", odometry])


def numbers(*arguments: str | Path, odometry: str = "oracles:Oracle") -> dict[str, Any]:
    result = estimated(*arguments, "--out", "out", "--json", odometry=odometry)
    assert result.exit_code == 0, result.output
    found: dict[str, Any] = json.loads(result.stdout)
    return found


def rows(out: Path = Path("out")) -> list[dict[str, str]]:
    with (out / "off_tracking.csv").open(encoding="utf-8") as file:
        return list(csv.DictReader(file))


@pytest.fixture(scope="module")
def perfect(original: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    out = tmp_path_factory.mktemp("results") / "out"
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(sys.modules, "oracles", sys.modules[__name__])
        result = estimated(original, "--out", out, "--json", "--no-video")
    assert result.exit_code == 0, result.output
    return out, json.loads(result.stdout)


@pytest.mark.slow
def test_everything_is_written_and_agrees(perfect: tuple[Path, dict[str, Any]]) -> None:
    """The off-tracking is that of the poses, and all files tell the same; every column of the Parquet has its unit.

    Images without texture tell nothing of the right camera: what is assumed before any stands in all files.
    """
    out, found = perfect
    assert {path.name for path in out.iterdir()} == WRITTEN
    assert json.loads((out / "summary.json").read_text(encoding="utf-8")) == found
    assert found["outcome"] == "completed"
    assert found["frames"] == {"total": FRAMES, "used": FRAMES, "dropped": 0, "duration_s": 7.9}
    assert found["off_tracking"]["estimate_error_max_m"] < 1e-6  # poses are written with twelve digits
    assert found["off_tracking"]["valid_fraction"] == 1.0
    log, table = read_log(out / "off_tracking.parquet"), rows(out)
    assert len(table) == len(log) == FRAMES
    value = np.array([float(row["off_tracking_m"] or "nan") for row in table])
    np.testing.assert_allclose(value, log["off_tracking"], atol=1e-6)  # micrometres are written
    assert [row["health"] for row in table] == [
        "" if k == 0 else "lost" if np.isnan(v) else "ok" for k, v in enumerate(value)
    ]
    schema = pq.read_schema(out / "off_tracking.parquet")
    units = {field.name: field.metadata[b"unit"].decode() for field in schema}
    assert units["off_tracking"] == units["off_tracking_std"] == "m"
    assert set(units.values()) == {"-", "s", "m", "rad", "m/s", "rad/s"}
    calibrated = found["self_calibration"]
    assert [calibrated[f"{name}_deg"] for name in ("roll", "yaw", "pitch")] == [0.0, 0.0, 0.0]
    assert calibrated["yaw_std_deg"] == pytest.approx(0.4, abs=0.01)
    assert calibrated["delay_std_ms"] == pytest.approx(20.0, abs=0.1)
    assert found["warnings"] == []
    assert float(table[1]["right_yaw_rad"]) == 0.0
    report = (out / "report.html").read_text(encoding="utf-8")
    assert "Rotation of the right camera" in report


def test_off_tracking_is_that_of_the_hitch_path(perfect: tuple[Path, dict[str, Any]]) -> None:
    """Against the closed search on the true path: samples 0.5 m apart on 20 m leave cubics of some 0.01 mm."""
    log = read_log(perfect[0] / "off_tracking.parquet")
    poses = np.array([trailer_pose(k) for k in range(FRAMES)])
    psi = np.arctan2(poses[:, 1, 0], poses[:, 0, 0])
    true = true_off_tracking(poses[:, 0, 3], poses[:, 1, 3], psi, FOLLOW)
    there = np.isfinite(log["off_tracking"]) & np.isfinite(true)
    assert there.sum() > 50
    assert np.abs(true[there]).max() > 1.0  # it cuts in by more than a metre: there is something to see
    np.testing.assert_allclose(log["off_tracking"][there], true[there], atol=2e-3)  # where the curvature jumps


def test_trajectories_are_those_of_the_camera(perfect: tuple[Path, dict[str, Any]], original: Path) -> None:
    """KITTI: a line a frame, equal to the recording's poses; TUM: time, position, quaternion."""
    kitti, poses = np.loadtxt(perfect[0] / "trajectory_kitti.txt"), np.loadtxt(original / "poses.txt")
    np.testing.assert_allclose(kitti, poses, atol=1e-9)  # sums of 80 rounded poses of twelve digits
    tum = np.loadtxt(perfect[0] / "trajectory_tum.txt")
    np.testing.assert_allclose(tum[:, 0], np.loadtxt(original / "times.txt"))
    np.testing.assert_allclose(tum[:, 1:4], poses.reshape(-1, 3, 4)[:, :, 3], atol=1e-8)
    np.testing.assert_allclose(np.linalg.norm(tum[:, 4:], axis=1), 1.0, atol=1e-8)


def test_an_estimator_of_ones_own_works_on_a_recording(yard: Path) -> None:
    """Its options come from ``--set``; what it was given of the trailer is said; nothing is made up for motions."""
    summary = numbers(yard, "--no-video", "--estimator", "oracles:HeldValue", "--set", "estimator.value=0.25")
    assert summary["estimator"] == "oracles:HeldValue"
    assert summary["off_tracking"]["max_m"] == 0.25
    assert "data sheet for the estimator: uk_longer_semitrailer (--vehicle)" in summary["assumed"]
    assert summary["notes"][-1] == "the estimator states no motions of the cameras: there is no trajectory"
    assert {row["off_tracking_m"] for row in rows()} == {"", "0.250000"}
    assert {path.name for path in Path("out").iterdir()} == WRITTEN - {"trajectory_kitti.txt", "trajectory_tum.txt"}


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["oracles:HeldValue", "--set", "estimator.value=7"], "estimator.value = 7"),
        (["oracles:HeldValue", "--set", "value=0.2"], "expected estimator.NAME=VALUE"),
        (["oracles:HeldValue", "--set", "estimator.size=1"], "size"),
        (["oracles:HeldValue", "--vehicle", "gb_rigid"], "gb_rigid"),
        (["oracles:OfPoses"], "needs the sensor reference_pose: a recording holds the images of a stereo camera only"),
        (["oracles:HeldValue", "--set", "estimator.value=-0.5"], "test_estimate.py, line "),
    ],
)
def test_an_estimator_that_does_not_fit_is_refused_in_one_line(yard: Path, arguments: list[str], says: str) -> None:
    result = estimated(yard, "--no-video", "--out", "out", "--estimator", *arguments)
    assert result.exit_code == 2
    (line,) = result.stderr.splitlines()
    assert says in line
    assert not Path("out").exists()


def test_drift_is_compared_with_the_poses(yard: Path) -> None:
    """1 % short: 1 % over a trailer's length in every direction; 100 m were not driven, so KITTI has no figure."""
    found = numbers(yard, "--no-video", odometry="oracles:ShortOracle")
    assert found["odometry"]["drift_percent"] == pytest.approx(1.0, abs=0.06)  # 10.5 m driven for 10 m asked
    assert found["kitti"] == {"drift_percent": None, "drift_deg_per_m": None, "lengths_m": [], "subsequences": 0}
    assert found["off_tracking"]["estimate_error_rms_m"] > 1e-3


def test_poses_with_which_the_motions_hardly_agree_are_doubted(yard: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As with a focal length 20 % too long."""
    monkeypatch.setattr(ShortOracle, "short", -0.2)
    found = numbers(yard, "--no-video", odometry="oracles:ShortOracle")
    assert ["motions differ from those of poses.txt" in line for line in found["warnings"]] == [True]


def test_odometry_is_compared_with_itself(yard: Path) -> None:
    """An oracle knows the way forwards alone: halves agree exactly, backwards nothing does."""
    found = numbers(yard, "--no-video", "--agreement")
    assert found["agreement"]["halves_rms_sigma"] == pytest.approx(0.0, abs=1e-6)
    assert found["agreement"]["backwards_rms_sigma"] > 10.0
    assert found["odometry"]["motion_nees_mean"] == pytest.approx(0.0, abs=1e-6)


def test_broken_and_missing_images_are_dropped_frames_and_the_run_goes_on(yard: Path) -> None:
    """Named in the table on the terminal, in the summary, in the report; the estimate goes on without them."""
    left = yard / "image_0"
    (left / "000030.png").write_bytes((left / "000030.png").read_bytes()[:300])
    (yard / "image_1" / "000045.png").unlink()
    result = estimated(yard, "--out", "out", "--no-video")
    assert result.exit_code == 0, result.output
    lines = result.stdout.splitlines()
    assert f"Frame 30 dropped: {yard}/image_0/000030.png is corrupt or not an image" in lines
    assert f"Frame 45 dropped: {yard}/image_1/000045.png is missing" in lines
    found = json.loads(Path("out/summary.json").read_text(encoding="utf-8"))
    assert found["frames"]["dropped"] == 2
    assert [entry["frame"] for entry in found["dropped_frames"]] == [30, 45]
    assert found["off_tracking"]["estimate_error_max_m"] < 2e-3  # the path between two frames 1 m apart is a cubic
    assert "000030.png is corrupt" in Path("out/report.html").read_text(encoding="utf-8")
    assert [k for k, row in enumerate(rows()) if row["health"] == "dropped"] == [30, 45]
    assert len(np.loadtxt("out/trajectory_kitti.txt")) == FRAMES
    used = [k for k in range(FRAMES) if k not in (30, 45)]
    true = np.loadtxt(yard / "poses.txt")[used].reshape(-1, 3, 4)[:, :, 3]
    np.testing.assert_allclose(np.loadtxt("out/trajectory_tum.txt")[:, 1:4], true, atol=1e-8)


def test_lost_frames_are_told_and_bridged(yard: Path) -> None:
    found = numbers(yard, "--no-video", odometry="oracles:LosingOracle")
    assert found["odometry"]["lost_frames"] == 2
    health = [row["health"] for row in rows()]
    assert health[39:44] == ["ok", "lost", "lost", "degraded", "degraded"]
    assert health[-1] == "ok"


def test_times_are_kept_and_a_broken_first_frame_is_no_obstacle(yard: Path) -> None:
    """Seconds since 1970 stay what they are in the files, and count from zero in the figures.

    The path begins with the first frame that can be read.
    """
    (yard / "image_0" / "000000.png").write_bytes(b"")
    (yard / "times.txt").write_text("".join(f"{1403636579.7 + 0.1 * k:.3f}\n" for k in range(FRAMES)), encoding="utf-8")
    found = numbers(yard, "--no-video")
    assert found["frames"]["duration_s"] == pytest.approx(7.9)
    assert found["frames"]["dropped"] == 1
    assert found["off_tracking"]["estimate_error_max_m"] < 2e-3
    assert np.loadtxt("out/trajectory_tum.txt")[0, 0] == pytest.approx(1403636579.8, abs=1e-3)
    assert rows()[0]["time_s"] == "1403636579.700000"


@pytest.mark.slow
def test_what_the_recording_does_not_say_is_assumed_aloud_and_options_leave_nothing_to_assume(drawn_yard: Path) -> None:
    """A bare KITTI folder runs; the assumptions stand on the terminal, in the summary and on top of the report.

    Said again what the rig said, the result is the same. Without poses nothing is compared.
    """
    (drawn_yard / "rig.toml").unlink()
    result = estimated(drawn_yard, "--out", "bare", "--no-video", "--facing", "rear")
    assert result.exit_code == 0, result.output
    assert "Assumed: follow point 14 m behind the hitch (--follow-distance)" in result.stdout.splitlines()
    assert "Assumed" in Path("bare/report.html").read_text(encoding="utf-8")
    off_tracking = json.loads(Path("bare/summary.json").read_text(encoding="utf-8"))["off_tracking"]
    assert off_tracking["direction_std_m"] > 14.0 * math.radians(0.1)  # unknown mount, and the principal point
    parts = off_tracking["direction_std_m"], off_tracking["motion_std_mean_m"]
    assert off_tracking["std_mean_m"] == pytest.approx(math.hypot(*parts), rel=0.01)
    said = ("--facing", "rear", "--follow-distance", "10", "--camera-x", "-10", "--camera-height", "3")
    found = numbers(drawn_yard, "--no-video", *said, "--direction-std", "0")
    assert (found["assumed"], found["follow_distance_m"]) == ([], 10.0)
    assert found["off_tracking"]["estimate_error_max_m"] < 1e-6
    (drawn_yard / "poses.txt").unlink()
    shutil.rmtree("out")
    found = numbers(drawn_yard, "--no-video", *said)
    assert (found["off_tracking"]["estimate_error_rms_m"], found["odometry"]["drift_percent"]) == (None, None)
    assert found["off_tracking"]["rms_m"] > 0.1
    assert "recorded poses" not in Path("out/report.html").read_text(encoding="utf-8")


@pytest.mark.parametrize("frames", [0, 50])
def test_an_interrupt_keeps_what_is_finished(yard: Path, frames: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """All files for the frames so far, exit code 130, no video; the next command takes their place."""
    genuine, read = stereo_sequence.read_frame, []

    def interrupted_at(files: Any, size: Any) -> Any:
        read.append(files)
        if len(read) > frames:
            raise KeyboardInterrupt  # comes out of the future where the loop asks for it
        return genuine(files, size)

    with monkeypatch.context() as patch:
        patch.setattr(stereo_sequence, "read_frame", interrupted_at)
        result = estimated(yard, "--out", "out", "--quiet")
    assert (result.exit_code, result.stdout) == (130, "")
    assert result.stderr == "offtrack: interrupted; what was estimated until then is in out\n"
    assert {path.name for path in Path("out").iterdir()} == WRITTEN | {".interrupted"}
    found = json.loads(Path("out/summary.json").read_text(encoding="utf-8"))
    assert found["outcome"] == "interrupted"
    assert frames - 10 <= found["frames"]["used"] == len(rows()) <= frames + 3  # looked at before, not read again
    assert found["frames"]["total"] == FRAMES
    for side in (0, 1):
        for k in range(1, FRAMES):
            (yard / f"image_{side}" / f"{k:06d}.png").unlink()
    found = numbers(yard)  # of a frame, which has no motion yet
    assert (found["frames"]["used"], found["off_tracking"]["rms_m"], len(rows())) == (1, None, 1)


@pytest.mark.slow
@pytest.mark.skipif(not importlib.util.find_spec("av"), reason="needs the extra 'video'")
def test_the_video_has_a_picture_for_every_frame_in_real_time(yard: Path) -> None:
    import av

    (yard / "image_0" / "000010.png").write_bytes(b"")
    numbers(yard)
    with av.open("out/video.mp4") as container:
        stream = container.streams.video[0]
        assert stream.average_rate == 10
        assert sum(1 for _ in container.decode(video=0)) == FRAMES


@pytest.mark.slow
@pytest.mark.skipif(not importlib.util.find_spec("av"), reason="needs the extra 'video'")
def test_an_interrupt_while_the_video_is_drawn_keeps_the_estimates(yard: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """They are complete by then; what there is of the video plays."""
    import av

    genuine = Film.picture

    def picture(self: Film, now: float) -> Picture:
        if now > 5.95:
            raise KeyboardInterrupt
        return genuine(self, now)

    monkeypatch.setattr(Film, "picture", picture)
    assert estimated(yard, "--out", "out", "--quiet").exit_code == 130
    found = json.loads(Path("out/summary.json").read_text(encoding="utf-8"))
    assert (found["outcome"], found["frames"]["used"]) == ("interrupted", FRAMES)
    with av.open("out/video.mp4") as container:
        assert sum(1 for _ in container.decode(video=0)) > 10  # the encoder holds some back


@pytest.mark.slow
def test_a_recorded_run_gives_the_estimates_of_its_loop(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The same images, calibration and odometry: equal but for the twelve digits of the focal length in calib.txt."""
    monkeypatch.chdir(tmp_path)
    length = ["course.length=20", "rig.width=640", "rig.height=200", "world.scenery_density=0.3"]
    result = run(load_scenario("constant-slip", length), 1, record=recording_in(tmp_path / "images"))
    options = ["--out", "out", "--no-video", "--quiet", "--no-self-calibration"]  # as in the run
    ended = CliRunner().invoke(app, ["estimate", "off-tracking", "images", *options])
    assert ended.exit_code == 0, ended.output
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
    ended = CliRunner().invoke(app, ["estimate", "off-tracking", "images", "--out", "b", "--no-video", "--json"])
    assert ended.exit_code == 0, ended.output
    angles = json.loads(ended.stdout)["self_calibration"]
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


@pytest.mark.parametrize("exchanged", [True, False])
def test_a_lost_drive_leads_with_a_warning_and_claims_nothing(drawn_yard: Path, exchanged: bool) -> None:
    """Of images whose sides are exchanged, and of frames that have nothing in common."""
    for k in range(FRAMES):
        left, right = (drawn_yard / f"image_{side}" / f"{k:06d}.png" for side in (0, 1))
        if exchanged:
            left.rename(drawn_yard / "left.png")
            right.rename(left)
            (drawn_yard / "left.png").rename(right)
        else:
            for path, side in ((left, 0), (right, 1)):
                cv2.imwrite(str(path), textured(20 * k, side))
    (drawn_yard / "rig.toml").unlink()
    found = numbers(drawn_yard, "--no-video", odometry="keyframe")
    assert found["warnings"][0].startswith(f"{FRAMES - 1} of {FRAMES - 1} frames gave no motion")
    assert any("exchanged" in line for line in found["warnings"]) == exchanged
    assert found["odometry"]["drift_percent"] is None
    assert not any("found from their motion" in line for line in found["assumed"])
