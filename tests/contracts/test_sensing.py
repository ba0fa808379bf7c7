"""What every odometry and every off-tracking source of the catalogue must keep, on rendered frames."""

from __future__ import annotations

import pickle
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from estimators.estimates import Health
from scenarios.assembly.trailer import Assembly, assemble
from scenarios.catalogue import ODOMETRY, OFF_TRACKING, resolve
from scenarios.options.scenario import load_scenario
from sensors.instruments.navigation import ExactPose
from sensors.messages import BodyPose, StereoFrame
from vehicle.combination.plant import VehicleCommand

FRAMES = 8  # too few to fill the buffer at 0.5 m each, enough for a steady odometry
STEP = 0.5  # 5 m/s at 10 Hz [m]
# Share of the step that an increment may be off. A tenth of 2 % would already be a millimetre a frame. VISO2-S matches
# whole pixels: 2.44 % of the distance (de Saxe 2018, section 2.1), and here of images of half the size, twice that.
ACCURACY = {"circular": 0.02, "keyframe": 0.02, "viso2": 0.05}
SETTINGS = ("rig.width=672", "rig.height=240", "world.scenery_density=0.5")


@pytest.fixture(scope="module")
def parts() -> Iterator[Assembly]:
    assembly = assemble(load_scenario("constant-slip", SETTINGS), seed=3)
    yield assembly
    assert assembly.cameras is not None
    assembly.cameras.renderer.close()


def driven(parts: Assembly) -> tuple[list[StereoFrame], list[BodyPose]]:
    """What the cameras and an exact reference unit say of a short drive; the renderer is closed after it."""
    assert parts.cameras is not None
    state = parts.motive.initial_state(parts.course.start, parts.scenario.speed)
    frames, poses = [], []
    for k in range(FRAMES):
        truth = parts.motive.observe(state, 100 * k)
        frame = parts.sensor.sample(truth)
        assert isinstance(frame, StereoFrame)
        frames.append(frame)
        poses.append(ExactPose(parts.trailer_unit).sample(truth))
        state = parts.motive.step(state, VehicleCommand(0.0, 0.0, (0.0, 0.0)), 100)
    parts.cameras.renderer.close()
    return frames, poses


@pytest.fixture(scope="module")
def messages(parts: Assembly) -> tuple[list[StereoFrame], list[BodyPose]]:
    return driven(parts)


@pytest.fixture(scope="module")
def under_the_trailer(messages: Any) -> tuple[Assembly, list[StereoFrame]]:
    """The same drive with downward cameras; there is one renderer at a time, so it waits for the other one's end."""
    settings = [*SETTINGS, "world.scenery_density=0", "off_tracking=ground_watching"]
    assembly = assemble(load_scenario("constant-slip", settings), seed=3)
    return assembly, driven(assembly)[0]


@pytest.fixture(params=sorted(ODOMETRY))
def odometry_name(request: pytest.FixtureRequest) -> str:
    name: str = request.param
    return name


@pytest.fixture
def odometry(odometry_name: str, parts: Assembly) -> Any:
    return resolve("odometry", odometry_name, ODOMETRY)(parts.cameras.calibration)


def motions(odometry: Any, frames: list[StereoFrame]) -> list[Any]:
    memory, found = odometry.init(), []
    for frame in frames:
        memory, motion = odometry.step(memory, frame)
        found.append(motion)
    return found


def test_odometry_measures_the_step_between_frames(odometry: Any, odometry_name: str, messages: Any) -> None:
    """Half a metre a frame, every one of them."""
    first, *others = motions(odometry, messages[0])
    assert first is None
    for motion in others:
        assert motion.health is not Health.LOST
        assert np.linalg.norm(motion.X_PC[:3, 3]) == pytest.approx(STEP, rel=ACCURACY[odometry_name])
        assert (np.linalg.eigvalsh(motion.covariance) > 0.0).all()
        assert motion.inliers <= motion.matches
        assert motion.tracks.shape == (motion.inliers, 4)


def test_odometry_is_deterministic_and_its_memory_travels(odometry: Any, messages: Any) -> None:
    """The same frames give the same motion to the bit, also through a pickled memory."""
    frames = messages[0]
    memory, _ = odometry.step(odometry.init(), frames[0])
    memory, _ = odometry.step(memory, frames[1])
    _, motion = odometry.step(memory, frames[2])
    _, again = odometry.step(pickle.loads(pickle.dumps(memory)), frames[2])
    np.testing.assert_array_equal(motion.X_PC, again.X_PC)
    np.testing.assert_array_equal(motion.covariance, again.covariance)


def test_a_blinded_camera_is_lost_and_found_again(odometry: Any, messages: Any) -> None:
    """A black frame carries no motion: it must say so, finitely, and the frames after it must work."""
    frames = list(messages[0])
    black = np.zeros_like(frames[4].left)
    frames[4] = replace(frames[4], left=black, right=black)
    found = motions(odometry, frames)
    assert found[4].health is Health.LOST
    assert np.isfinite(found[4].X_PC).all()
    assert found[-1].health is not Health.LOST
    assert np.isfinite(found[-1].X_PC).all()


# kinematic works on signals, not on images: tests/estimators/test_kinematic.py
@pytest.mark.parametrize("name", sorted(OFF_TRACKING.keys() - {"kinematic"}))
def test_a_source_knows_nothing_before_a_trailer_length_is_travelled(
    name: str, parts: Assembly, messages: Any, under_the_trailer: Any
) -> None:
    """4 m of path do not reach back 14 m: the value is 0 and lost, not a guess; the path is what there is."""
    build = resolve("off_tracking", name, OFF_TRACKING)
    frames, poses = messages
    if build.reads == "poses":
        own_errors = [np.random.default_rng(3)] if getattr(build, "random", False) else []
        source, given = build(parts.trailer.follow_distance, *own_errors), poses
    elif build.reads == "ground":
        assembly, given = under_the_trailer
        source = build(assembly.cameras.calibration, parts.trailer.follow_distance)
    else:
        odometry = resolve("odometry", parts.scenario.odometry, ODOMETRY)(parts.cameras.calibration)
        source, given = build(parts.cameras.calibration, parts.trailer.follow_distance, odometry), frames
    memory = source.init()
    for message in given:
        memory, estimate = source.step(memory, message)
        if estimate is not None:
            off_tracking = getattr(estimate, "off_tracking", estimate)
            assert off_tracking.tick == message.tick
            assert off_tracking.health is Health.LOST
            assert off_tracking.value == 0.0
    way = (FRAMES - 1) * STEP
    assert np.linalg.norm(off_tracking.path[-1]) == pytest.approx(way, rel=0.02)
    assert off_tracking.v_x == pytest.approx(5.0 * np.cos(np.radians(14.0)), rel=0.02)
