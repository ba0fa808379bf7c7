"""Procedural, periodic textures of roads, fields, plants and houses, made of fractal noise."""

from typing import Final

import cv2
import numpy as np
import scipy
from numpy.typing import NDArray

NoiseArray = NDArray[np.float32]
TextureArray = NDArray[np.uint8]

_FREQUENCIES: Final = (np.fft.fftfreq, np.fft.rfftfreq)  # of the rows and the columns of a real image's spectrum


def fractal_noise(
    rng: np.random.Generator, shape: tuple[int, int], slope: float, band: tuple[float, float]
) -> NoiseArray:
    """Periodic noise of zero mean and unit deviation with amplitude ~ f^-slope inside ``band`` [cycles/px]."""
    spectrum = scipy.fft.rfft2(rng.standard_normal(shape, dtype=np.float32))
    # Squared frequencies in single precision make this 25 % faster.
    down, along = (f(n).astype(np.float32) ** 2 for f, n in zip(_FREQUENCIES, shape, strict=True))
    square = down[:, None] + along[None, :]
    inside = (square >= np.float32(band[0]) ** 2) & (square <= np.float32(band[1]) ** 2) & (square > 0.0)
    np.maximum(square, np.float32(1.0 / max(shape)) ** 2, out=square)
    gain = np.power(square, np.float32(-0.5 * slope), out=np.zeros_like(square), where=inside)
    noise = scipy.fft.irfft2(spectrum * gain, s=shape)
    return np.asarray(noise / noise.std(), dtype=np.float32)


def to_bytes(image: NDArray[np.floating]) -> TextureArray:
    """Levels 0..1 as 0..255, saturated."""
    return np.clip(np.round(image * 255.0), 0, 255).astype(np.uint8)


def sigmoid(x: NoiseArray) -> NoiseArray:
    """Soft step from 0 to 1 around x = 0."""
    return np.asarray(0.5 + 0.5 * np.tanh(0.5 * x), dtype=np.float32)


def coloured(levels: NoiseArray, dark: tuple[float, float, float], bright: tuple[float, float, float]) -> NoiseArray:
    """Levels (h, w) in 0..1 as a colour ramp (h, w, 3)."""
    low, high = np.array(dark, dtype=np.float32), np.array(bright, dtype=np.float32)
    ramp = np.asarray(levels, dtype=np.float32)[..., None]
    return np.asarray(low + ramp * (high - low), dtype=np.float32)


def ground_detail(rng: np.random.Generator, size: int) -> TextureArray:
    """Relative brightness of four materials, (size, size, 4): asphalt, grass, gravel, and a mask of patches.

    The mean of each is 0.5. The spectra fall slowly, so that there are corners at any distance.
    """
    return np.stack([to_bytes(layer) for layer in (_asphalt(rng, size), *_soft_ground(rng, size))], axis=-1)


def _asphalt(rng: np.random.Generator, size: int) -> NoiseArray:
    """Aggregate, blotches, bright stones and cracks."""
    aggregate = fractal_noise(rng, (size, size), 0.3, (0.02, 0.4))
    blotches = fractal_noise(rng, (size, size), 0.5, (0.005, 0.12))
    stones = fractal_noise(rng, (size, size), 0.0, (0.03, 0.10))
    cracks = np.abs(fractal_noise(rng, (size, size), 1.7, (0.001, 0.06)))
    level = 0.5 + 0.09 * aggregate + 0.07 * blotches
    level += 0.20 * sigmoid(14.0 * (stones - 2.2)) - 0.10 * sigmoid(14.0 * (-stones - 2.3))
    level -= 0.28 * np.exp(-((cracks / 0.012) ** 2))
    return np.asarray(level, dtype=np.float32)


