"""A checkerboard to calibrate cameras with, and what a real camera sees of it.

Modelled: the lens (``sensors.lens``), anti-aliasing, its blur, noise, light that falls off towards the sides of the
board. Not modelled: boards that are bent, motion blur, reflections.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np

from sensors.lens import CameraModel
from sensors.messages import GreyImage
from vehicle.frames import FloatArray, so3_exp, transform

_FEWEST = 3  # inner corners along a side; OpenCV finds no smaller board
_WHITE, _BLACK, _WALL = 205.0, 35.0, 120.0  # [grey levels]
_BLUR = 0.6  # standard deviation of the lens's [px]
_SHADE = 0.15  # share of the light that is missing at one end of the board
_MARGIN = 1.0  # white border around the squares [squares]


@dataclass(frozen=True, slots=True, kw_only=True)
class Checkerboard:
    """A flat board of black and white squares, described by its inner corners.

    Frame B: origin at the first inner corner, x along a row of corners, y along a column, z away from who looks at it.

    Raises:
        ValueError: for a board that can not be.
    """

    columns: int  # inner corners along a row
    rows: int  # inner corners along a column
    square: float  # side of a square [m]

    def __post_init__(self) -> None:
        if min(self.columns, self.rows) < _FEWEST:
            raise ValueError(f"board {self.columns}x{self.rows}: at least {_FEWEST}x{_FEWEST} inner corners are needed")
        if not self.square > 0.0:
            raise ValueError(f"square = {self.square} m must be positive")

    @property
    def corners(self) -> FloatArray:
        """The inner corners (columns * rows, 3) in B [m], row by row."""
        y, x = np.mgrid[: self.rows, : self.columns] * self.square
        return np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])

    @property
    def centre(self) -> FloatArray:
        """Its middle (3,) in B [m]."""
        return 0.5 * self.square * np.array([self.columns - 1.0, self.rows - 1.0, 0.0])


def photographed(
    board: Checkerboard, camera: CameraModel, X_CB: FloatArray, *, noise_std: float, rng: np.random.Generator
) -> GreyImage:
    """What the camera sees of the board at ``X_CB`` (4, 4), with white noise [grey levels].

    A pixel's coverage by black and white is that of a strip as wide as the pixel, across the nearest edge: exact to
    second order in the pixel, and symmetric about every corner.
    """
    rays = _rays(camera)
    H = np.linalg.inv(np.column_stack([X_CB[:3, 0], X_CB[:3, 1], X_CB[:3, 3]]))  # from rays to the board's plane
    on_board = rays @ H[:, :2].T + H[:, 2]
    ahead = on_board[..., 2] > 0.0
    xy = on_board[..., :2] / np.where(ahead, on_board[..., 2], np.inf)[..., None] / board.square
    black_and_white = _stripes(xy[..., 0]) * _stripes(xy[..., 1])  # -1 to 1
    size = np.array([board.columns, board.rows], dtype=np.float64)
    squares = _inside(xy, -np.ones(2), size)
    paper = _inside(xy, -np.ones(2) - _MARGIN, size + _MARGIN)
    board_level = 0.5 * (_WHITE + _BLACK) - squares * 0.5 * (_WHITE - _BLACK) * black_and_white
    board_level += (1.0 - squares) * 0.5 * (_WHITE - _BLACK)
    board_level *= 1.0 - _SHADE * np.clip(xy[..., 0] / size[0], 0.0, 1.0)
    level = np.where(ahead, paper * board_level + (1.0 - paper) * _WALL, _WALL)
    blurred = cv2.GaussianBlur(level, (0, 0), _BLUR)
    noisy = blurred + noise_std * rng.standard_normal(level.shape)
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)


def held(
    board: Checkerboard,
    rng: np.random.Generator,
    *,
    place: FloatArray,
    depth: float,
    tilt: float,
) -> FloatArray:
    """X_CB (4, 4) of a board held up so that its middle is seen along the ray ``place`` (2,), ``depth`` [m] away.

    It is tilted by ``tilt`` [rad] about an axis in the board that is left to chance, and turned by up to 20 deg.
    """
    about = rng.uniform(0.0, 2.0 * np.pi)
    R = so3_exp(tilt * np.array([np.cos(about), np.sin(about), 0.0])) @ so3_exp(
        np.array([0.0, 0.0, rng.uniform(-0.35, 0.35)])
    )
    return transform(R, depth * np.append(place, 1.0) - R @ board.centre)


@lru_cache(maxsize=2)
def _rays(camera: CameraModel) -> FloatArray:
    """Rays (height, width, 2) of all pixels."""
    v, u = np.mgrid[: camera.height, : camera.width].astype(np.float64)
    return camera.rays(np.stack([u, v], axis=-1))


def _stripes(x: FloatArray) -> FloatArray:
    """Stripes of width 1, -1 and +1 in turn, as pixels see them: the share of both beside an edge."""
    to_edge = x - np.rint(x)
    sign = np.where(np.rint(x) % 2.0 == 0.0, 1.0, -1.0)
    stripes: FloatArray = sign * np.clip(2.0 * to_edge / _pixel(x), -1.0, 1.0)
    return stripes


def _inside(xy: FloatArray, low: FloatArray, high: FloatArray) -> FloatArray:
    """Share (height, width) of each pixel inside a rectangle of the board."""
    share = np.ones(xy.shape[:2])
    for k in (0, 1):
        x = xy[..., k]
        depth_inside = np.minimum(x - low[k], high[k] - x) / _pixel(x)
        share *= np.clip(0.5 + depth_inside, 0.0, 1.0)
    return share


def _pixel(x: FloatArray) -> FloatArray:
    """By how much x changes over a pixel, at least a little."""
    dv, du = np.gradient(x)
    return np.asarray(np.maximum(np.hypot(du, dv), 1e-6), dtype=np.float64)
