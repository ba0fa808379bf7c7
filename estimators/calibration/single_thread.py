"""OpenCV on one thread, where its result depends on the order in which threads finish."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import cv2


@contextmanager
def single_thread() -> Iterator[None]:
    """Run OpenCV on one thread, for calibrations that must be equal to the bit from run to run.

    ``cv2.calibrateCamera`` and ``cv2.stereoCalibrate`` sum the normal equations in the order in which threads finish.
    The setting is global; it is restored at the end.
    """
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(threads)
