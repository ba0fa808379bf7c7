"""Templates of a trace in a patch of ground, and the patch that is cut out of an image.

The logarithm turns shadows into steps, which a clipped high-pass filter reduces to thin lines. The local contrast is
normalised, so that exposure, contrast and haze have no effect.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from importlib.resources import files
from typing import Final, NamedTuple

import cv2
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import ArrayLike, NDArray

from sensors.messages import GreyImage
from sensors.sand.trace_rig import TraceRig
from vehicle.frames import FloatArray, inverse

FloatImage = NDArray[np.float32]

STEP: Final = 0.002  # pixel size: resolves lug marks of 5 mm; the camera resolves 1.2 mm [m]
HALF_WIDTH: Final = 0.32  # of the patch: a trace 0.7 m long at 18 deg, plus the width of the templates [m]
BAND: Final = 0.04  # length over which the trace is averaged: one and a half lugs [m]
_ROWS: Final = round(BAND / STEP)  # of a band
_FARTHEST: Final = 0.72  # behind the wheel: older parts carry no information on recent slip [m]
_NEEDED: Final = 4  # least number of bands
_MARGIN: Final = 0.016  # cut off at both ends for the wheel's lugs and width, and for roll and pitch of 0.5 deg [m]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GroundPatch:
    """Map of the visible ground behind the wheel: rows go backwards, columns to the left.

    Raises:
        ValueError: if the camera sees too little of the ground behind the wheel.
    """

    rig: TraceRig
    behind: FloatArray = field(init=False)  # (rows,) of each row from the wheel's lowest point B [m]
    columns: int = field(init=False)
    _maps: tuple[NDArray[np.int16], NDArray[np.uint16]] = field(init=False)

    def __post_init__(self) -> None:
        begin, end = self._visible()
        rows = _ROWS * int((end - begin) / BAND + 1e-6)
        if rows < _NEEDED * _ROWS:
            raise ValueError(
                f"rig: the camera sees the ground {begin:.2f} to {end:.2f} m behind the wheel; it has to be seen "
                f"over at least {_NEEDED * BAND:.2f} m"
            )
        behind = begin + STEP * (0.5 + np.arange(rows))
        columns = 2 * round(HALF_WIDTH / STEP) + 1
        lateral = STEP * (np.arange(columns) - columns // 2)
        at = self._pixels(*np.meshgrid(behind, lateral, indexing="ij")).astype(np.float32)
        maps = cv2.convertMaps(at[..., 0], at[..., 1], cv2.CV_16SC2)
        for name, value in (("behind", behind), ("columns", columns), ("_maps", maps)):
            object.__setattr__(self, name, value)

    @property
    def bands(self) -> FloatArray:
        """Centres of the bands behind the wheel [m]."""
        return banded(self.behind)

    def rectified(self, image: GreyImage) -> NDArray[np.uint8]:
        """Image rectified to a map of the ground."""
        return np.asarray(cv2.remap(image, *self._maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE))

    def along(self, curve: Curve, image: GreyImage, half: int) -> NDArray[np.uint8]:
        """Image (rows, 2 half + 1) of the ground beside a curve: rows lie square to it, columns go to the left."""
        patch = self.rectified(image)
        across = STEP * np.arange(-half, half + 1.0)
        v = (curve.behind[:, None] - across * curve.left[:, None] - self.behind[0]) / STEP
        u = (curve.lateral[:, None] + across * curve.back[:, None]) / STEP + self.columns // 2
        return np.asarray(
            cv2.remap(
                patch, u.astype(np.float32), v.astype(np.float32), cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
            )
        )

    def _pixels(self, behind: FloatArray, lateral: FloatArray) -> FloatArray:
        """Pixels in the distorted image of points behind and beside the wheel; level ground, no sinkage."""
        x, y = self.rig.wheel
        points = np.stack([x - behind, y + lateral, np.zeros_like(behind)], axis=-1)
        X_CR = inverse(self.rig.X_RC)
        p_C = points @ X_CR[:3, :3].T + X_CR[:3, 3]
        return self.rig.camera.pixels(p_C[..., :2] / p_C[..., 2:])

    def _visible(self) -> tuple[float, float]:
        """First and last visible distance behind the wheel, limited by the wheel and the image's edge [m]."""
        s = np.arange(0.0, _FARTHEST, STEP)
        camera, r = self.rig.X_RC[:3, 3], self.rig.wheel_radius
        ahead, height = camera[0] - self.rig.wheel[0], camera[2]
        # visible where the ray to the camera passes behind the hub, r above B, at a distance of at least r
        beyond = s * (height - r) - r * ahead >= r * np.hypot(ahead + s, height)
        at = self._pixels(s, np.zeros_like(s))
        inside = (at >= 0.0).all(axis=1) & (at[:, 0] < self.rig.camera.width) & (at[:, 1] < self.rig.camera.height)
        visible = s[beyond & inside]
        return (visible[0] + _MARGIN, visible[-1] - _MARGIN) if len(visible) else (0.0, 0.0)


