"""Image formation: lens distortion, lens surface, shutter, and the grey image with its exposure and noise.

Modelled: control of the exposure by the brightness of previous images, conversion to grey, Gaussian noise that is
constant or grows with the light, rounding and saturation.
"""

import math
from dataclasses import dataclass
from typing import Final, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from sensors.camera.rig import UNDISTORTED, CameraModel, RawStereoRig, StereoCalibration
from sensors.messages import ColourImage, GreyImage
from sensors.textures import fractal_noise
from vehicle.clock import TICK
from vehicle.engine.compiler import kernel
from vehicle.frames import FloatArray, cross, inverse, skew, so3_exp, transform

Floats = NDArray[np.float32]

_TARGET: Final = 118.0  # mean level of the control: 18 % reflectance at the usual gamma of 2.2 [grey levels]
_GAINS: Final = (0.25, 8.0)  # limits of shutter and amplifier, relative to the fixed exposure
_BANK = 1 << 22  # fewest samples: eight images of 1344x391 px, so that two rarely get the same noise


@dataclass(frozen=True, slots=True, kw_only=True)
class AutoExposure:
    """Exposure that follows the mean level of both images with a first-order lag, in stops."""

    time_constant: float  # [s]

    def settled(self, level: float) -> float:
        """Steady-state gain for images of a mean level [grey levels at a gain of 1]."""
        return min(max(_TARGET / max(level, 1e-3), _GAINS[0]), _GAINS[1])

    def step(self, gain: float, level: float, seconds: float) -> float:
        """Gain a number of seconds after an image of this level was taken at the given gain."""
        share = 1.0 - math.exp(-seconds / self.time_constant)
        return gain * math.exp(share * math.log(self.settled(level) / gain))


@dataclass(slots=True)
class ExposureControl:
    """Gain of one image after the other, controlled by the brightness of those before."""

    automatic: AutoExposure | None  # None: fixed
    last: tuple[int, float, float] | None = None  # tick, gain and level of the last image

    def gain(self, tick: int, *light: Floats) -> float:
        """Gain of the images of this tick from their light [grey levels at a gain of 1]."""
        if self.automatic is None:
            return 1.0
        level = float(np.mean([image[::8, ::8].mean() for image in light]))
        gain = self.automatic.settled(level)
        if self.last is not None:
            before, old_gain, old_level = self.last
            gain = self.automatic.step(old_gain, old_level, (tick - before) * TICK)
        self.last = tick, gain, level
        return gain


@dataclass(frozen=True, slots=True, eq=False)
class NoiseBank:
    """White Gaussian noise drawn once; every image takes a section of it with a random start."""

    samples: NDArray[np.int16]  # (n,) [grey levels]

    @classmethod
    def draw(cls, rng: np.random.Generator, std: float, pixels: int) -> "NoiseBank":
        """Bank of the given standard deviation [grey levels] for images of this number of pixels.

        Samples are whole grey levels, as an 8-bit camera sends them: rounding adds a variance of 1/12.
        """
        noise = rng.standard_normal(max(_BANK, 2 * pixels), dtype=np.float32)
        noise *= np.float32(std)
        return cls(np.rint(noise).astype(np.int16))

    def added_to(self, image: GreyImage | ColourImage, rng: np.random.Generator) -> GreyImage:
        """The image's grey levels plus a new section of the noise, saturated at 0 and 255."""
        shape = image.shape[:2]
        start = int(rng.integers(self.samples.size - math.prod(shape)))
        noise = self.samples[start : start + math.prod(shape)].reshape(shape)
        compiled = kernel("sensors.camera", "noise.c", "noisy_grey") if image.shape[2:] == (4,) else None
        if compiled is None or not image.flags.c_contiguous:
            return np.asarray(cv2.add(grey(image), noise, dtype=cv2.CV_8U), dtype=np.uint8)
        noisy = np.empty(shape, np.uint8)
        compiled(noise.size, image, noise, noisy)
        return noisy