def _soft_ground(rng: np.random.Generator, size: int) -> tuple[NoiseArray, NoiseArray, NoiseArray]:
    """Grass in tufts, gravel, and the mask that mixes both."""
    blades = fractal_noise(rng, (size, size), 0.3, (0.015, 0.40))
    tufts = fractal_noise(rng, (size, size), 0.7, (0.003, 0.10))
    pebbles = fractal_noise(rng, (size, size), 0.2, (0.02, 0.2))
    patches = fractal_noise(rng, (size, size), 1.6, (0.0, 0.03))
    grass = 0.5 + 0.13 * blades + 0.10 * tufts
    gravel = 0.5 + 0.17 * pebbles * (0.6 + 0.4 * sigmoid(3.0 * tufts)) + 0.05 * blades
    mask = 0.5 + 0.15 * patches + 0.06 * tufts
    return grass, np.asarray(gravel, dtype=np.float32), mask


def foliage(rng: np.random.Generator, size: int = 256) -> TextureArray:
    """Leaves in clumps with dark gaps between them."""
    clumps = fractal_noise(rng, (size, size), 0.9, (0.01, 0.2))
    leaves = fractal_noise(rng, (size, size), 0.2, (0.06, 0.4))
    level = np.clip(0.48 + 0.20 * clumps + 0.16 * leaves, 0.0, 1.0)
    return to_bytes(coloured(level, (0.07, 0.12, 0.05), (0.52, 0.66, 0.30)))


def twigs(rng: np.random.Generator, size: int = 128) -> TextureArray:
    """A spray of leaves, (size, size, 4); the last channel is its opacity."""
    image = np.zeros((size, size, 4), dtype=np.float32)
    image[..., :3] = (0.22, 0.30, 0.12)  # colour of the gaps, which mipmaps mix in
    for _ in range(150):
        radius = 0.42 * size * np.sqrt(rng.uniform())
        angle = rng.uniform(0.0, 2.0 * np.pi)
        centre = 0.5 * size + radius * np.array([np.cos(angle), np.sin(angle)])
        shape = (rng.uniform(0.035, 0.06) * size, rng.uniform(0.015, 0.028) * size)
        level = float(np.clip(rng.normal(0.5, 0.2), 0.0, 1.0))
        leaf = (0.10 + 0.42 * level, 0.16 + 0.50 * level, 0.06 + 0.24 * level, 1.0)
        middle, axes = np.round(centre).astype(int).tolist(), np.round(shape).astype(int).tolist()
        cv2.ellipse(image, middle, axes, float(rng.uniform(0.0, 180.0)), 0.0, 360.0, leaf, thickness=-1)
    return to_bytes(image)


