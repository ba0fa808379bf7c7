"""Observers of a run's camera images: hash, recordings, and JPEG pictures for reports and videos."""

import hashlib
from array import array
from bisect import bisect_right
from collections.abc import Callable
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

    def update(self, image: GreyImage) -> None:
        self._sha256.update(np.ascontiguousarray(image).data)

    def hexdigest(self) -> str:
        return self._sha256.hexdigest()

    def __deepcopy__(self, _: object) -> "_Digest":
        return _Digest(self._sha256.copy())


class Pictures(Generic[TruthT]):
    """Pictures kept for reports and videos, and the hash of all images."""

    def __init__(self, *, records: bool, keep: PictureSize | bool) -> None:
        self._records = records
        self._size = PictureSize() if keep is True else keep or None  # None: none is kept
        self._digest = _Digest()
        self._newest: Future[None] | None = None  # of the picture that is compressed last
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
        if self._newest is not None:
            self._newest.exception()  # waits
        return list(self._kept)

    def compress(self, worker: Executor, tick: int, jpeg: Callable[[], bytes]) -> None:
        """Keep a picture that a worker compresses, one after the other."""
        self._newest = worker.submit(lambda: self._kept.append((tick, jpeg())))

    @property
    def sha256(self) -> str:
        """Hash of all images sent so far."""
        return self._digest.hexdigest()


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
            worker: compresses pictures.
            keep: keep pictures of that channel, as they were captured or of this size.
            recorder: receives the frames of that channel.
        """
        super().__init__(records=recorder is not None, keep=keep)
        self._recorder = recorder
        self._channel, self._unit, self._cameras, self._worker = channel, unit, cameras, worker
        self._recorded = _Digest() if channel else None  # of that channel, if it is one of several
        width = cameras.calibration.width if cameras else 1
        self.scale = min(1.0, self._size.width / width) if self._size else 1.0  # of kept pictures to the camera's [-]

    @property
    def recording_sha256(self) -> str:
        """Hash of the images of the channel that is recorded."""
        return self._recorded.hexdigest() if self._recorded else self.sha256

    def see(self, channel: int, message: object, truth: Truth) -> None:
        """Hash every frame; record and keep those of the chosen channel."""
        frame = stereo_frame(message)
        if frame is None:
            return
        self._digest.update(frame.left)
        self._digest.update(frame.right)
        if channel != self._channel:
            return
        if self._recorded:
            self._recorded.update(frame.left)
            self._recorded.update(frame.right)
        if self._recorder:
            self._recorder.add(frame, self._truth(frame.tick).bodies[self._unit])
        if self._size and self._cameras:
            size, rectified = self._size, self._cameras.rectified
            self.compress(self._worker, frame.tick, lambda: _stereo_jpeg(rectified(frame), size))


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
        """Create the observer of a camera; kept pictures are rendered again in colour, and compressed by a worker."""
        super().__init__(records=recorder is not None, keep=keep)
        self._recorder, self._camera, self._worker, self._stopwatch = recorder, camera, worker, stopwatch

    def see(self, channel: int, message: object, truth: RoverTruth) -> None:
        """Hash, record and keep the view while the estimator works."""
        if not isinstance(message, RoverView):
            return
        self._digest.update(message.image)
        if self._recorder:
            self._recorder.add(message, self._truth(message.tick))
        if self._size and self._camera is not None:
            with self._stopwatch.timed("render"):
                colour = self._camera.colour(truth)
            self.compress(self._worker, truth.tick, partial(self._size.jpeg, colour))


def _stereo_jpeg(frame: StereoFrame, size: PictureSize) -> bytes:
    return size.jpeg(np.stack([frame.left] * 3, axis=-1) if frame.colour is None else frame.colour)
