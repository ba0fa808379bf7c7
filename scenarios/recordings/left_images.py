"""Left images of a recording with their features, for its page and its video."""

from __future__ import annotations

import cv2

from scenarios.image_file import read_grey
from scenarios.recordings.estimation import Estimation, FrameEstimate
from scenarios.results.run_result import CameraFrame


def camera_frame(estimation: Estimation, frame: FrameEstimate) -> CameraFrame:
    """The left image, read again and rectified, with its tracks.

    Raises:
        ValueError: if the image can no longer be read.
    """
    image = estimation.recording.rectified_left(read_grey(frame.files.left))
    motion = frame.motion
    return CameraFrame(
        tick=frame.files.tick,
        jpeg=cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 88])[1].tobytes(),
        tracks=frame.tracks,
        matches=motion.matches if motion else 0,
        inliers=motion.inliers if motion else 0,
    )
