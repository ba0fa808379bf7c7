"""Observers of a run's camera images: their hash, recordings, and JPEG pictures for people."""

from __future__ import annotations

import hashlib
from concurrent.futures import Executor, Future
from typing import Generic, TypeVar

import cv2

from scenarios.assembly.mount import Cameras
from scenarios.loop.stopwatch import Stopwatch
from scenarios.recordings.rover_writer import RoverRecordingWriter
from scenarios.recordings.stereo_writer import RecordingWriter
from sensors.messages import ColourImage, RoverView, StereoFrame
from sensors.sand.trace_camera import TraceCamera
from vehicle.combination.truth import Truth
from vehicle.rover.truth import RoverTruth

TruthT = TypeVar("TruthT")


class Pictures(Generic[TruthT]):
    """Images that were kept, with the hash of all images."""

    def __init__(self) -> None:
        self._digest = hashlib.sha256()
        self._kept: list[tuple[int, Future[bytes]]] = []
        self._truths: dict[int, TruthT] = {}  # by tick: a delayed image is recorded with the truth at its capture

    @property
    def frames(self) -> list[tuple[int, bytes]]:
        """Tick and JPEG of every picture kept for people."""
        return [(tick, jpeg.result()) for tick, jpeg in self._kept]

    @property
    def sha256(self) -> str:
        """Hash of every image that a sensor has sent so far."""
        return self._digest.hexdigest()


class StereoPictures(Pictures[Truth]):
    """The stereo images of trailers; recordings and pictures for people are those of one channel."""

    def __init__(
        self,
        channel: int,
        unit: int,
        cameras: Cameras | None,
        worker: Executor,
        *,
        keep: bool,
        recorder: RecordingWriter | None,
    ) -> None:
        """Observe all channels.

        Args:
            channel: number of the channel that is recorded and shown.
            unit: of the vehicle that carries its cameras.
            cameras: of that channel.
            worker: for the compression of pictures.
            keep: whether pictures for people are kept.
            recorder: receives the frames of that channel.
        """
        super().__init__()
        self._channel, self._unit, self._cameras, self._worker = channel, unit, cameras, worker
        self._keep, self._recorder = keep, recorder

    def follow(self, truth: Truth) -> None:
        """Remember the truth for frames that come later."""
        if self._recorder:
            self._truths[truth.tick] = truth

    def see(self, channel: int, message: object, truth: Truth) -> None:
        """Hash every frame; record and keep those of the chosen channel."""
        if not isinstance(message, StereoFrame):
            return
        self._digest.update(message.left.tobytes())
        self._digest.update(message.right.tobytes())
        if channel != self._channel:
            return
        if self._recorder:
            self._recorder.add(message, self._truths[message.tick].bodies[self._unit])
        if self._keep and self._cameras:
            rectified = self._cameras.rectified
            self._kept.append((message.tick, self._worker.submit(lambda: _stereo_jpeg(rectified(message)))))


class TracePictures(Pictures[RoverTruth]):
    """The images of a rover's camera."""

    def __init__(
        self,
        camera: TraceCamera | None,
        stopwatch: Stopwatch,
        *,
        keep: bool,
        recorder: RoverRecordingWriter | None,
    ) -> None:
        """Observe the ``camera``; pictures for people are rendered in colour at the same moments."""
        super().__init__()
        self._camera, self._stopwatch, self._keep, self._recorder = camera, stopwatch, keep, recorder

    def follow(self, truth: RoverTruth) -> None:
        """Remember the truth for images that come later."""
        if self._recorder:
            self._truths[truth.tick] = truth

    def see(self, channel: int, message: object, truth: RoverTruth) -> None:
        """Hash, record and keep the view; the estimator works meanwhile."""
        if not isinstance(message, RoverView):
            return
        self._digest.update(message.image.tobytes())
        if self._recorder:
            self._recorder.add(message, self._truths[message.tick])
        if self._keep and self._camera is not None:
            with self._stopwatch.timed("render"):
                picture: Future[bytes] = Future()
                picture.set_result(_jpeg(self._camera.colour(truth)))
                self._kept.append((truth.tick, picture))


def _stereo_jpeg(frame: StereoFrame) -> bytes:
    if frame.colour is None:
        return cv2.imencode(".jpg", frame.left)[1].tobytes()
    return _jpeg(frame.colour)


def _jpeg(colour: ColourImage) -> bytes:
    return cv2.imencode(".jpg", cv2.cvtColor(colour, cv2.COLOR_RGB2BGR))[1].tobytes()