@dataclass(frozen=True, slots=True, eq=False)
class LightNoise:
    """Photon and read-out noise of an image sensor: its variance grows linearly with the light."""

    samples: NDArray[np.float32]  # (n,) of unit deviation
    read: float  # standard deviation in the dark [grey levels]
    shot: float  # standard deviation at white and a gain of 1, without the read-out noise [grey levels]

    @classmethod
    def draw(cls, rng: np.random.Generator, read: float, shot: float, pixels: int) -> "LightNoise":
        """Noise for images of this number of pixels."""
        return cls(rng.standard_normal(max(_BANK, 2 * pixels), dtype=np.float32), read, shot)

    def sensed(self, light: NDArray[np.float32], gain: float, rng: np.random.Generator) -> GreyImage:
        """Noisy image (h, w) of the light [grey levels at a gain of 1], amplified by ``gain``."""
        start = int(rng.integers(self.samples.size - light.size))
        noise = self.samples[start : start + light.size].reshape(light.shape)
        # Photon noise before the amplifier has a variance of shot^2 light/255; the amplifier squares its gain into it.
        numbers = np.array([gain, self.read**2, self.shot**2 * gain / 255.0], np.float32)
        compiled = kernel("sensors.camera", "noise.c", "sensed")
        if compiled is not None and light.flags.c_contiguous:
            image = np.empty(light.shape, np.uint8)
            compiled(light.size, numbers, light, noise, image)
            return image
        level = light * numbers[0]
        std = cv2.sqrt(numbers[1] + numbers[2] * np.clip(level, 0.0, 255.0))
        return np.asarray(cv2.add(level, noise * std, dtype=cv2.CV_8U), dtype=np.uint8)


def grey(image: GreyImage | ColourImage) -> GreyImage:
    """Luminance (height, width) of an RGB or RGBA image (ITU-R BT.601 weights); a grey image as it is."""
    if image.ndim == 2:
        return image
    code = cv2.COLOR_RGBA2GRAY if image.shape[2] == 4 else cv2.COLOR_RGB2GRAY
    return np.asarray(cv2.cvtColor(image, code), dtype=np.uint8)


def without_alpha(image: ColourImage) -> ColourImage:
    """RGB image from one that may be RGBA; a copy, unless it is RGB."""
    return image if image.shape[2] == 3 else np.asarray(cv2.cvtColor(image, cv2.COLOR_RGBA2RGB), dtype=np.uint8)


_MARGIN: Final = 2  # of the pinhole image around the camera's view, for cubic interpolation [px]
_LARGEST: Final = 4096  # side of a pinhole image that is rendered in reasonable time [px]


@dataclass(frozen=True, slots=True, eq=False)
class LensMap:
    """Pixels of one camera in the image of a pinhole with the same pose."""

    rays: Floats  # (height, width, 2) x and y at depth 1 of each camera pixel's ray
    pixels: Floats  # (height, width, 2) u, v in the pinhole image [px]
    is_identity: bool

    @classmethod
    def of(cls, camera: CameraModel, pinhole: StereoCalibration) -> "LensMap":
        """Map for a pinhole whose image covers the camera's view."""
        v, u = np.mgrid[0.0 : camera.height, 0.0 : camera.width]
        rays = camera.rays(np.stack([u, v], axis=-1))
        pixels = rays * pinhole.focal_length + [pinhole.cx, pinhole.cy]
        same = (
            pixels.shape[:2] == (pinhole.height, pinhole.width)
            and np.abs(pixels - np.stack([u, v], axis=-1)).max() < 1e-6
        )
        return cls(rays.astype(np.float32), pixels.astype(np.float32), bool(same))

    def apply(
        self, image: NDArray[np.uint8], shift: Floats | None = None, interpolation: int = cv2.INTER_CUBIC
    ) -> NDArray[np.uint8]:
        """Camera image (height, width) or (height, width, 3) from the pinhole image.

        Args:
            image: of the pinhole.
            shift: offset of each look-up (height, width, 2) [px].
            interpolation: flag of OpenCV.
        """
        if shift is None and self.is_identity:
            return image
        pixels = self.pixels if shift is None else self.pixels + shift
        return np.asarray(resampled(image, pixels, interpolation), dtype=np.uint8)


def resampled(image: NDArray[np.uint8] | Floats, pixels: Floats, interpolation: int) -> NDArray[np.generic]:
    """Image looked up at u, v (h, w, 2) [px]; outside of it the nearest edge pixel is taken."""
    u, v = cv2.split(pixels)
    return np.asarray(cv2.remap(image, u, v, interpolation, borderMode=cv2.BORDER_REPLICATE))