def bark(rng: np.random.Generator, size: int = 128) -> TextureArray:
    """Bark with furrows along the stem."""
    furrows = fractal_noise(rng, (size // 8, size), 0.4, (0.02, 0.4)).repeat(8, axis=0)
    grain = fractal_noise(rng, (size, size), 0.6, (0.02, 0.4))
    return to_bytes(coloured(0.45 + 0.16 * furrows + 0.12 * grain, (0.16, 0.12, 0.09), (0.55, 0.46, 0.37)))


def stone(rng: np.random.Generator, size: int = 256) -> TextureArray:
    """Weathered grey stone or concrete."""
    weather = fractal_noise(rng, (size, size), 1.2, (0.0, 0.1))
    grain = fractal_noise(rng, (size, size), 0.2, (0.05, 0.5))
    return to_bytes(coloured(0.5 + 0.13 * weather + 0.10 * grain, (0.32, 0.31, 0.29), (0.82, 0.80, 0.76)))


def courses(
    rng: np.random.Generator, size: int, *, rows: int, columns: int, joint: float, overlap: float
) -> tuple[NoiseArray, NoiseArray]:
    """Masonry in bond: brightness of the units, and mask that is 1 in units and 0 in joints, both (size, size).

    ``joint`` is the share of the joint in a course's height, ``overlap`` the shift between courses in units.
    """
    v = np.arange(size) * rows / size
    u = np.arange(size)[None, :] * columns / size + (np.floor(v)[:, None] % 2) * overlap
    inside_v = np.minimum(v % 1.0, 1.0 - v % 1.0)[:, None] > joint / 2
    inside_u = np.minimum(u % 1.0, 1.0 - u % 1.0) > joint / 2 * columns / rows
    tone = rng.normal(size=(rows, columns))
    row, column = np.floor(v).astype(int)[:, None] % rows, np.floor(u).astype(int) % columns
    return tone[row, column].astype(np.float32), (inside_v & inside_u).astype(np.float32)


def brick(rng: np.random.Generator, size: int = 512) -> TextureArray:
    """Brickwork in running bond; one repeat is 2.4 m."""
    tone, unit = courses(rng, size, rows=32, columns=10, joint=0.16, overlap=0.5)
    level = 0.45 + 0.13 * tone + 0.10 * fractal_noise(rng, (size, size), 0.7, (0.0, 0.4))
    bricks = coloured(level, (0.36, 0.17, 0.12), (0.78, 0.47, 0.36))
    return to_bytes(np.where(unit[..., None] > 0, bricks, np.float32(0.62)))


def tiles(rng: np.random.Generator, size: int = 512) -> TextureArray:
    """Overlapping roof tiles, darker towards the upper edge of each course; one repeat is 3 m."""
    tone, unit = courses(rng, size, rows=10, columns=14, joint=0.10, overlap=0.5)
    under_edge = (np.arange(size) * 10 / size % 1.0)[:, None]
    level = 0.55 + 0.12 * tone - 0.25 * under_edge + 0.10 * fractal_noise(rng, (size, size), 0.9, (0.0, 0.3))
    return to_bytes(coloured(level, (0.20, 0.13, 0.11), (0.68, 0.42, 0.33)) * (0.6 + 0.4 * unit[..., None]))


def planks(rng: np.random.Generator, size: int = 256) -> TextureArray:
    """Upright weathered boards; one repeat is 1.6 m."""
    tone, unit = courses(rng, size, rows=1, columns=8, joint=0.01, overlap=0.0)
    grain = fractal_noise(rng, (size // 16, size), 0.3, (0.02, 0.5)).repeat(16, axis=0)
    level = 0.5 + 0.10 * tone + 0.12 * grain + 0.08 * fractal_noise(rng, (size, size), 1.0, (0.0, 0.3))
    return to_bytes(coloured(level, (0.22, 0.18, 0.14), (0.66, 0.58, 0.48)) * (0.45 + 0.55 * unit[..., None]))


def window(rng: np.random.Generator, size: int = 64) -> TextureArray:
    """A white frame with a cross bar around panes that reflect some of the sky."""
    across = np.abs(np.linspace(-1.0, 1.0, size))
    frame = (across > 0.86) | (across < 0.06)
    streaks = fractal_noise(rng, (size, size), 1.0, (0.0, 0.2))
    panes = 0.18 + 0.10 * np.linspace(1.0, 0.0, size)[:, None] + 0.02 * streaks
    glass = coloured(np.asarray(panes, dtype=np.float32), (0.0, 0.02, 0.05), (0.85, 0.95, 1.0))
    return to_bytes(np.where((frame[:, None] | frame[None, :])[..., None], np.float32(0.86), glass))


def banded(rng: np.random.Generator, size: int = 128) -> TextureArray:
    """A white marker post with its black band and reflector, over one repeat of 1.2 m; dirt at the foot."""
    height = np.linspace(1.2, 0.0, size)[:, None]
    paint = np.broadcast_to(0.86 - 0.25 * np.exp(-height / 0.25), (size, size)).astype(np.float32)
    image = np.stack([paint, paint, paint * 0.97], axis=-1)
    image[((height > 0.72) & (height < 0.98))[:, 0]] = 0.10
    image[((height > 0.78) & (height < 0.92))[:, 0]] = (0.75, 0.16, 0.10)
    return to_bytes(image + 0.03 * fractal_noise(rng, (size, size), 0.8, (0.0, 0.4))[..., None])


def chevrons(rng: np.random.Generator, size: int = 128) -> TextureArray:
    """Black and white chevrons of a bend's marker board, one chevron a repeat."""
    v, u = np.mgrid[0:size, 0:size] / size
    white = ((u + np.abs(v - 0.5)) % 1.0) < 0.5
    level = np.where(white, 0.88, 0.09) + 0.02 * fractal_noise(rng, (size, size), 1.0, (0.0, 0.4))
    return to_bytes(np.repeat(level[..., None], 3, axis=-1))
