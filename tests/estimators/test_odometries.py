"""Every odometry of the catalogue on good, bad and missing views: synthetic ones, with exact truth."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from estimators.context import Odometry
from estimators.estimates import Health, Motion
from scenarios.catalogue import ODOMETRY, resolve
from sensors.camera.rig import StereoCalibration
from tests.estimators.stereo_scene import Drive

# Whole pixels are no better, and match fewer features than a view in good health has.
OFF = {"viso2": 60e-3}  # that a single motion may be [m]
FINE = 5e-3


def states(name: str, motions: list[Motion]) -> list[str]:
    """Lost, or found: in good health, of an odometry from which that can be asked."""
    found = (Health.OK, Health.DEGRADED) if name in OFF else (Health.OK,)
    return ["found" if motion.health in found else motion.health.value for motion in motions]


def test_first_motion_is_found_from_rest(drive: Drive, name: str, odometry: Odometry[Any]) -> None:
    """No prediction yet, and 1.5 m with 6 deg to go."""
    motions = drive.run(odometry, drive.frames[30:34:3])[1]
    assert states(name, motions) == ["found"]
    assert np.linalg.norm(drive.errors(motions)[0, 3:]) < OFF.get(name, FINE)


def test_dark_frame_is_lost_and_passed_over(drive: Drive, name: str, odometry: Odometry[Any]) -> None:
    """No texture, no information: identity, infinitely uncertain; the next motion starts before the gap."""
    frames = list(drive.frames[20:28])
    frames[4] = drive.dark(frames[4])
    motions = drive.run(odometry, frames)[1]
    assert states(name, motions) == ["found"] * 3 + ["lost"] + ["found"] * 3
    lost, after = motions[3], motions[4]
    assert np.array_equal(lost.X_PC, np.eye(4))
    assert np.all(np.isinf(np.diag(lost.covariance)))
    assert (lost.previous_tick, lost.tick) == (2300, 2400)
    assert (after.previous_tick, after.tick) == (2300, 2500)
    assert np.abs(drive.errors(motions[4:])[:, 3:]).max() < OFF.get(name, FINE)
    assert np.abs(drive.normalised(motions[4:])).max() < 5.0


def test_long_darkness_ends(drive: Drive, name: str, odometry: Odometry[Any]) -> None:
    """Dark for longer than the ground can be recognised over: it starts again with the first light."""
    frames = [*drive.frames[10:13], *(drive.dark(frame) for frame in drive.frames[13:22]), *drive.frames[22:26]]
    motions = drive.run(odometry, frames)[1]
    assert states(name, motions[2:]) == ["lost"] * 10 + ["found"] * 3
    assert motions[12].previous_tick == 2200


def test_starting_in_the_dark_recovers(drive: Drive, name: str, odometry: Odometry[Any]) -> None:
    """A first frame without texture must not stay the one that all others are compared with."""
    motions = drive.run(odometry, [drive.dark(drive.frames[0]), *drive.frames[1:4]])[1]
    assert states(name, motions) == ["lost", "found", "found"]


def test_frame_from_elsewhere_is_lost_and_recovered_from(drive: Drive, name: str, odometry: Odometry[Any]) -> None:
    """Textured, but of another place: nothing agrees, and the odometry says so and goes on from there."""
    other = drive.frames[40]
    strange = replace(drive.frames[5], left=np.fliplr(other.left).copy(), right=np.fliplr(other.right).copy())
    motions = drive.run(odometry, [*drive.frames[2:5], strange, *drive.frames[6:9]])[1]
    assert states(name, motions) == ["found"] * 2 + ["lost"] * 2 + ["found"] * 2


def test_few_features_degrade(drive: Drive, odometry: Odometry[Any]) -> None:
    """Dirt over most of both lenses: still a motion, but it is not to be trusted as much, and it says how much."""
    frames = []
    for frame in drive.frames[15:19]:
        left, right = np.full_like(frame.left, 90), np.full_like(frame.right, 90)
        left[:, 500:800], right[:, 460:800] = frame.left[:, 500:800], frame.right[:, 460:800]
        frames.append(replace(frame, left=left, right=right))
    motions = drive.run(odometry, frames)[1]
    clear = drive.run(odometry, drive.frames[15:19])[1]
    for motion, reference in zip(motions, clear, strict=True):
        assert motion.health is Health.DEGRADED
        assert motion.matches < 250
        assert np.all(np.diag(motion.covariance) > 1.5 * np.diag(reference.covariance))
    assert np.abs(drive.normalised(motions)).max() < 5.0


def test_step_is_pure_and_repeatable(drive: Drive, name: str, odometry: Odometry[Any]) -> None:
    """The same memory and frame give the same motion, bit by bit, however often they are used."""
    memory, _ = drive.run(odometry, drive.frames[:4])
    results = [odometry.step(memory, drive.frames[4])[1] for _ in range(2)]
    another = resolve("odometry", name, ODOMETRY)(drive.calibration)
    results.append(drive.run(another, drive.frames[:5])[1][-1])
    first = results[0]
    assert first is not None
    for result in results[1:]:
        assert result is not None
        assert np.array_equal(result.X_PC, first.X_PC)
        assert np.array_equal(result.covariance, first.covariance)
        assert np.array_equal(result.tracks, first.tracks)


def test_camera_must_be_above_the_ground(name: str, calibration: StereoCalibration) -> None:
    """Its height is where the first guess of the disparities comes from."""
    with pytest.raises(ValueError, match="must be positive"):
        resolve("odometry", name, ODOMETRY)(replace(calibration, X_SC=np.eye(4)))