def covering_pinholes(rig: RawStereoRig, margin: int = 0) -> StereoCalibration:
    """Smallest pinhole pair whose images cover the view of both cameras of a rig, plus ``margin`` px on all sides.

    In the middle of the image its resolution is that of the cameras, so that the renderer's anti-aliasing is kept
    there. Towards the edges of a lens with barrel distortion it is finer, which only costs time.

    Raises:
        ValueError: if no pinhole image of reasonable size covers the view.
    """
    cameras = (rig.left, rig.right)
    f = max(max(camera.fx, camera.fy) for camera in cameras)
    plain = all(camera.distortion == UNDISTORTED and camera.fx == camera.fy == f for camera in cameras)
    wider = margin if plain and rig.left == rig.right else margin + _MARGIN
    edges = np.concatenate([camera.rays(_border(camera)) for camera in cameras])
    low, high = np.round(edges.min(axis=0) * f, 9), np.round(edges.max(axis=0) * f, 9)
    middle = np.array([rig.left.cx, rig.left.cy])
    low = np.floor(low + middle) - middle  # without distortion, pixels then coincide
    width, height = (math.ceil(side - 1e-6) + 1 + 2 * wider for side in high - low)
    if max(width, height) > _LARGEST:
        raise ValueError(
            f"the cameras cover {width}x{height} px of an undistorted image; at most {_LARGEST} px can be rendered: "
            "choose a lower resolution, a narrower view or less distortion"
        )
    cx, cy = wider - low
    return StereoCalibration(
        width=width, height=height, focal_length=f, cx=cx, cy=cy, baseline=rig.baseline, X_SC=rig.X_SC
    )


def _border(camera: CameraModel) -> NDArray[np.float64]:
    """Outermost pixels of a camera's image (n, 2)."""
    u, v = np.arange(camera.width, dtype=float), np.arange(camera.height, dtype=float)
    sides = [(u, 0.0 * u), (u, 0.0 * u + v[-1]), (0.0 * v, v), (0.0 * v + u[-1], v)]
    return np.concatenate([np.stack(side, axis=-1) for side in sides])


_DIRT: Final = 0.85  # share of the light that thick dirt absorbs or scatters [-]
_SCATTER: Final = 0.3  # share of that light which is scattered over the image behind it [-]
_DROP_RADII: Final = (0.012, 0.045)  # apparent radius of rain drops over the mean side of the image [-]
_COARSE: Final = 4  # glare is smooth: it is computed on every fourth pixel
# Veiling glare by the angle from the sun: a halo around it and a wide haze from dust in the optics, as shares of white.
_HALO, _HALO_WIDTH = 1.0, math.radians(7.0)
_HAZE, _HAZE_WIDTH = 0.35, math.radians(28.0)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Drops:
    """Rain drops on a lens: each is a small lens that shows the scene upside down and out of focus."""

    cover: Floats  # (h, w) share of each pixel's light that comes through a drop
    source: Floats  # (h, w, 2) pixel of the coarse image that it comes from [px]

    def apply(self, light: Floats) -> Floats:
        """Light (h, w) or (h, w, 3) behind the drops."""
        coarse = cv2.resize(light, None, fx=1.0 / _COARSE, fy=1.0 / _COARSE, interpolation=cv2.INTER_AREA)
        blurred = np.asarray(cv2.GaussianBlur(coarse, (0, 0), 2.0), dtype=np.float32)
        through: Floats = np.asarray(resampled(blurred, self.source, cv2.INTER_LINEAR), dtype=np.float32)
        cover = self.cover if light.ndim == 2 else self.cover[..., None]
        return np.asarray(light + cover * (through - light), dtype=np.float32)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LensSurface:
    """Transmission of one lens, pixel by pixel, and the dirt and drops on it."""

    transmission: Floats | None  # (h, w) share of the light that reaches the sensor; None: all of it
    scattered: Floats | None  # (h, w) share of the mean light that dirt scatters there; None: none
    drops: Drops | None
    directions: Floats | None  # (h/4, w/4, 3) unit vectors of coarse pixels' rays; None: no glare

    def transmitted(self, light: Floats) -> Floats:
        """Light (h, w) or (h, w, 3) that reaches the sensor."""
        if self.drops is not None:
            light = self.drops.apply(light)
        if self.transmission is None:
            return light
        transmission, scattered = self.transmission, self.scattered
        if light.ndim == 3:
            transmission, scattered = transmission[..., None], None if scattered is None else scattered[..., None]
        dimmed = light * transmission
        return dimmed if scattered is None else dimmed + scattered * np.float32(light.mean())

    def glare(self, sun: FloatArray, strength: float) -> Floats:
        """Glare (h/4, w/4) [grey levels] of a sun in the direction ``sun`` (3,) of the camera's frame."""
        assert self.directions is not None
        angle = np.arccos(np.clip(self.directions @ sun.astype(np.float32), -1.0, 1.0))
        return glare_veil(angle, strength)


