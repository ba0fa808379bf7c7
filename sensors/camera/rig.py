"""Cameras with lens distortion, the raw stereo rig, the mounting of the stereo cameras and their calibration.

The calibration is all that an estimator knows of the rig: it comes from a simulated rig or from the file of a
recording.

The distortion model is that of Brown and Conrady with OpenCV's order of the coefficients: k1, k2, p1, p2, k3, and k4,
k5, k6 of the rational model. A fisheye lens has k1 to k4 of Kannala and Brandt 2006, as OpenCV's and Kalibr's
(equidistant). Pixel centres are whole numbers; the first pixel's is (0, 0). Rays are given by their x and y at depth 1.
"""

import math
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Final, Literal, NamedTuple

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from vehicle.foundation.quantity import checked
from vehicle.foundation.user_file import MAX_PIXELS, FileKind, read_toml, without_sources
from vehicle.frames import R_BODY_CAMERA, FloatArray, rotation_zyx, transform

Distortion = tuple[float, float, float, float, float]  # k1, k2, p1, p2, k3 [-]
UNDISTORTED: Final[Distortion] = (0.0, 0.0, 0.0, 0.0, 0.0)
_WIDEST = 4.0  # greatest ray: at atan(4) = 76 deg off the axis
_LARGEST: Final = 1e6  # number of a calibration [-], [px], [m]
_LARGEST_SIDE = 20_000  # of an image [px]
_CONVERGED: Final = 1e-9  # error of a ray's image [-]; about a millionth of a pixel


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraModel:
    """Intrinsics of one camera: the map from rays to pixels.

    Raises:
        ValueError: for sizes or focal lengths out of range, and for a distortion that folds the image over.
    """

    width: int  # [px]
    height: int  # [px]
    fx: float  # [px]
    fy: float  # [px]
    cx: float  # principal point, column [px]
    cy: float  # principal point, row [px]
    distortion: tuple[float, ...] = UNDISTORTED  # k1, k2, p1, p2, k3, for some k4, k5, k6; of a fisheye k1 to k4 [-]
    fisheye: bool = False

    def __post_init__(self) -> None:
        if not (0 < self.width <= _LARGEST_SIDE and 0 < self.height <= _LARGEST_SIDE):
            raise ValueError(f"image of {self.width}x{self.height} px: sides must be 1 to {_LARGEST_SIDE} px")
        if self.width * self.height > MAX_PIXELS:
            raise ValueError(
                f"image of {self.width}x{self.height} px: must have at most {MAX_PIXELS / 1e6:g} megapixels"
            )
        for name, value in (("fx", self.fx), ("fy", self.fy)):
            if not 1.0 / _LARGEST < value < _LARGEST:
                raise ValueError(f"{name} = {value} px must be positive, up to {_LARGEST:g}")
        expected = (4,) if self.fisheye else (5, 8)
        if len(self.distortion) not in expected or not np.all(np.abs([*self.distortion, self.cx, self.cy]) <= _LARGEST):
            raise ValueError(
                f"distortion = {self.distortion} must be "
                f"{'four numbers k1 to k4' if self.fisheye else 'five numbers k1, k2, p1, p2, k3 or eight'}, and "
                f"cx = {self.cx} px and cy = {self.cy} px numbers, up to {_LARGEST:g}"
            )
        self._check_fold()

    @property
    def focal_length(self) -> float:
        """Mean of both focal lengths [px]."""
        return 0.5 * (self.fx + self.fy)

    @property
    def matrix(self) -> FloatArray:
        """Camera matrix K (3, 3): from rays (x, y, 1) to pixels (u, v, 1) without distortion."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    def project(self, points: FloatArray) -> FloatArray:
        """Pixels (n, 2) of points (n, 3) in front of the camera, in its frame [m]."""
        return self.pixels(points[:, :2] / points[:, 2:])

    def pixels(self, rays: FloatArray) -> FloatArray:
        """Pixels (..., 2) of rays (..., 2)."""
        return _Lens(self.distortion, self.fisheye).distorted(rays) * [self.fx, self.fy] + [self.cx, self.cy]

    def rays(self, pixels: FloatArray) -> FloatArray:
        """Rays (..., 2) of pixels (..., 2): the inverse of ``pixels`` everywhere in the image.

        Of a fisheye, pixels beyond 76 deg off the axis get the ray at 76 deg.
        """
        distorted: FloatArray = (pixels - [self.cx, self.cy]) / [self.fx, self.fy]
        if self.distortion == UNDISTORTED:
            return distorted
        return _undistorted(distorted, _Lens(self.distortion, self.fisheye))

    def _check_fold(self) -> None:
        """Refuse a lens whose image folds back before its corner: a pixel there would belong to two rays."""
        u, v = (-self.cx, self.width - 1 - self.cx), (-self.cy, self.height - 1 - self.cy)
        corner = max(math.hypot(x / self.fx, y / self.fy) for x in u for y in v)
        long, image = _unfolded(_Lens(self.distortion, self.fisheye))
        if image[-1] < corner and not (self.fisheye and long[-1] == _WIDEST):
            raise ValueError(
                f"distortion = {', '.join(f'{k:g}' for k in self.distortion)}: the image folds over {image[-1]:.3f} "
                f"focal lengths from its middle, before its corner at {corner:.3f}"
            )


def mount_rotation(roll: float, yaw: float, pitch: float) -> FloatArray:
    """Rotation (3, 3) of a camera turned by roll about z (its optical axis), yaw about y (down), pitch about x [rad].

    It is the turned camera's attitude in the straight one's frame, and the R of eqs (8) and (9) of de Saxe & Cebon
    2018: their K R K^-1 maps the image of the turned camera to that of the straight one.
    """
    cr, sr, cy, sy, cp, sp = (f(a) for a in (roll, yaw, pitch) for f in (math.cos, math.sin))
    R_z = np.array([[cr, -sr, 0.0], [sr, cr, 0.0], [0.0, 0.0, 1.0]])
    R_y = np.array([[cy, 0.0, sy], [0.0, 1.0, 0.0], [-sy, 0.0, cy]])
    R_x = np.array([[1.0, 0.0, 0.0], [0.0, cp, -sp], [0.0, sp, cp]])
    R: FloatArray = R_z @ R_y @ R_x
    return R


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RawStereoRig:
    """A stereo pair before rectification, true or as calibrated: two cameras, each with its own pose.

    Raises:
        ValueError: if a pose is no rigid motion or the right camera does not lie to the right of the left one.
    """

    left: CameraModel
    right: CameraModel
    X_ClCr: FloatArray  # (4, 4) pose of the right camera in the left one
    X_SC: FloatArray  # (4, 4) pose of the left camera in the trailer body (origin: hitch on the ground)

    def __post_init__(self) -> None:
        for name, X in (("X_ClCr", self.X_ClCr), ("X_SC", self.X_SC)):
            check_rigid(name, X)
        x, y, z = self.X_ClCr[:3, 3]
        if x <= max(abs(y), abs(z)):
            raise ValueError(
                f"X_ClCr: the right camera lies at {x:g}, {y:g}, {z:g} m in the left one; its x must be positive and "
                "the largest (are left and right swapped?)"
            )

    @property
    def baseline(self) -> float:
        """Distance between the optical centres [m]."""
        return float(np.linalg.norm(self.X_ClCr[:3, 3]))

    def to_toml(self) -> str:
        """Text of a TOML file that ``load_raw_rig`` reads back bit by bit."""
        return (
            "# A raw stereo pair; lengths in metres and pixels, the first pixel's centre is 0, 0.\n"
            "# Cameras: x right, y down, z ahead. distortion: k1, k2, p1, p2, k3 of OpenCV's model.\n\n"
            "# pose of the right camera in the left one\n"
            f"X_ClCr = {_matrix_text(self.X_ClCr)}\n"
            "# pose of the left camera in the trailer (x ahead, y left, z up; origin: hitch on the ground)\n"
            f"X_SC = {_matrix_text(self.X_SC)}\n"
            f"\n[left]\n{_camera_text(self.left)}\n[right]\n{_camera_text(self.right)}"
        )


def load_raw_rig(path: Path) -> RawStereoRig:
    """Raw stereo pair from a TOML file; other keys in it are ignored.

    Raises:
        ValueError: one line naming the file and what is wrong in it.
    """
    table = checked(_RigTable, without_sources(read_toml(path, FileKind.CALIBRATION)), str(path))
    try:
        return RawStereoRig(
            left=CameraModel(**table.left.model_dump()),
            right=CameraModel(**table.right.model_dump()),
            X_ClCr=np.array(table.X_ClCr, dtype=float),
            X_SC=np.array(table.X_SC, dtype=float),
        )
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


_Row = tuple[float, float, float, float]


class _CameraTable(BaseModel):
    model_config = ConfigDict(frozen=True)
    width: int = Field(json_schema_extra={"unit": "px"})
    height: int = Field(json_schema_extra={"unit": "px"})
    fx: float = Field(json_schema_extra={"unit": "px"})
    fy: float = Field(json_schema_extra={"unit": "px"})
    cx: float = Field(json_schema_extra={"unit": "px"})
    cy: float = Field(json_schema_extra={"unit": "px"})
    distortion: tuple[float, ...] = Field(json_schema_extra={"unit": "-"})
    fisheye: bool = False


class _RigTable(BaseModel):
    model_config = ConfigDict(frozen=True)
    left: _CameraTable
    right: _CameraTable
    X_ClCr: Annotated[tuple[_Row, _Row, _Row, _Row], Field(json_schema_extra={"unit": "m"})]
    X_SC: Annotated[tuple[_Row, _Row, _Row, _Row], Field(json_schema_extra={"unit": "m"})]


class _Lens(NamedTuple):
    """Distortion of rays: a factor along the radius, and shifts by a lens that is not centred."""

    k: tuple[float, ...]  # as in CameraModel
    fisheye: bool

    @property
    def shifts(self) -> tuple[float, float]:
        """p1 and p2 [-]."""
        return (0.0, 0.0) if self.fisheye else (self.k[2], self.k[3])

    def radial(self, r2: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Factor of rays of squared length ``r2`` (...), and twice its slope over ``r2``."""
        if self.fisheye:
            return self._of_angle(np.maximum(r2, 1e-12))
        k1, k2, _, _, k3 = self.k[:5]
        factor = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
        slope = 2.0 * (k1 + r2 * (2.0 * k2 + 3.0 * r2 * k3))
        if len(self.k) == 5:
            return factor, slope
        k4, k5, k6 = self.k[5:]
        below = 1.0 + r2 * (k4 + r2 * (k5 + r2 * k6))
        below_slope = 2.0 * (k4 + r2 * (2.0 * k5 + 3.0 * r2 * k6))
        return factor / below, (slope * below - factor * below_slope) / below**2

    def _of_angle(self, r2: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The same of a fisheye, whose image lies at theta (1 + k1 theta^2 + ...) for a ray at the angle theta."""
        k1, k2, k3, k4 = self.k
        r = np.sqrt(r2)
        theta = np.arctan(r)
        t2 = theta * theta
        factor = theta * (1.0 + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4)))) / r
        growth = (1.0 + t2 * (3.0 * k1 + t2 * (5.0 * k2 + t2 * (7.0 * k3 + t2 * 9.0 * k4)))) / (1.0 + r2)
        return factor, (growth - factor) / r2

    def distorted(self, rays: FloatArray) -> FloatArray:
        """Rays (..., 2) after distortion."""
        p1, p2 = self.shifts
        x, y = rays[..., 0], rays[..., 1]
        r2 = x * x + y * y
        radial = self.radial(r2)[0]
        return np.stack(
            [
                x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
                y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
            ],
            axis=-1,
        )


@lru_cache(maxsize=64)
def _unfolded(lens: _Lens) -> tuple[FloatArray, FloatArray]:
    """Lengths of rays up to where the image folds over, and their lengths after distortion, both growing."""
    r = np.linspace(0.0, _WIDEST, 2000)
    distorted = r * lens.radial(r**2)[0]
    turn = int(np.argmax(np.diff(distorted) <= 0.0)) or len(r) - 1
    return r[: turn + 1], distorted[: turn + 1]


def _undistorted(distorted: FloatArray, lens: _Lens) -> FloatArray:
    """Rays (..., 2) before distortion."""
    long, image = _unfolded(lens)
    if lens.fisheye:
        length = np.hypot(distorted[..., 0], distorted[..., 1])
        distorted = distorted * np.minimum(1.0, image[-1] / np.maximum(length, 1e-12))[..., None]
    with np.errstate(all="ignore"):  # of rays that are lost
        rays = _newton(distorted, distorted, lens)
        rest = np.abs(lens.distorted(rays) - distorted).max(axis=-1)
        # Where the distortion hardly grows, the first step can lead beyond the fold: begin close to the solution then.
        lost = ~((rest < _CONVERGED) & (np.hypot(rays[..., 0], rays[..., 1]) <= long[-1]))
        if lost.any():
            length = np.hypot(distorted[lost, 0], distorted[lost, 1])
            close = distorted[lost] * (np.interp(length, image, long) / length)[:, None]
            rays[lost] = _newton(distorted[lost], close, lens)
    return rays


def _newton(distorted: FloatArray, start: FloatArray, lens: _Lens) -> FloatArray:
    """Rays (..., 2) before distortion, by Newton's method from a start (..., 2)."""
    p1, p2 = lens.shifts
    rays = start.copy()
    for _ in range(20):
        x, y = rays[..., 0], rays[..., 1]
        radial, slope = lens.radial(x * x + y * y)
        a = radial + slope * x * x + 2.0 * p1 * y + 6.0 * p2 * x
        b = slope * x * y + 2.0 * p1 * x + 2.0 * p2 * y
        d = radial + slope * y * y + 6.0 * p1 * y + 2.0 * p2 * x
        rest = lens.distorted(rays) - distorted
        det = a * d - b * b
        step = np.stack([d * rest[..., 0] - b * rest[..., 1], a * rest[..., 1] - b * rest[..., 0]], axis=-1)
        step /= det[..., None]
        rays = rays - step
        if np.abs(step).max(initial=0.0) < 1e-13:
            break
    return rays


def check_rigid(name: str, X: FloatArray) -> None:
    """Refuse anything but a pose (4, 4) of numbers up to a million.

    Raises:
        ValueError: one line that names it.
    """
    if X.shape != (4, 4) or not np.all(np.abs(X) <= _LARGEST):
        raise ValueError(f"{name} of shape {X.shape} must be a pose: four rows of four numbers up to {_LARGEST:g}")
    R = X[:3, :3]
    error = max(np.abs(R.T @ R - np.eye(3)).max(), np.abs(X[3] - [0.0, 0.0, 0.0, 1.0]).max())
    if error > 1e-6 or np.linalg.det(R) < 0.0:
        raise ValueError(
            f"{name} is no rigid pose: its rotation is {error:.1g} off an orthonormal one, or mirrors, or its last row "
            "is not 0 0 0 1"
        )


def _matrix_text(X: FloatArray) -> str:
    rows = ",\n".join(f"  [{', '.join(repr(float(value)) for value in row)}]" for row in X)
    return f"[\n{rows},\n]"


def _camera_text(camera: CameraModel) -> str:
    numbers = {name: float(getattr(camera, name)) for name in ("fx", "fy", "cx", "cy")}
    lines = [f"width = {camera.width}", f"height = {camera.height}"]
    lines += [f"{name} = {value!r}" for name, value in numbers.items()]
    lines.append(f"distortion = [{', '.join(repr(float(k)) for k in camera.distortion)}]")
    lines += ["fisheye = true"] if camera.fisheye else []
    return "\n".join(lines) + "\n"


Facing = Literal["rear", "left", "right", "down"]
# Yaw and pitch of the optical axis; the upper edge of an image straight down lies ahead.
_ATTITUDE: Final[dict[Facing, tuple[float, float]]] = {
    "rear": (math.pi, 0.0),
    "left": (math.pi / 2, 0.0),
    "right": (-math.pi / 2, 0.0),
    "down": (0.0, math.pi / 2),
}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StereoCalibration:
    """A rectified stereo pair: two equal pinholes, the right one at ``baseline`` along the left one's x axis."""

    width: int  # [px]
    height: int  # [px]
    focal_length: float  # [px]
    cx: float  # principal point, column; the first pixel's centre is 0 [px]
    cy: float  # principal point, row [px]
    baseline: float  # [m]
    X_SC: FloatArray  # (4, 4) pose of the left camera in the trailer body (origin: hitch on the ground)

    @classmethod
    def of_view(cls, width: int, height: int, hfov: float, *, baseline: float, X_SC: FloatArray) -> "StereoCalibration":
        """Calibration of cameras with a horizontal field of view of ``hfov`` [rad], centred in their images."""
        return cls(
            width=width,
            height=height,
            focal_length=0.5 * width / math.tan(0.5 * hfov),
            cx=0.5 * (width - 1),
            cy=0.5 * (height - 1),
            baseline=baseline,
            X_SC=X_SC,
        )

    @property
    def X_ClCr(self) -> FloatArray:
        """Pose (4, 4) of the right camera in the left one."""
        return transform(np.eye(3), np.array([self.baseline, 0.0, 0.0]))


@dataclass(frozen=True, slots=True, kw_only=True)
class StereoRig:
    """A stereo pair on the trailer that looks level to the rear or to a side, or straight down at the ground."""

    facing: Facing
    width: int  # [px]
    height: int  # [px]
    hfov: float  # horizontal field of view [rad]
    x: float  # middle of the pair, from the hitch [m], negative behind it
    y: float  # [m], + left
    z: float  # above the ground [m]
    baseline: float  # [m]

    def calibration(self) -> StereoCalibration:
        """Exact calibration of this rig; the pair is centred on (x, y, z)."""
        R_SC = rotation_zyx(*_ATTITUDE[self.facing], 0.0) @ R_BODY_CAMERA
        p_SC = np.array([self.x, self.y, self.z]) - R_SC @ np.array([0.5 * self.baseline, 0.0, 0.0])
        return StereoCalibration.of_view(
            self.width, self.height, self.hfov, baseline=self.baseline, X_SC=transform(R_SC, p_SC)
        )

    def raw(self, distortion: Distortion = UNDISTORTED, R_ClCr: FloatArray | None = None) -> RawStereoRig:
        """This rig with lens distortion, and the right camera turned by ``R_ClCr`` (3, 3) about its optical centre."""
        ideal = self.calibration()
        camera = CameraModel(
            width=ideal.width,
            height=ideal.height,
            fx=ideal.focal_length,
            fy=ideal.focal_length,
            cx=ideal.cx,
            cy=ideal.cy,
            distortion=distortion,
        )
        R = np.eye(3) if R_ClCr is None else R_ClCr
        return RawStereoRig(left=camera, right=camera, X_ClCr=transform(R, ideal.X_ClCr[:3, 3]), X_SC=ideal.X_SC)


def ground_watching_pair(
    width: int, height: int, hfov: float, *, front_x: float, rear_x: float, z: float
) -> StereoCalibration:
    """Two equal cameras below the chassis that look straight down (Miao's ground-watching navigation system).

    One is near the fifth wheel, one near the follow point, as described in section 1.2 of C. de Saxe, D. Cebon,
    "Estimation of trailer off-tracking using visual odometry", Vehicle System Dynamics, 2018. ``left`` is the front
    camera, ``right`` the rear one.

    Args:
        width: along the trailer [px].
        height: across it [px].
        hfov: field of view along the trailer [rad].
        front_x: the front camera, from the hitch [m], negative behind it.
        rear_x: the rear camera [m].
        z: both, above the ground [m].

    Raises:
        ValueError: if the rear camera is not behind the front one.
    """
    if not rear_x < front_x:
        raise ValueError(f"rear_x = {rear_x} m must be less than front_x = {front_x} m")
    # The image's columns run to the rear (x of C against x of S), its rows to the left, the camera looks down. The
    # rear camera then lies on the front one's x axis, as the right camera of any pair lies on the left one's.
    X_SC = transform(np.diag([-1.0, 1.0, -1.0]), np.array([front_x, 0.0, z]))
    return StereoCalibration.of_view(width, height, hfov, baseline=front_x - rear_x, X_SC=X_SC)