class Curve(NamedTuple):
    """Places along a curve on the ground, ``STEP`` apart along it, the nearest to the wheel first."""

    behind: FloatArray  # (rows,) the wheel [m]
    lateral: FloatArray  # (rows,) from the wheel, + left [m]
    back: FloatArray  # (rows,) backward and
    left: FloatArray  # (rows,) leftward part of the unit tangent

    @classmethod
    def through(cls, behind: FloatArray, lateral: FloatArray) -> Curve:
        """Curve through places ``STEP`` apart in the first coordinate."""
        along = STEP * np.arange(len(behind))
        arc = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(behind), np.diff(lateral)))])
        x, y = np.interp(along, arc, behind), np.interp(along, arc, lateral)
        back, left = np.gradient(x, STEP), np.gradient(y, STEP)
        size = np.hypot(back, left)
        return cls(x, y, back / size, left / size)

    @property
    def directions(self) -> FloatArray:
        """Directions (bands,) in which the wheel travelled, relative to the rover's x axis, + left [rad]."""
        back, left = banded(self.back), banded(self.left)
        return np.arctan2(-left, back)


def banded(values: FloatArray) -> FloatArray:
    """Means (bands, ...) over the rows of each band."""
    means: FloatArray = values.reshape(-1, _ROWS, *values.shape[1:]).mean(axis=1)
    return means


CHANNELS: Final = 3
MARKS: Final = 1  # the channel of the lugs
_DARK: Final = 4.0  # grey level below which noise and JPEG artefacts dominate
_ACROSS: Final = (1, 25)  # window of the mean across the trace that is subtracted: 5 cm, half a wheel [px of 2 mm]
_SATURATION: Final = 0.22  # clipping of log brightness: lug and wall marks reach it, shadow edges reach 1 and more
_SURROUNDINGS: Final = (41, 41)  # window of the mean that is subtracted [px]
_CONTRAST: Final = (61, 61)  # window of the contrast normalisation [px]
_NOISE: Final = 0.02  # contrast of the camera's noise on sand, in log brightness
_LUG_ACROSS: Final = (15, 1)  # lug marks are straight over 3 cm, pebbles and ripples are not [px]
_WALL_ALONG: Final = (3, 25)  # walls are straight over 5 cm along [px]


def channels(patch: NDArray[np.uint8]) -> FloatImage:
    """Brightness, strength of lug marks and strength of walls (rows, columns, 3) of a ground image."""
    bright = _normalised(patch)
    lugs = np.abs(_along(_smooth(cv2.GaussianBlur(bright, (0, 0), 1.2), _LUG_ACROSS)))
    walls = np.abs(_across(_smooth(bright, _WALL_ALONG)))
    # saturated at the median strength of marks, so that one bright edge does not dominate
    return np.asarray(cv2.merge([bright, lugs / (lugs + 0.5), walls / (walls + 0.35)]), dtype=np.float32)


