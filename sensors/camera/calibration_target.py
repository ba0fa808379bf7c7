"""Checkerboard for the calibration of cameras, and synthetic images of it.

Modelled: the lens (``sensors.camera.rig``), its blur, anti-aliasing, noise, and light that falls off towards one side
of the board. Not modelled: bent boards, motion blur, reflections.
"""

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np

from sensors.camera.rig import CameraModel
from sensors.messages import GreyImage
from vehicle.frames import FloatArray, so3_exp, transform

_FEWEST = 3  # inner corners along a side; OpenCV finds no smaller board
_WHITE, _BLACK, _WALL = 205.0, 35.0, 120.0  # [grey levels]
_BLUR = 0.6  # standard deviation of the lens blur [px]
_SHADE = 0.15  # share of the light missing at one end of the board
_MARGIN = 1.0  # white border around the squares [squares]
_SIDE_POINTS = 9  # points along a side of the paper that locate it in the image: a lens bends straight sides
_BORDER = 6  # drawn around these points [px]
_GRAZING = 0.15  # depth over distance of a point almost beside the camera


@dataclass(frozen=True, slots=True, kw_only=True)
class Checkerboard:
    """A flat board of black and white squares, described by its inner corners.

    Frame B: origin at the first inner corner, x along a row of corners, y along a column, z away from the viewer.

    Raises:
        ValueError: if the board has too few corners.
    """

    columns: int  # inner corners along a row
    rows: int  # inner corners along a column
    square: float  # side of a square [m]

    def __post_init__(self) -> None:
        if min(self.columns, self.rows) < _FEWEST:
            raise ValueError(f"board {self.columns}x{self.rows}: at least {_FEWEST}x{_FEWEST} inner corners are needed")

    @property
    def corners(self) -> FloatArray:
        """Inner corners (columns * rows, 3) in B [m], row by row."""
        y, x = np.mgrid[: self.rows, : self.columns] * self.square
        return np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])

    @property
    def centre(self) -> FloatArray:
        """Middle of the board (3,) in B [m]."""
        return 0.5 * self.square * np.array([self.columns - 1.0, self.rows - 1.0, 0.0])


def board_image(
    board: Checkerboard, camera: CameraModel, X_CB: FloatArray, *, noise_std: float, rng: np.random.Generator
) -> GreyImage:
    """Image of the board at ``X_CB`` (4, 4), with white noise of the given standard deviation [grey levels].

    Each pixel's shares of black and white are those of a strip as wide as the pixel across the nearest edge: exact to
    second order in the pixel size, and symmetric about every corner.
    """
    H = np.linalg.inv(np.column_stack([X_CB[:3, 0], X_CB[:3, 1], X_CB[:3, 3]]))  # from rays to the board's plane
    level = np.full((camera.height, camera.width), _WALL)
    region = _board_region(board, camera, X_CB)
    on_board = _rays(camera)[region] @ H[:, :2].T + H[:, 2]
    ahead = on_board[..., 2] > 0.0
    xy = on_board[..., :2] / np.where(ahead, on_board[..., 2], np.inf)[..., None] / board.square
    level[region] = np.where(ahead, _light(board, xy), _WALL)
    blurred = cv2.GaussianBlur(level, (0, 0), _BLUR)
    noisy = blurred + noise_std * rng.standard_normal(level.shape)
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)


def _board_region(board: Checkerboard, camera: CameraModel, X_CB: FloatArray) -> tuple[slice, slice]:
    """Rows and columns of the image that hold the board; the whole image if some of the board is beside the camera."""
    x, y = (board.square * np.linspace(-1.0 - _MARGIN, n + _MARGIN, _SIDE_POINTS) for n in (board.columns, board.rows))
    on_paper = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    points = on_paper @ X_CB[:3, :2].T + X_CB[:3, 3]
    if points[:, 2].min() <= _GRAZING * np.linalg.norm(points, axis=1).max():
        return slice(None), slice(None)
    pixels = camera.project(points)
    (u0, v0), (u1, v1) = np.floor(pixels.min(axis=0)) - _BORDER, np.ceil(pixels.max(axis=0)) + _BORDER
    return slice(max(0, int(v0)), max(0, int(v1) + 1)), slice(max(0, int(u0)), max(0, int(u1) + 1))


def _light(board: Checkerboard, xy: FloatArray) -> FloatArray:
    """Light (height, width) [grey levels] from points xy (height, width, 2) on the board [squares]."""
    pixel = np.stack([_pixel(xy[..., k]) for k in (0, 1)], axis=-1)
    black_and_white = _stripes(xy[..., 0], pixel[..., 0]) * _stripes(xy[..., 1], pixel[..., 1])  # -1 to 1
    size = np.array([board.columns, board.rows], dtype=np.float64)
    squares = _inside(xy, pixel, -np.ones(2), size)
    paper = _inside(xy, pixel, -np.ones(2) - _MARGIN, size + _MARGIN)
    level = 0.5 * (_WHITE + _BLACK) - squares * 0.5 * (_WHITE - _BLACK) * black_and_white
    level += (1.0 - squares) * 0.5 * (_WHITE - _BLACK)
    level *= 1.0 - _SHADE * np.clip(xy[..., 0] / size[0], 0.0, 1.0)
    return paper * level + (1.0 - paper) * _WALL


def random_board_pose(
    board: Checkerboard, rng: np.random.Generator, *, ray: FloatArray, depth: float, tilt: float
) -> FloatArray:
    """Pose X_CB (4, 4) of a board whose middle lies on the ray ``ray`` (2,) at a depth ``depth`` [m].

    It is tilted by ``tilt`` [rad] about a random axis in the board, and turned in its plane by up to 20 deg.
    """
    about = rng.uniform(0.0, 2.0 * np.pi)
    R = so3_exp(tilt * np.array([np.cos(about), np.sin(about), 0.0])) @ so3_exp(
        np.array([0.0, 0.0, rng.uniform(-0.35, 0.35)])
    )
    return transform(R, depth * np.append(ray, 1.0) - R @ board.centre)


@lru_cache(maxsize=2)
def _rays(camera: CameraModel) -> FloatArray:
    """Rays (height, width, 2) of all pixels."""
    v, u = np.mgrid[: camera.height, : camera.width].astype(np.float64)
    return camera.rays(np.stack([u, v], axis=-1))


def _stripes(x: FloatArray, pixel: FloatArray) -> FloatArray:
    """Stripes of width 1, alternately -1 and +1, averaged over each pixel at the edges."""
    to_edge = x - np.rint(x)
    sign = np.where(np.rint(x) % 2.0 == 0.0, 1.0, -1.0)
    return sign * np.clip(2.0 * to_edge / pixel, -1.0, 1.0)


def _inside(xy: FloatArray, pixel: FloatArray, low: FloatArray, high: FloatArray) -> FloatArray:
    """Share (height, width) of each pixel inside a rectangle of the board."""
    share = np.ones(xy.shape[:2])
    for k in (0, 1):
        x = xy[..., k]
        depth_inside = np.minimum(x - low[k], high[k] - x) / pixel[..., k]
        share *= np.clip(0.5 + depth_inside, 0.0, 1.0)
    return share


def _pixel(x: FloatArray) -> FloatArray:
    """Change of x over a pixel; at least 1e-6."""
    dv, du = np.gradient(x)
    return np.asarray(np.maximum(np.hypot(du, dv), 1e-6), dtype=np.float64)
