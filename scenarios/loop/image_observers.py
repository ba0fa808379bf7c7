"""Observers of a run's camera images: hash, recordings, and JPEG pictures for reports and videos."""

import hashlib
from array import array
from bisect import bisect_right
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, Future
from functools import partial
from typing import Final, Generic, Protocol, TypeVar

import numpy as np

from scenarios.assembly.trailer_sensors import Cameras
from scenarios.image_file import PictureSize
from scenarios.loop.channel import Kept, Stopwatch
from sensors.messages import GreyImage, RoverView, Stamped, StereoFrame, stereo_frame
from sensors.sand.trace_camera import TraceCamera
from vehicle.combination.truth import Truth
from vehicle.frames import FloatArray
from vehicle.rover.truth import RoverTruth

_IN_MEMORY: Final = 5  # pictures, twice as many at most: an hour has 36 000 of some hundred kilobytes each
_TRUTHS: Final = 50  # are written at once
_RECENT: Final = 500  # truths in memory: images arrive some tenths of a second after their capture

TruthT = TypeVar("TruthT", bound=Stamped)
MessageIn = TypeVar("MessageIn", contravariant=True)
CaptureIn = TypeVar("CaptureIn", contravariant=True)


class Recorder(Protocol[MessageIn, CaptureIn]):
    """Writes the images of a run's camera."""

    def add(self, message: MessageIn, capture: CaptureIn, /) -> None:
        """Append a message, with the ground truth of its capture that the recording needs."""

    def end(self) -> None:
        """End the recording; it may be replaced until its run is written."""


StereoRecorder = Recorder[StereoFrame, FloatArray]  # with the pose (4, 4) of the trailer's body
RoverRecorder = Recorder[RoverView, RoverTruth]


class _Digest:
    """SHA-256 of images as they come; it can be copied."""

    def __init__(self, sha256: "hashlib._Hash | None" = None) -> None:
        self._sha256 = sha256 or hashlib.sha256()

    def update(self, images: Sequence[memoryview]) -> None:
        for image in images:
            self._sha256.update(image)

    def hexdigest(self) -> str:
        return self._sha256.hexdigest()

    def __deepcopy__(self, _: object) -> "_Digest":
        return _Digest(self._sha256.copy())


class Pictures(Generic[TruthT]):
    """Pictures kept for reports and videos, and the hash of all images."""

    def __init__(self, worker: Executor, *, records: bool, keep: PictureSize | bool) -> None:
        self._worker, self._records = worker, records
        self._size = PictureSize() if keep is True else keep or None  # None: none is kept
        self._digest = _Digest()
        self._newest: Future[None] | None = None  # of what the worker does last
        self._kept: Kept[tuple[int, bytes]] = Kept(_IN_MEMORY)
        self._truths: Kept[TruthT] = Kept(_TRUTHS, recent=_RECENT)
        self._ticks = array("q")  # of the truths

    def follow(self, truth: TruthT) -> None:
        """Remember the truth for images that arrive later."""
        if self._records:
            self._truths.append(truth)
            self._ticks.append(truth.tick)

    def _truth(self, tick: int) -> TruthT:
        """Truth at the capture of an image."""
        place = bisect_right(self._ticks, tick) - 1
        if place < 0 or self._ticks[place] != tick:
            raise KeyError(tick)
        return self._truths[place]

    @property
    def frames(self) -> list[tuple[int, bytes]]:
        """Tick and JPEG of every kept picture; those that a user's own sensor made unfit for JPEG are left out."""
        self._wait()
        return list(self._kept)

    def compress(self, tick: int, jpeg: Callable[[], bytes]) -> None:
        """Keep a picture that the worker compresses, one after the other."""
        self._newest = self._worker.submit(lambda: self._kept.append((tick, jpeg())))

    def hash(self, digest: _Digest, *images: GreyImage) -> None:
        """Let the worker add images to a hash; they do not change any more."""
        self._newest = self._worker.submit(digest.update, [np.ascontiguousarray(image).data for image in images])

    @property
    def sha256(self) -> str:
        """Hash of all images sent so far."""
        return self._hexdigest(self._digest)

    def _hexdigest(self, digest: _Digest) -> str:
        self._wait()
        return digest.hexdigest()

    def _wait(self) -> None:
        if self._newest is not None:
            self._newest.exception()


class StereoPictures(Pictures[Truth]):
    """Stereo images of trailers; one channel is recorded and kept, all are hashed."""

    def __init__(
        self,
        channel: int,
        unit: int,
        cameras: Cameras | None,
        worker: Executor,
        *,
        keep: PictureSize | bool,
        recorder: StereoRecorder | None,
    ) -> None:
        """Create the observer of all channels.

        Args:
            channel: number of the channel that is recorded and kept.
            unit: index of the unit that carries its cameras.
            cameras: cameras of that channel.
            worker: hashes images and compresses pictures.
            keep: keep pictures of that channel, as they were captured or of this size.
            recorder: receives the frames of that channel.
        """
        super().__init__(worker, records=recorder is not None, keep=keep)
        self._recorder = recorder
        self._channel, self._unit, self._cameras = channel, unit, cameras
        self._recorded = _Digest() if channel else None  # of that channel, if it is one of several
        width = cameras.calibration.width if cameras else 1
        self.scale = min(1.0, self._size.width / width) if self._size else 1.0  # of kept pictures to the camera's [-]

    @property
    def recording_sha256(self) -> str:
        """Hash of the images of the channel that is recorded."""
        return self._hexdigest(self._recorded or self._digest)

    def see(self, channel: int, message: object, truth: Truth) -> None:
        """Hash every frame; record and keep those of the chosen channel."""
        frame = stereo_frame(message)
        if frame is None:
            return
        self.hash(self._digest, frame.left, frame.right)
        if channel != self._channel:
            return
        if self._recorded:
            self.hash(self._recorded, frame.left, frame.right)
        if self._recorder:
            self._recorder.add(frame, self._truth(frame.tick).bodies[self._unit])
        if self._size and self._cameras:
            size, rectified = self._size, self._cameras.rectified
            self.compress(frame.tick, lambda: _stereo_jpeg(rectified(frame), size))


class TracePictures(Pictures[RoverTruth]):
    """The images of a rover's camera."""

    def __init__(
        self,
        camera: TraceCamera | None,
        worker: Executor,
        stopwatch: Stopwatch,
        *,
        keep: PictureSize | bool,
        recorder: RoverRecorder | None,
    ) -> None:
        """Create the observer of a camera; kept pictures are rendered again in colour; the worker compresses them."""
        super().__init__(worker, records=recorder is not None, keep=keep)
        self._recorder, self._camera, self._stopwatch = recorder, camera, stopwatch

    def see(self, channel: int, message: object, truth: RoverTruth) -> None:
        """Hash, record and keep the view while the estimator works."""
        if not isinstance(message, RoverView):
            return
        self.hash(self._digest, message.image)
        if self._recorder:
            self._recorder.add(message, self._truth(message.tick))
        if self._size and self._camera is not None:
            with self._stopwatch.timed("render"):
                colour = self._camera.colour(truth)
            self.compress(truth.tick, partial(self._size.jpeg, colour))


def _stereo_jpeg(frame: StereoFrame, size: PictureSize) -> bytes:
    return size.jpeg(np.stack([frame.left] * 3, axis=-1) if frame.colour is None else frame.colour)