def _normalised(patch: NDArray[np.uint8]) -> FloatImage:
    log = np.asarray(cv2.LUT(patch, np.log(np.arange(256, dtype=np.float32) + _DARK)), dtype=np.float32)
    log -= _smooth(log, _ACROSS)
    np.clip(log, -_SATURATION, _SATURATION, out=log)
    log -= _smooth(log, _SURROUNDINGS)
    # beside an area of one grey level (glare, dirt, a black edge), where its running sums end just below zero
    power = np.maximum(_smooth(log * log, _CONTRAST), np.float32(0.0))
    log /= np.sqrt(power) + np.float32(_NOISE)
    np.clip(log, -2.0, 2.0, out=log)
    return np.asarray(log, dtype=np.float32)


def _smooth(image: ArrayLike, size: tuple[int, int]) -> FloatImage:
    """Mean over (columns, rows)."""
    return np.asarray(cv2.blur(np.asarray(image, dtype=np.float32), size), dtype=np.float32)


def _along(image: FloatImage) -> FloatImage:
    """Differences over 8 mm along the trace, 0 at the ends."""
    out = np.zeros_like(image)
    np.subtract(image[4:], image[:-4], out=out[2:-2])
    return out


def _across(image: FloatImage) -> FloatImage:
    """Differences over 8 mm across the trace, 0 at the ends."""
    out = np.zeros_like(image)
    np.subtract(image[:, 4:], image[:, :-4], out=out[:, 2:-2])
    return out


Profiles = NDArray[np.float32]  # (..., CHANNELS, length across)

HALF: Final = round(0.086 / STEP)  # of a template: half the rut, its berm, and the shadow of the wall [px]
WIDTH: Final = 2 * HALF + 1
AZIMUTHS: Final = 24  # of the sun relative to the direction of the trace; the first is straight ahead
# A wall casts a shadow whose length depends on the sun's elevation and the rut's depth alike.
SHADOWS: Final = np.array([0.012, 0.020, 0.032])  # length of a shadow across its wall, with the sun square to it [m]
SLIPS: Final = np.radians(np.linspace(-15.0, 15.0, 13))  # of the front wheel's rut, see ``path_state.with_fronts``
FILE: Final = "templates.npz"
_PARTS: Final = ("profiles", "shaded")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Templates:
    """Mean cross profiles of the rut, each channel with mean 0, in use with norm 1."""

    profiles: Profiles  # (AZIMUTHS, shadows, slips, CHANNELS, WIDTH) in the sun
    shaded: Profiles  # (slips, CHANNELS, WIDTH) in shade


def at_slips(profiles: Profiles, slips: FloatArray) -> Profiles:
    """Interpolate profiles (..., slips, CHANNELS, WIDTH) at slips (n,) [rad]: (..., n, CHANNELS, WIDTH)."""
    at = np.clip(np.interp(slips, SLIPS, np.arange(len(SLIPS))), 0.0, len(SLIPS) - 1.0)
    low = np.minimum(at.astype(int), len(SLIPS) - 2)
    share = (at - low).astype(np.float32)[:, None, None]
    between: Profiles = profiles.take(low, axis=-3)
    step: Profiles = profiles.take(low + 1, axis=-3) - between
    step *= share
    between += step
    return between


def shipped_templates() -> Templates:
    """Templates that are part of this package."""
    with files(__package__).joinpath(FILE).open("rb") as stream, np.load(stream) as kept:
        parts = {name: unit(kept[name].astype(np.float32) * kept[f"{name}_scale"][..., None]) for name in _PARTS}
    return Templates(**parts)


_WORTH: Final = 4.0  # log likelihood per unit of correlation, by band of one image
_FORGETTING: Final = 0.99  # per image: the sun moves, and clouds appear
_NEGLIGIBLE: Final = 8.0  # difference of log likelihood to the best that is ignored
SEARCH: Final = round(0.034 / STEP)  # largest lateral distance of the trace from its prediction [px]
SIDE: Final = HALF + SEARCH + 30  # of an image along a trace, with the window of the contrast [px]
_FLAT: Final = 1e-6  # norm of a profile without any marks


