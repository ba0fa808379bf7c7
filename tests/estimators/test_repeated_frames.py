"""Repeated frames, and recovery after them, for every odometry of the catalogue."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from estimators.context import Odometry
from estimators.estimates import Health, lost_motion
from estimators.odometry.repeated_frames import is_repeated, visible_noise
from sensors.messages import StereoFrame
from tests.estimators.stereo_scene import NOISE, Drive

STANDING = 43  # first frame of the drive that is where the one before was
OFF = {"viso2": 60e-3}  # error of a single motion at whole pixels [m]
FINE = 8e-3  # after an unseen metre [m]


def frozen(frames: list[StereoFrame], first: int, count: int) -> list[StereoFrame]:
    """Frames of which some show what the one before them shows."""
    repeated = [replace(frames[first - 1], tick=frame.tick) for frame in frames[first : first + count]]
    return [*frames[:first], *repeated, *frames[first + count :]]


def test_noise_is_seen_at_standstill_and_under_way(drive: Drive) -> None:
    """Mean difference of two normal numbers: 2 / sqrt(pi) standard deviations; the quietest cell has a little less."""
    expected = 2.0 / np.sqrt(np.pi) * NOISE
    for first in (20, STANDING):
        noise = visible_noise(drive.frames[first].left, drive.frames[first + 1].left)
        assert 0.7 * expected < noise < 1.1 * expected


def test_standstill_is_not_repeated(drive: Drive) -> None:
    """New noise, so a new image; the same noise again is the same image again."""
    one, other = (frame.left for frame in drive.frames[STANDING : STANDING + 2])
    still = replace(lost_motion(4300, 4200), health=Health.OK)
    assert not is_repeated(one, other, 2.0, still)
    assert is_repeated(one, one.copy(), 2.0, still)
    assert not is_repeated(one, one.copy(), 0.0, still)  # a camera without noise
    assert is_repeated(one, one.copy(), 0.0, None)


@pytest.mark.parametrize("count", [1, 4])
def test_freeze_is_lost_and_recovered_from_at_once(
    drive: Drive, odometry: Odometry[Any], name: str, count: int
) -> None:
    """The first new frame is measured from the last good one, over the whole gap."""
    frames = frozen(drive.frames[5:15], 4, count)
    motions = drive.run(odometry, frames)[1]
    assert [motion.health is Health.LOST for motion in motions] == [False] * 3 + [True] * count + [False] * (6 - count)
    after = motions[3 + count]
    assert (after.previous_tick, after.tick) == (800, 900 + 100 * count)
    assert np.abs(drive.errors(motions[3 + count :])[:, 3:]).max() < count * OFF.get(name, FINE)


def test_every_frame_twice_is_the_drive_itself(drive: Drive, odometry: Odometry[Any], name: str) -> None:
    """Copies are passed over; what is left is one motion for each frame, as good as ever."""
    frames = [replace(frame, tick=2 * frame.tick + 100 * k) for frame in drive.frames[5:10] for k in (0, 1)]
    motions = [motion for motion in drive.run(odometry, frames)[1] if motion.tick >= 1400]
    assert [motion.health is Health.LOST for motion in motions] == [False, True] * 3
    moved = [replace(one, tick=one.tick // 2, previous_tick=one.previous_tick // 2) for one in motions[::2]]
    assert np.abs(drive.errors(moved)[:, 3:]).max() < OFF.get(name, FINE)
