"""Cameras as they are, light and faults from a scenario's keys to what the run sees."""

import math
import tomllib
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
import pytest

from offtrack.exchange.recordings.writers import RecordingWriter
from scenarios.assembly.adapters import rig_on, trailer_geometry
from scenarios.assembly.trailer_run import assemble
from scenarios.assembly.trailer_sensors import BoardCalibration, Views
from scenarios.loop.trailer_session import TrailerSession
from scenarios.options.scenario import Scenario, load_scenario
from scenarios.options.tables import RigOptions
from sensors.camera.rig import RawStereoRig, load_raw_rig
from sensors.camera.stereo_camera import RawStereoCamera, StereoCamera
from vehicle.combination.description import load_vehicle

pytestmark = pytest.mark.usefixtures("worlds")
SMALL = ("rig.width=336", "rig.height=200", "world.scenery_density=0.3", "course.length=20")
BARREL = "rig.distortion=[-0.15, 0.02, 0, 0, 0]"


def scenario(*settings: str) -> Scenario:
    other = any(setting.startswith("off_tracking=") for setting in settings)
    alone = () if other else ("viso_ot.fusion=none",)  # frames without signals
    return load_scenario("constant-slip", [*SMALL, *alone, *settings])


@pytest.mark.parametrize(
    ("text", "kind", "amount", "start", "duration"),
    [
        ("dropout", "dropout", (), 0.0, None),
        ("dropout:0.2", "dropout", (0.2,), 0.0, None),
        ("freeze@3", "freeze", (), 3.0, None),
        ("blackout@3.5+0.5", "blackout", (), 3.5, 0.5),
        ("sensors.faults.image_kinds:Dirt:0.2@5+1", "sensors.faults.image_kinds:Dirt", (0.2,), 5.0, 1.0),
        ("sensors.faults.image_kinds:Dirt@5", "sensors.faults.image_kinds:Dirt", (), 5.0, None),
        ("decalibration:-0.15,0.1,0@2", "decalibration", (-0.15, 0.1, 0.0), 2.0, None),
        ('[{kind = "dirt", amount = 0.4, duration = 2}]', "dirt", (0.4,), 0.0, 2.0),
        ('["desync:0.02"]', "desync", (0.02,), 0.0, None),
    ],
)
def test_faults_are_named_shortly_or_in_tables(
    text: str, kind: str, amount: tuple[float, ...], start: float, duration: float | None
) -> None:
    (fault,) = scenario(f"faults={text}").faults
    assert (fault.kind, fault.amount, fault.start, fault.duration) == (kind, amount, start, duration)


def test_several_faults_survive_being_written_down() -> None:
    first = scenario("faults=dropout:0.1; blackout@2+0.5", BARREL, "rig.misrotation_deg=[-0.15, 0.1, 0]")
    again = Scenario.model_validate(tomllib.loads(first.to_toml()))
    assert [fault.kind for fault in again.faults] == ["dropout", "blackout"]
    assert again == first
    assert scenario("faults=none").faults == ()


@pytest.mark.parametrize(("facing", "sideways"), [("rear", 0.0), ("down", 0.0), ("left", 1.0), ("right", -1.0)])
def test_cameras_at_the_sides_stand_on_the_edge_of_the_roof_that_they_look_over(
    facing: Literal["rear", "left", "right", "down"], sideways: float
) -> None:
    """In half-widths of the trailer, + left; on the opposite edge they would look across the roof."""
    vehicle = load_vehicle("eu_tractor_semitrailer")
    geometry = trailer_geometry(vehicle, 1)
    rig = rig_on(vehicle.units[1], geometry, RigOptions(facing=facing))
    assert rig.y == sideways * 0.5 * vehicle.units[1].width
    assert rig.x == (-0.5 if sideways else -1.0) * geometry.follow_distance
    assert rig.calibration().X_SC[1, 2] * rig.y >= 0.0  # the optical axis points outwards


@pytest.mark.slow
def test_perfect_cameras_stay_the_plain_ones() -> None:
    parts = assemble(scenario("rig.noise=1.5", "world.sun_elevation_deg=20", "world.scenery_density=0"), seed=1)
    assert parts.cameras is not None
    assert isinstance(parts.trailers[-1].sensing.sensor, StereoCamera)
    assert parts.cameras.rectifier is None
    parts.close()