def straightened(image: FloatImage, lateral: FloatArray, margin: int = SEARCH) -> Profiles:
    """Profiles (bands, CHANNELS, WIDTH + 2 margin) along a line at ``lateral`` (rows,) from the middle [m]."""
    rows, columns = image.shape[:2]
    reach = np.arange(-HALF - margin, HALF + margin + 1)
    straight = image[:, columns // 2 + reach[0] : columns // 2 + reach[-1] + 1]
    if lateral.any():
        u = (lateral[:, None] / STEP + columns // 2 + reach).astype(np.float32)
        v = np.repeat(np.arange(rows, dtype=np.float32)[:, None], len(reach), axis=1)
        straight = np.asarray(cv2.remap(image, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), np.float32)
    profiles: Profiles = straight.reshape(-1, _ROWS, len(reach), CHANNELS).mean(axis=1).transpose(0, 2, 1)
    return profiles


def windows(profiles: Profiles) -> Profiles:
    """All windows of a template's width (..., shifts, CHANNELS, WIDTH), each of mean 0 and norm 1."""
    sums, squares = (_sums(values)[..., None] for values in (profiles, np.square(profiles)))
    lengths = np.sqrt(np.maximum(squares - sums**2 / WIDTH, 0.0)) + _FLAT
    parts = (sums / WIDTH).astype(np.float32), (1.0 / lengths).astype(np.float32)
    mean, scale = (np.swapaxes(part, -2, -3) for part in parts)
    cut = np.swapaxes(sliding_window_view(profiles, WIDTH, axis=-1), -2, -3)
    free = np.subtract(cut, mean, order="C")
    free *= scale
    return free


def unit(profiles: Profiles) -> Profiles:
    """Profiles normalised to mean 0 and norm 1."""
    ones = np.full(profiles.shape[-1], 1.0 / profiles.shape[-1], dtype=np.float32)
    free = profiles - (profiles @ ones)[..., None]
    free /= np.sqrt(np.einsum("...w,...w->...", free, free))[..., None] + np.float32(_FLAT)
    return free


def _sums(values: Profiles) -> FloatArray:
    """Sums over all windows of a template's width (..., shifts), by cumulative sums."""
    running = np.zeros((*values.shape[:-1], values.shape[-1] + 1))
    np.cumsum(values, axis=-1, out=running[..., 1:])
    sums: FloatArray = running[..., WIDTH:] - running[..., :-WIDTH]
    return sums


def correlation(cut: Profiles, templates: Profiles) -> FloatArray:
    """Correlation (bands, CHANNELS, shifts) of unit windows (bands, shifts, ...) and unit templates (bands, ...)."""
    return np.asarray((np.swapaxes(cut, 1, 2) @ templates[..., None])[..., 0], dtype=np.float64)


def place(correlations: FloatArray, std: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Offset (bands,) [m] of the best match by correlations (bands, CHANNELS, shifts), and their mean there.

    Where a wall breaks off, brightness shows where the sand lies, and not where the wheel was: it finds no places. A
    stone beside one band is not beside its neighbours.
    """
    by_wheel = cv2.blur(correlations[:, MARKS:].mean(axis=1), (1, 3), borderType=cv2.BORDER_REPLICATE)
    off, _ = peaks(np.asarray(by_wheel), std)
    at = np.rint(off / STEP).astype(int) + correlations.shape[-1] // 2
    return off, correlations.mean(axis=1)[np.arange(len(off)), at]


def rut_score(scores: ArrayLike, marks: ArrayLike) -> FloatArray:
    """Score of a rut: mean correlation of all channels, with double weight of the lug marks.

    Shadows have edges like walls and are as dark as ruts, but only wheels leave lug marks.
    """
    more: FloatArray = (CHANNELS * np.asarray(scores) + np.asarray(marks)) / (CHANNELS + 1)
    return more


def peaks(scores: FloatArray, std: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Offset (bands,) [m] of the best match in scores (bands, shifts), and its score.

    Offsets are penalised by their distance in units of ``std`` (bands,) [m].
    """
    shifts = (np.arange(scores.shape[1]) - scores.shape[1] // 2) * STEP
    penalty = 0.03 * (shifts / np.maximum(std, 0.004)[:, None]) ** 2
    k = np.clip((scores - penalty).argmax(axis=1), 1, len(shifts) - 2)
    band = np.arange(len(scores))
    before, at, after = scores[band, k - 1], scores[band, k], scores[band, k + 1]
    bend = before - 2.0 * at + after
    finer = np.where(bend < -1e-9, 0.5 * (before - after) / np.minimum(bend, -1e-9), 0.0)
    return shifts[k] + STEP * np.clip(finer, -1.0, 1.0), at


def unknown_sun() -> FloatArray:
    """Uniform log likelihood (AZIMUTHS, shadows) of the sun's azimuth in the world, and of its shadows."""
    return np.zeros((AZIMUTHS, len(SHADOWS)))


def probable(sun: FloatArray) -> NDArray[np.bool_]:
    """Mask (AZIMUTHS, shadows) of suns that are not improbable."""
    worth: NDArray[np.bool_] = sun > sun.max() - _NEGLIGIBLE
    return worth


def lit(profiles: Profiles, direction: float) -> Profiles:
    """Profiles (AZIMUTHS, shadows, ...) of a trace in a world direction [rad], by the sun's azimuth in the world."""
    turn, share = _turned(np.array([direction]))
    at, part = np.arange(AZIMUTHS) + turn, np.float32(share[0])
    between: Profiles = (1 - part) * profiles[at % AZIMUTHS] + part * profiles[(at + 1) % AZIMUTHS]
    return between


def likely(profiles: Profiles, sun: FloatArray, directions: FloatArray) -> Profiles:
    """Expected profiles (n, CHANNELS, WIDTH) from those of all suns (AZIMUTHS, shadows, n, CHANNELS, WIDTH).

    Each sun counts with its probability; ``directions`` (n,) are those of the trace in the world [rad].
    """
    belief = np.exp(sun - sun.max())
    turn, share = _turned(directions)
    at = (np.arange(AZIMUTHS)[:, None] - turn) % AZIMUTHS
    weights = (1.0 - share) * np.moveaxis(belief[at], 2, 0) + share * np.moveaxis(belief[at - 1], 2, 0)
    mixed: Profiles = np.einsum("ean,aencw->ncw", (weights / belief.sum()).astype(np.float32), profiles, optimize=True)
    return mixed


def weighed(sun: FloatArray, profiles: Profiles, observed: Profiles, directions: FloatArray) -> FloatArray:
    """Log likelihood of suns after observed rut profiles (n, CHANNELS, WIDTH); the others as in ``likely``."""
    scores = np.einsum("aencw,ncw->ean", profiles, observed, optimize=True) / CHANNELS
    turn, share = _turned(directions)
    at, band = (np.arange(AZIMUTHS)[:, None] + turn) % AZIMUTHS, np.arange(len(directions))
    by_sun = (1.0 - share) * scores[:, at, band] + share * scores[:, (at + 1) % AZIMUTHS, band]
    belief: FloatArray = _FORGETTING * sun + _WORTH * by_sun.sum(axis=-1).T
    belief -= belief.max()
    return belief


def _turned(directions: FloatArray) -> tuple[NDArray[np.intp], FloatArray]:
    """Steps (n,) of the azimuth in the world to that relative to a trace, as a whole number and the rest."""
    turn = -directions * AZIMUTHS / (2.0 * math.pi)
    whole = np.floor(turn)
    return whole.astype(np.intp), turn - whole