def lens_surface(
    rng: np.random.Generator, lens: LensMap, *, vignetting: float, dirt: float, rain: float, glare: bool
) -> LensSurface:
    """Surface of one lens.

    Args:
        rng: of the places of dirt and drops.
        lens: rays of the camera's pixels.
        vignetting: share of the light lost in the corners, 0 to 1; it grows with the squared distance.
        dirt: share of the image that is covered by dirt, 0 to 1.
        rain: share of the image that is covered by drops, 0 to 1.
        glare: True if the sun can shine on the lens.
    """
    dirt_rng, rain_rng = rng.spawn(2)
    shape = lens.rays.shape[:2]
    transmission = np.ones(shape, dtype=np.float32)
    if vignetting > 0.0:
        r2 = (lens.rays**2).sum(axis=-1)
        transmission -= np.float32(vignetting) * r2 / r2.max()
    dirt_map = dirt_layer(dirt_rng, (shape[0], shape[1]), dirt)
    transmission *= 1.0 - _DIRT * dirt_map
    directions = np.concatenate([lens.rays, np.ones((*shape, 1), dtype=np.float32)], axis=-1)[::_COARSE, ::_COARSE]
    return LensSurface(
        transmission=transmission if vignetting > 0.0 or dirt > 0.0 else None,
        scattered=_SCATTER * _DIRT * dirt_map if dirt > 0.0 else None,
        drops=_drops(rain_rng, (shape[0], shape[1]), rain) if rain > 0.0 else None,
        directions=directions / np.linalg.norm(directions, axis=-1, keepdims=True) if glare else None,
    )


def glare_veil(angle: Floats, strength: float) -> Floats:
    """Glare [grey levels] at an angle from the sun [rad]."""
    veil = _HALO * np.exp(-((angle / _HALO_WIDTH) ** 2)) + _HAZE * np.exp(-angle / _HAZE_WIDTH)
    return np.asarray(255.0 * strength * veil, dtype=np.float32)


def dirt_layer(rng: np.random.Generator, shape: tuple[int, int], share: float) -> Floats:
    """Thickness (h, w), 0 to 1, of dirt that covers a share of an image: blotches with soft edges."""
    if share == 0.0:
        return np.zeros(shape, dtype=np.float32)
    blotches = fractal_noise(rng, shape, 1.5, (2.0 / max(shape), 0.03))
    edge = np.quantile(blotches, 1.0 - share)
    return np.asarray(np.clip((blotches - edge) / 0.35 + 0.5, 0.0, 1.0), dtype=np.float32)


def behind_dirt(image: GreyImage, dirt: Floats) -> GreyImage:
    """Grey image behind a layer of dirt."""
    dimmed = image * (1.0 - _DIRT * dirt) + _SCATTER * _DIRT * dirt * image.mean()
    return np.asarray(np.rint(dimmed), dtype=np.uint8)


def _drops(rng: np.random.Generator, shape: tuple[int, int], share: float) -> Drops:
    """Drops at random places until they cover the share of the image."""
    h, w = shape
    size = math.sqrt(h * w)
    cover = np.zeros(shape, dtype=np.float32)
    source = np.stack(np.meshgrid(np.arange(w), np.arange(h)), axis=-1).astype(np.float32)
    straight = source.copy()
    while cover.mean() < share:
        radius = size * float(np.exp(rng.uniform(*np.log(_DROP_RADII))))
        u, v = rng.uniform(0.0, w), rng.uniform(0.0, h)
        rows = slice(max(int(v - 1.3 * radius), 0), int(v + 1.3 * radius) + 1)
        columns = slice(max(int(u - radius), 0), int(u + radius) + 1)
        p = straight[rows, columns] - np.array([u, v], dtype=np.float32)
        r = np.hypot(p[..., 0], p[..., 1] / 1.25) / radius  # drops sag a little
        alpha = np.clip((1.0 - r) / 0.3, 0.0, 1.0)
        upside_down = np.array([u, v], dtype=np.float32) - 3.0 * p  # a drop shows about three times its own width
        inside = alpha[..., None] > 0.0
        source[rows, columns] = np.where(inside, upside_down, source[rows, columns])
        cover[rows, columns] = np.maximum(cover[rows, columns], 0.92 * alpha)
    return Drops(cover=cover, source=((source + 0.5) / _COARSE - 0.5).astype(np.float32))


_MOST_TAPS: Final = 16  # samples of the average over an exposure; more than a pixel apart they become visible
_LONGEST: Final = 0.2  # time between captures from which a velocity is derived [s]