def test_the_calibration_knows_the_lenses_but_not_how_the_mount_is_bent() -> None:
    """As if it had been made before the right camera was turned: the paper's field error."""
    parts = assemble(scenario(BARREL, "rig.misrotation_deg=[-0.15, 0.1, 0.05]"), seed=1)
    cameras = parts.cameras
    assert cameras is not None
    camera = parts.trailers[-1].sensing.sensor
    assert isinstance(camera, RawStereoCamera)
    true = camera.rig
    assert true.right.distortion == (-0.15, 0.02, 0.0, 0.0, 0.0)
    angle = math.acos(0.5 * (np.trace(true.X_ClCr[:3, :3]) - 1.0))
    assert math.degrees(angle) == pytest.approx(math.hypot(0.15, 0.1, 0.05), rel=1e-3)  # small angles add up as vectors
    assert cameras.calibrated is not true
    np.testing.assert_array_equal(cameras.calibrated.X_ClCr[:3, :3], np.eye(3))
    frame = camera.sample(parts.plant.observe(parts.plant.initial_state(parts.course.start, 5.0), 0))
    rectified = cameras.rectified(frame)
    assert rectified.left.shape == (cameras.calibration.height, cameras.calibration.width)
    assert not np.array_equal(rectified.left, frame.left)
    parts.close()


def test_a_run_with_lost_late_and_bent_images_is_recorded_as_it_was_seen(tmp_path: Path) -> None:
    """Lost frames are missing, late ones stand at their own time and place, and the file describes raw images."""
    settings = (BARREL, "faults=delay:2@0.5; dropout:0.2", "rig.latency=0.0")
    parts = assemble(scenario(*settings), seed=1)
    assert parts.cameras is not None
    folder = tmp_path / "recorded"
    with RecordingWriter(folder, parts.cameras.calibrated, parts.trailers[-1].geometry.follow_distance) as recorder:
        session = TrailerSession(parts, recorder=recorder)
        while session.tick < 2000:
            session.advance()
        session.close()
    parts.close()
    times = [float(line) for line in (folder / "times.txt").read_text(encoding="utf-8").split()]
    assert len(times) < 18
    assert times == sorted(set(times))
    assert max(times) <= 1.7 + 1e-9
    poses = np.loadtxt(folder / "poses.txt").reshape(-1, 3, 4)
    way = np.linalg.norm(poses[:, :, 3], axis=1)
    np.testing.assert_allclose(way, 5.0 * (np.array(times) - times[0]), atol=0.02)  # [m] 5 m/s; 0.1 s would be 0.5 m
    assert load_raw_rig(folder / "rig.toml").left.distortion == (-0.15, 0.02, 0.0, 0.0, 0.0)


def test_a_calibration_with_boards_is_what_the_estimator_works_with(monkeypatch: pytest.MonkeyPatch) -> None:
    """The calibration has a focal length 1 % too long, and one camera is bent afterwards."""
    taken: list[RawStereoRig] = []

    def said(true: RawStereoRig, **_: object) -> BoardCalibration:
        taken.append(true)
        left = replace(true.left, fx=1.01 * true.left.fx, fy=1.01 * true.left.fy)
        return BoardCalibration(replace(true, left=left, right=left), 0.05, 1e-4)

    monkeypatch.setattr("scenarios.assembly.trailer_sensors.calibrated_with_boards", said)
    parts = assemble(scenario("rig.calibration=boards", "rig.misrotation_deg=[0, 0.1, 0]"), seed=1)
    assert parts.cameras is not None
    try:
        exact = taken[0].left.fx
        assert parts.cameras.calibration.focal_length == pytest.approx(1.01 * exact)
        assert parts.cameras.rectifier is not None
        assert isinstance(parts.trailers[-1].sensing.sensor, RawStereoCamera)
        turned = parts.trailers[-1].sensing.sensor.rig.X_ClCr[:3, :3]
        assert np.array_equal(taken[0].X_ClCr[:3, :3], np.eye(3))
        assert math.acos(0.5 * (np.trace(turned) - 1.0)) == pytest.approx(math.radians(0.1), rel=1e-6)
    finally:
        parts.close()


@pytest.mark.parametrize("settings", [("traffic=following",), ("traffic.kind=following", "traffic.gap=9")])
def test_traffic_is_named_shortly_or_in_a_table(settings: tuple[str, ...]) -> None:
    first = scenario(*settings)
    assert first.traffic.kind == "following"
    assert (first.traffic.gap == 9.0) == (len(settings) == 2)
    assert Scenario.model_validate(tomllib.loads(first.to_toml())) == first


def test_traffic_is_in_the_pictures_of_a_run() -> None:
    hashes = set()
    for kind in ("none", "following"):
        session = TrailerSession(assemble(scenario(f"traffic={kind}"), seed=1))
        session.advance()
        hashes.add(session.pictures.sha256)
        session.close()
        session.parts.close()
    assert len(hashes) == 2


def test_a_part_that_does_not_fit_leaves_no_renderer_open(monkeypatch: pytest.MonkeyPatch) -> None:
    closed: list[str] = []
    close = Views.close

    def noted(views: Views) -> None:
        closed.append(views.renderer_name)
        close(views)

    monkeypatch.setattr(Views, "close", noted)
    with pytest.raises(ValueError, match="camera"):
        assemble(scenario("off_tracking=ground_watching", "sensor=stereo_camera"), seed=1)
    assert len(closed) == 1
    assert closed[0] != "none"
