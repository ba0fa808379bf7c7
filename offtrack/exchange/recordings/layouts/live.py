"""Stereo images of cameras and network streams, read by OpenCV.

Each source is a number of a device, a file or an address; images that arrive together are a pair.
"""

import math
import threading
import time
from typing import Final, cast

import cv2

from offtrack.exchange.recordings.layouts.videos import next_image
from sensors.messages import GreyImage

_AGAIN: Final = 0.5  # between two attempts to open a lost source [s]
_PATIENCE: Final = 1.0  # without a pair, after which an estimate is lost [s]
_TOGETHER: Final = 0.1  # longest time between the arrivals of a pair's images [s]
_SHORTEST: Final = 0.01  # time between two images [s]


class _Source:
    """The newest image of a live source, which a thread reads; what was buffered before is passed over."""

    def __init__(self, name: str, news: threading.Condition) -> None:
        self.name, self._news = name, news
        self.image: GreyImage | None = None
        self.time = 0.0  # of its arrival [s]
        self.closed = False
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        while not self.closed:
            capture = cv2.VideoCapture(int(self.name) if self.name.isdecimal() else self.name)
            is_file, begin = capture.get(cv2.CAP_PROP_FRAME_COUNT) > 0, time.monotonic()
            while not self.closed and (image := next_image(capture)) is not None:
                if is_file:  # at its own rate
                    time.sleep(max(0.0, begin + 1e-3 * capture.get(cv2.CAP_PROP_POS_MSEC) - time.monotonic()))
                with self._news:
                    self.image, self.time = image, time.monotonic()
                    self._news.notify()
            capture.release()
            time.sleep(_AGAIN)

    def close(self) -> None:
        """End the thread."""
        self.closed = True
        self._thread.join(2.0 * _PATIENCE)


class Streams:
    """Two live sources of images, read at the same time."""

    def __init__(self, left: str, right: str) -> None:
        """Open devices (numbers), files or addresses."""
        cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_ERROR)  # a lost source is said here
        self._news = threading.Condition()
        self._sources = [_Source(name, self._news) for name in (left, right)]
        self._used, self._period = [0.0, 0.0], math.inf

    def read(self, patience: float | None = None) -> tuple[GreyImage, GreyImage] | str:
        """The next pair of images that arrived together, or why there is none after a second or the ``patience`` [s].

        Together means within half of the shortest time between two images so far. Sources that are lost are opened
        again.
        """
        until = time.monotonic() + (_PATIENCE if patience is None else patience)
        with self._news:
            while (now := time.monotonic()) < until:
                new = [source.time > used for source, used in zip(self._sources, self._used, strict=True)]
                times = [source.time for source in self._sources]
                if all(new) and abs(times[0] - times[1]) < min(_TOGETHER, 0.5 * self._period):
                    if all(self._used):
                        self._period = min(self._period, max(_SHORTEST, times[0] - self._used[0]))
                    self._used = times
                    images = [source.image for source in self._sources]
                    return cast("tuple[GreyImage, GreyImage]", tuple(images))
                self._news.wait(until - now)
        lost = [source.name for source, is_new in zip(self._sources, new, strict=True) if not is_new]
        return f"no image from {' and '.join(lost)}" if lost else "left and right images do not arrive together"

    def close(self) -> None:
        """Release both sources."""
        for source in self._sources:
            source.close()
