"""Videos play, show what they should, and are drawn fast enough."""

import dataclasses
import importlib.util
import time
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from offtrack.reports.canvas import ESTIMATED, INK, TRUE, Picture, nice_step, write_video
from offtrack.reports.film import Film, camera_picture
from offtrack.reports.player.playback import Picture as Shot
from offtrack.reports.player.playback import trailer_playback
from offtrack.reports.run_files import FilmAlong
from scenarios.progress import no_progress
from scenarios.results.log import Log
from scenarios.results.trailer_result import RunResult

TIMES = np.arange(0.0, 60.0, 0.1)  # [s]
NO_STROKES = np.empty((0, 4), np.float32)


def first_seconds(run: RunResult, seconds: float) -> RunResult:
    return dataclasses.replace(run, log=Log(run.log.signals, run.log.rows[: round(100 * seconds)]))


def still(run: RunResult, now: float) -> Picture:
    return Film(trailer_playback(run)).picture(now)


def colour_count(picture: Picture, colour: tuple[int, int, int]) -> int:
    return int(np.sum(np.all(picture == colour, axis=-1)))


@pytest.mark.skipif(not importlib.util.find_spec("av"), reason="needs the extra 'video'")
def test_a_video_is_drawn_along_with_its_run(camera_run: RunResult, tmp_path: Path) -> None:
    """The last 3 s of a snapshot wait for the next one; of an interrupted run they are not drawn."""
    for outcome, pictures in (("completed", 61), ("interrupted", 20)):
        film = FilmAlong(tmp_path, duration=10.0)
        film.step(lambda: first_seconds(camera_run, 5.0))
        while film.drawn < 20:
            time.sleep(0.01)
        film.end(dataclasses.replace(first_seconds(camera_run, 6.01), outcome=outcome))
        assert (film.path(no_progress, 61), film.drawn) == (tmp_path / "video.mp4", pictures)


@pytest.mark.skipif(not importlib.util.find_spec("av"), reason="needs the extra 'video'")
def test_the_video_plays_in_real_time(camera_run: RunResult, tmp_path: Path) -> None:
    """10 pictures a second of simulated time, in a format that every player shows."""
    import av

    told: list[tuple[float, float]] = []

    def report(done: float, total: float, note: str = "", /) -> None:
        told.append((done, total))

    run = first_seconds(camera_run, 2.0)
    path = write_video(Film(trailer_playback(run)).picture, TIMES[:20], 10, tmp_path / "video", report)
    assert path == tmp_path / "video.mp4"
    with av.open(path) as container:
        stream = container.streams.video[0]
        assert stream.codec_context.name == "h264"
        assert stream.codec_context.pix_fmt == "yuv420p"
        assert stream.average_rate == 10
        pictures = [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]
    assert len(pictures) == 20
    assert told == [(k, 20) for k in range(1, 21)]
    difference = np.abs(pictures[0].astype(float) - still(run, 0.0)).mean()
    assert difference < 4.0  # grey levels: compression, no swapped colours or rows


def test_without_pyav_there_is_a_small_gif(
    camera_run: RunResult, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Half the size, at most 5 pictures a second, real time all the same."""
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    film = Film(trailer_playback(first_seconds(camera_run, 3.0)))
    path = write_video(film.picture, TIMES[:30], 10, tmp_path / "video", no_progress)
    assert path == tmp_path / "video.gif"
    with Image.open(path) as gif:
        assert gif.width == 640
        assert gif.n_frames == 15
        assert gif.info["duration"] == 200
    assert path.stat().st_size < 2e6  # [bytes]


def test_a_still_is_the_picture_of_that_moment(camera_run: RunResult) -> None:
    """Camera, plan view and chart; more path and more curve as time goes on; even sizes for H.264."""
    early, late = still(camera_run, 4.0), still(camera_run, 22.0)
    assert early.shape == late.shape
    assert early.shape[0] % 2 == early.shape[1] % 2 == 0
    for colour in (TRUE, ESTIMATED):
        assert colour_count(late, colour) > colour_count(early, colour) + 200  # [px]


def test_a_run_without_cameras_is_drawn_from_above(blind_run: RunResult) -> None:
    """Only the plan view and the chart, and no trace of an estimate in the chart."""
    picture = still(blind_run, 15.0)
    assert picture.shape == (640, 1280, 3)
    assert colour_count(picture[160:, 700:], TRUE) > 500  # [px]
    assert colour_count(picture[160:, 700:], ESTIMATED) == 0  # below the readings


def test_the_flow_is_drawn_where_the_features_are() -> None:
    """A black picture of another size: the stroke ends, scaled, where the feature is now."""
    jpeg = cv2.imencode(".jpg", np.zeros((196, 640, 3), np.uint8))[1].tobytes()
    tracks = np.array([[100.0, 100.0, 160.0, 100.0]], dtype=np.float32)
    picture = camera_picture(Shot(0.0, jpeg, tracks))
    assert picture.shape == (392, 1280, 3)
    lit = np.argwhere(picture[40:].max(axis=-1) > 60) + np.array([40, 0])
    assert lit[:, 1].min() == pytest.approx(200.5, abs=2)  # [px] thickness of the stroke
    assert lit[:, 1].max() == pytest.approx(320.5, abs=4)  # [px] and radius of the dot
    assert lit[:, 0].mean() == pytest.approx(200.5, abs=1)
    white = cv2.imencode(".jpg", np.full((480, 640), 255, np.uint8))[1].tobytes()
    picture = camera_picture(Shot(0.7, white, NO_STROKES))  # 4:3 is fitted in, not cropped
    assert picture.shape == (480, 1280, 3)
    assert colour_count(picture[40:], (255, 255, 255)) == pytest.approx(440 * 640, rel=0.01)
    with pytest.raises(ValueError, match=r"at 0\.70 s"):
        camera_picture(Shot(0.7, b"no picture", NO_STROKES))


def test_a_long_course_is_followed(blind_run: RunResult) -> None:
    """On 600 m the whole course would leave a vehicle of a few pixels: the view moves, the vehicle stays in it."""
    rows, column = blind_run.log.rows.copy(), blind_run.log.names.index
    for unit in ("tractor", "trailer"):
        rows[:, [column(f"{name}_{unit}") for name in ("y", "psi")]] = 0.0
        rows[:, column(f"x_{unit}")] = 25.0 * rows[:, column("time")]
    road = np.column_stack([np.linspace(-50.0, 700.0, 400), np.zeros(400)])
    run = dataclasses.replace(blind_run, log=Log(blind_run.log.signals, rows), road=road)
    early, late = still(run, 5.0)[60:, :600], still(run, 20.0)[60:, :600]
    for colour in (ESTIMATED, INK):  # the follow point's path behind the vehicle, and its wheels
        assert colour_count(late, colour) > 100  # [px]
        assert colour_count(early, colour) == pytest.approx(colour_count(late, colour), rel=0.3)  # wheels steer


@pytest.mark.parametrize(("span", "step"), [(1.0, 0.2), (6.0, 1.0), (25.45, 5.0), (0.1, 0.02), (700.0, 200.0)])
def test_axes_have_round_numbers(span: float, step: float) -> None:
    """1, 2 or 5 times a power of ten, at most six of them."""
    assert nice_step(span, 6) == pytest.approx(step)