class Twist(NamedTuple):
    """Velocity of a frame along its own axes."""

    v: FloatArray  # (3,) of its origin [m/s]
    w: FloatArray  # (3,) [rad/s]

    def seen_from(self, X_BC: FloatArray) -> "Twist":
        """Twist of a frame C that is fixed in this one, B."""
        R, p = X_BC[:3, :3], X_BC[:3, 3]
        return Twist(R.T @ (self.v + cross(self.w, p)), R.T @ self.w)


STILL: Final = Twist(np.zeros(3), np.zeros(3))


def twist_between(X_before: FloatArray, X_now: FloatArray, seconds: float) -> Twist:
    """Constant twist that moves a body from one pose (4, 4) to another; zero if the time is too long."""
    if not 0.0 < seconds <= _LONGEST:
        return STILL
    X = inverse(X_before) @ X_now
    turn = np.asarray(cv2.Rodrigues(X[:3, :3])[0], dtype=np.float64).ravel()
    translation: FloatArray = (np.eye(3) - 0.5 * skew(turn)) @ X[:3, 3]  # to turn^2/12: 0.02 % at 3 deg
    return Twist(translation / seconds, turn / seconds)


def moved(X_WB: FloatArray, twist: Twist, seconds: float) -> FloatArray:
    """Pose (4, 4) of a body that starts at X_WB (4, 4) and moves with a constant twist."""
    turn, shift = twist.w * seconds, twist.v * seconds
    return X_WB @ transform(so3_exp(turn), shift + 0.5 * cross(turn, shift))


@dataclass(frozen=True, slots=True, kw_only=True)
class Shutter:
    """Exposure times of an image's rows, centred on the time stamp of the image."""

    exposure: float  # [s]
    rolling: float  # delay of the last row's exposure after the first row's [s]

    @property
    def is_instant(self) -> bool:
        """True if nothing can move during the exposure."""
        return self.exposure == 0.0 and self.rolling == 0.0

    def exposed(
        self, image: NDArray[np.uint8], lens: LensMap, nearness: Floats, twist: Twist, focal_length: float
    ) -> Floats:
        """Camera image as the mean over the exposure.

        Each pixel is looked up where its point was in the pinhole image, by its depth. Background uncovered at the
        edges of objects is approximated by its surroundings.

        Args:
            image: of the pinhole at mid-exposure, (h, w) or (h, w, 3).
            lens: the camera's pixels in it.
            nearness: inverse depth in the pinhole image (h, w) [1/m].
            twist: of the camera.
            focal_length: of the pinhole [px].
        """
        rows = np.linspace(-0.5, 0.5, len(lens.pixels), dtype=np.float32)[:, None] * np.float32(self.rolling)
        flow = _flow(lens.rays, _sampled(nearness, lens.pixels), twist, focal_length)
        if self.rolling > 0.0:  # the point's depth is that at its true place
            flow = _flow(lens.rays, _sampled(nearness, lens.pixels - rows[..., None] * flow), twist, focal_length)
        taps = self._taps(flow)
        times = self.exposure * ((np.arange(taps) + 0.5) / taps - 0.5)
        interpolation = cv2.INTER_CUBIC if taps == 1 else cv2.INTER_LINEAR  # cubic would not sharpen a mean of many
        total: Floats = np.zeros((*lens.pixels.shape[:2], *image.shape[2:]), dtype=np.float32)
        for time in times:
            cv2.accumulate(lens.apply(image, -(rows + np.float32(time))[..., None] * flow, interpolation), total)
        return np.asarray(total / np.float32(taps), dtype=np.float32)

    def _taps(self, flow: Floats) -> int:
        """Number of samples for which 99 % of the image moves by at most a pixel between two of them."""
        fastest = float(np.quantile(np.abs(flow[::8, ::8]).max(axis=-1), 0.99))
        return int(np.clip(np.ceil(fastest * self.exposure), 1, _MOST_TAPS))


def _sampled(nearness: Floats, pixels: Floats) -> Floats:
    return np.asarray(resampled(nearness, pixels, cv2.INTER_NEAREST), dtype=np.float32)


def _flow(rays: Floats, nearness: Floats, twist: Twist, focal_length: float) -> Floats:
    """Velocity (h, w, 2) of static points in the image of a moving pinhole [px/s]."""
    v, w = twist.v.astype(np.float32), twist.w.astype(np.float32)
    x, y = rays[..., 0], rays[..., 1]
    depth_rate = -v[2] * nearness - (w[0] * y - w[1] * x)  # over the depth [1/s]
    x_rate = -v[0] * nearness - (w[1] - w[2] * y) - x * depth_rate
    y_rate = -v[1] * nearness - (w[2] * x - w[0]) - y * depth_rate
    return np.float32(focal_length) * np.stack([x_rate, y_rate], axis=-1)
