"""Photographs for a calibration on disk, and the files that come of it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import tomli_w

from estimators.calibration.board_views import BoardView, board_view
from estimators.calibration.single_camera import CameraCalibration
from scenarios.progress import Progress
from sensors.camera.calibration_target import Checkerboard
from sensors.messages import GreyImage

_SUFFIXES = (".png", ".jpg", ".jpeg", ".pgm", ".bmp", ".tif", ".tiff")


def photographs(given: Sequence[Path], right: Sequence[Path]) -> tuple[list[Path], list[Path]]:
    """The left and the right images in the order of their names; none on the right for a single camera.

    A folder stands for the images in it; one folder with ``left`` and ``right`` in it for the pairs there.

    Raises:
        ValueError: if a path does not exist or a folder holds no images.
    """
    if not right and len(given) == 1 and all((given[0] / side).is_dir() for side in ("left", "right")):
        return _images([given[0] / "left"]), _images([given[0] / "right"])
    return _images(given), _images(right)


def _images(given: Sequence[Path]) -> list[Path]:
    found: list[Path] = []
    for path in given:
        if path.is_dir():
            inside = sorted(file for file in path.iterdir() if file.suffix.lower() in _SUFFIXES)
            if not inside:
                raise ValueError(f"{path}: holds no images ({', '.join(_SUFFIXES)})")
            found += inside
        elif path.is_file():
            found.append(path)
        else:
            raise ValueError(f"{path}: no such file or folder")
    return found


def board_of(text: str, square: float) -> Checkerboard:
    """The board of a text such as 9x6, the inner corners along a row and along a column.

    Raises:
        ValueError: if it is none.
    """
    columns, _, rows = text.lower().partition("x")
    if not (columns.isdecimal() and rows.isdecimal()):
        raise ValueError(f"--board {text}: expected COLUMNSxROWS of inner corners, for example 9x6")
    return Checkerboard(columns=int(columns), rows=int(rows), square=square)


def views_of(paths: Sequence[Path], board: Checkerboard, progress: Progress) -> list[BoardView]:
    """The board's corners in each image; they are named as shortly as they can be told apart.

    Raises:
        ValueError: if an image can not be read.
    """
    views = []
    for done, path in enumerate(paths, start=1):
        views.append(board_view(f"{path.parent.name}/{path.name}", _read(path), board))
        progress(done, len(paths), path.name)
    return views


def _read(path: Path) -> GreyImage:
    image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    if image is None:
        raise ValueError(f"{path}: can not be read as an image")
    return np.asarray(image, dtype=np.uint8)


def camera_text(calibration: CameraCalibration) -> str:
    """One camera as TOML, with its standard deviations."""
    camera, std = calibration.camera, calibration.std.tolist()
    names = ("fx", "fy", "cx", "cy")
    table: dict[str, Any] = {
        "camera": {"width": camera.width, "height": camera.height}
        | {name: getattr(camera, name) for name in names}
        | {"distortion": list(camera.distortion)},
        "standard_deviation": dict(zip(names, std[:4], strict=True)) | {"distortion": std[4:]},
    }
    return "# One camera; lengths in pixels, the first pixel's centre is 0, 0. distortion: k1, k2, p1, p2, k3.\n" + (
        tomli_w.dumps(table)
    )


def coverage_picture(cameras: dict[str, CameraCalibration], path: Path) -> None:
    """Writes where in the picture the corners were, and how large the errors, for each camera."""
    from matplotlib.figure import Figure

    model = next(iter(cameras.values())).camera
    figure = Figure(figsize=(7.0 * len(cameras), 1.2 + 5.0 * model.height / model.width), layout="constrained")
    for ax, (name, calibration) in zip(np.atleast_1d(figure.subplots(1, len(cameras))), cameras.items(), strict=True):
        camera, errors = calibration.camera, np.array(list(calibration.errors.values()))
        each = np.repeat(errors, len(calibration.corners) // len(errors))
        shown = ax.scatter(*calibration.corners.T, c=each, s=6.0, cmap="viridis", vmin=0.0)
        ax.plot(camera.cx, camera.cy, "+", color="crimson", markersize=12)
        ax.set(xlim=(0, camera.width), ylim=(camera.height, 0), aspect="equal", xlabel="u [px]", ylabel="v [px]")
        ax.set_title(
            f"{name}: {len(errors)} images, {calibration.rms:.3f} px RMS, {100 * calibration.coverage:.0f} % covered"
        )
        figure.colorbar(shown, ax=ax, label="RMS error of the image [px]")
    figure.savefig(path, dpi=110)
