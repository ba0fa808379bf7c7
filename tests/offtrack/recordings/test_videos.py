"""Stereo videos become recordings, and live sources a line per pair."""

import io
import json
from contextlib import closing
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import cv2
import numpy as np
import pytest

from estimators.estimates import Health
from offtrack.exchange.recordings.camera_files import MountingOptions
from offtrack.exchange.recordings.estimation import estimate_live
from offtrack.exchange.recordings.layouts import live
from offtrack.exchange.recordings.layouts.found import unpacked
from offtrack.exchange.recordings.layouts.live import Streams
from offtrack.exchange.recordings.layouts.videos import fits
from offtrack.exchange.recordings.stereo_reader import live_recording, open_recording
from scenarios.image_file import read_grey
from sensors.messages import GreyImage, StereoFrame

SIZE = (160, 96)
CALIBRATION = "P0: 90 0 80 0 0 90 47 0 0 0 1 0\nP1: 90 0 80 -36 0 90 47 0 0 0 1 0\n"


def picture(k: int, side: int) -> GreyImage:
    noise = np.random.default_rng(k).integers(0, 256, (12, 20), dtype=np.uint8)
    return np.roll(cv2.resize(noise, SIZE, interpolation=cv2.INTER_CUBIC), -8 * side, axis=1)


def video(path: Path, images: list[GreyImage]) -> Path:
    """Without loss."""
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"FFV1"), 20.0, images[0].shape[::-1])
    for image in images:
        writer.write(cv2.cvtColor(image, cv2.COLOR_GRAY2BGR))
    writer.release()
    return path


@pytest.mark.parametrize("together", [True, False])
def test_one_video_or_two_are_a_recording(tmp_path: Path, together: bool) -> None:
    pairs = [(picture(k, 0), picture(k, 1)) for k in range(4)]
    (tmp_path / "calib.txt").write_text(CALIBRATION, encoding="utf-8")
    if together:
        path = video(tmp_path / "drive.avi", [np.hstack(pair) for pair in pairs])
    else:
        path = tmp_path
        for k, side in enumerate(("left", "right")):
            video(path / f"{side}.avi", [pair[k] for pair in pairs])
    with unpacked(path) as (folder, notes):
        recording = open_recording(folder)
        assert [frame.tick for frame in recording.sequence.frames] == [0, 50, 100, 150]
        assert recording.size == SIZE
        for frame, (left, right) in zip(recording.sequence.frames, pairs, strict=True):
            assert np.abs(read_grey(frame.left).astype(int) - left).max() <= 2  # colour and back
            assert np.abs(read_grey(frame.right).astype(int) - right).max() <= 2
    assert ["left half" in note for note in notes] == [True] * together
    assert not folder.exists()


def test_a_video_without_times_of_its_own_has_those_of_its_rate(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As containers that hold raw streams."""
    path = video(tmp_path / "drive.avi", [np.hstack([picture(k, 0), picture(k, 1)]) for k in range(3)])
    genuine = cv2.VideoCapture

    class Untimed:
        def __init__(self, name: str) -> None:
            self._capture = genuine(name)

        def get(self, number: int) -> float:
            return 0.0 if number == cv2.CAP_PROP_POS_MSEC else self._capture.get(number)

        def __getattr__(self, name: str) -> Any:
            return getattr(self._capture, name)

    monkeypatch.setattr(cv2, "VideoCapture", Untimed)
    with unpacked(path) as (folder, notes):
        assert np.loadtxt(folder / "times.txt").tolist() == [0.0, 0.05, 0.1]
        assert "times are those of 20 frames a second" in notes


def test_what_is_no_video_is_refused(tmp_path: Path) -> None:
    (tmp_path / "x.mp4").write_bytes(b"none")
    assert not fits(tmp_path)
    with (
        pytest.raises(ValueError, match=r"^[^\n]*x\.mp4: 0 frames can be read"),
        unpacked(tmp_path / "x.mp4"),
    ):
        pass


class _Source:
    """States a grey level of the left image."""

    def init(self) -> int:
        return 0

    def step(self, memory: int, frame: StereoFrame) -> tuple[int, Any]:
        value = SimpleNamespace(value=0.001 * float(frame.left[0, 0]), std=0.01, health=Health.OK)
        return memory + 1, value if memory else None


class _Feed:
    """Pairs one after the other, then an interrupt."""

    def __init__(self, *pairs: tuple[GreyImage, GreyImage] | str) -> None:
        self._pairs = iter(pairs)

    def read(self) -> tuple[GreyImage, GreyImage] | str:
        for pair in self._pairs:
            return pair
        raise KeyboardInterrupt


def test_every_live_pair_is_a_line_and_a_lost_one_is_a_lost_estimate(tmp_path: Path) -> None:
    (tmp_path / "calib.txt").write_text(CALIBRATION, encoding="utf-8")
    recording = live_recording(tmp_path / "calib.txt", SIZE, MountingOptions(facing="front"))
    good, small = np.full(SIZE[::-1], 7, np.uint8), np.zeros((8, 8), np.uint8)
    feed, out = _Feed((good, good), "no image from 1", (small, small), (good, good)), io.StringIO()
    numbers = estimate_live(cast(Streams, feed), recording, cast(Any, _Source()), out)
    lines = [json.loads(line) for line in out.getvalue().splitlines()]
    assert [line["health"] for line in lines] == ["lost", "lost", "lost", "ok"]
    assert [line.get("reason") for line in lines] == [
        "first image",
        "no image from 1",
        "images are not of 160x96 px",
        None,
    ]
    assert (lines[3]["off_tracking_m"], lines[3]["std_m"]) == (0.007, 0.01)
    assert (numbers["pairs"], numbers["ok"], numbers["lost"]) == (4, 1, 3)


def test_sources_are_paired_by_their_arrival_and_opened_again_at_their_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two videos of half a second, played at their rate again and again: every pair is one."""
    monkeypatch.setattr(live, "_AGAIN", 0.1)
    images = [np.full((96, 160), 20 * k, np.uint8) for k in range(10)]
    names = [str(video(tmp_path / f"{side}.avi", images)) for side in ("left", "right")]
    with closing(Streams(*names)) as streams:
        read = [streams.read(10.0) for _ in range(15)]
    pairs = [pair for pair in read if not isinstance(pair, str)]
    assert len(pairs) >= 12
    together = sum(abs(int(left[0, 0]) - int(right[0, 0])) < 10 for left, right in pairs)
    assert together >= 0.7 * len(pairs)


def test_a_source_that_sends_nothing_is_named(tmp_path: Path) -> None:
    name = str(video(tmp_path / "left.avi", [picture(k, 0) for k in range(40)]))
    with closing(Streams(name, str(tmp_path / "none.avi"))) as streams:
        assert streams.read(0.3) == f"no image from {tmp_path / 'none.avi'}"
