"""Files of a camera calibration: the photographs that it reads, and the parameters and picture that it writes."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from estimators.calibration.boards import BoardView, CameraCalibration, board_view
from scenarios.image_file import read_grey_upright
from scenarios.progress import Progress
from sensors.camera.calibration_target import Checkerboard

_SUFFIXES = (".png", ".jpg", ".jpeg", ".pgm", ".bmp", ".tif", ".tiff")


def photographs(given: Sequence[Path], right: Sequence[Path]) -> tuple[list[Path], list[Path]]:
    """Left and right images in the order of their names; no right images for a single camera.

    A folder stands for the images in it; one folder that contains ``left`` and ``right`` stands for the pairs in these.

    Raises:
        ValueError: if a path does not exist or a folder contains no images.
    """
    if not right and len(given) == 1 and all((given[0] / side).is_dir() for side in ("left", "right")):
        return _images([given[0] / "left"]), _images([given[0] / "right"])
    return _images(given), _images(right)


def _images(given: Sequence[Path]) -> list[Path]:
    images: list[Path] = []
    for path in given:
        if path.is_dir():
            inside = sorted(file for file in path.iterdir() if file.suffix.lower() in _SUFFIXES)
            if not inside:
                raise ValueError(f"{path} contains no images ({', '.join(_SUFFIXES)})")
            images += inside
        elif os.path.lexists(path):
            images.append(path)
        else:
            raise ValueError(f"{path}: no such file or folder")
    return images


def board_of(text: str, square: float) -> Checkerboard:
    """Board from a text such as 9x6: the inner corners along a row and along a column.

    Raises:
        ValueError: if the text has another form.
    """
    columns, _, rows = text.lower().partition("x")
    if not (columns.isdecimal() and rows.isdecimal()):
        raise ValueError(f"--board {text}: expected COLUMNSxROWS of inner corners, for example 9x6")
    return Checkerboard(columns=int(columns), rows=int(rows), square=square)


def views_of(paths: Sequence[Path], board: Checkerboard, progress: Progress) -> list[BoardView]:
    """Corners of the board in each image; a view is named after its image and the folder that contains it.

    Raises:
        ValueError: if an image can not be read.
    """
    views = []
    for done, path in enumerate(paths, start=1):
        views.append(board_view(f"{path.parent.name}/{path.name}", read_grey_upright(path), board))
        progress(done, len(paths), path.name)
    return views


def camera_text(calibration: CameraCalibration) -> str:
    """Parameters of one camera and their standard deviations, as TOML."""
    camera, std = calibration.camera, calibration.std.tolist()
    names = ("fx", "fy", "cx", "cy")
    table: dict[str, Any] = {
        "camera": {"width": camera.width, "height": camera.height}
        | {name: getattr(camera, name) for name in names}
        | {"distortion": list(camera.distortion)},
        "standard_deviation": dict(zip(names, std[:4], strict=True)) | {"distortion": std[4:]},
    }
    return (
        "# One camera. Lengths in pixels; the centre of the first pixel is (0, 0). distortion: k1, k2, p1, p2, k3.\n"
        + (tomli_w.dumps(table))
    )


def coverage_picture(cameras: dict[str, CameraCalibration], path: Path) -> None:
    """Draw the corners of all boards in the image plane, coloured by their error, for each camera."""
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
