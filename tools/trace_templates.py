"""Training of the trace tracker's templates: ``python tools/trace_templates.py FILE``, some minutes.

A rover crosses simulated sand with a wheel slip that sweeps from one side to the other, with the sun in many directions
and at heights that cast shadows of three lengths into ruts of two depths; four passes are in shade. The seeds differ
from those of all evaluation sequences.
"""

import math
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimators.slip.trace_tracker.templates import (
    AZIMUTHS,
    BAND,
    CHANNELS,
    HALF,
    SHADOWS,
    SIDE,
    SLIPS,
    STEP,
    WIDTH,
    Curve,
    GroundPatch,
    Profiles,
    Templates,
    banded,
    channels,
    straightened,
)
from sensors.messages import GreyImage
from sensors.sand.rover_pass import RoverPass, route_of
from sensors.sand.trace_camera import TraceCamera, Webcam
from sensors.sand.trace_rig import nominal_rig
from sensors.sand.world import SandWorld, Sun
from vehicle.frames import FloatArray, Pose2
from vehicle.rover.description import Rover, load_rover
from vehicle.rover.terrain import Terrain
from vehicle.rover.truth import RoverTruth

_SEED: Final = 900
_KINDS: Final = ("uniform", "pebbles", "ripples")
_AZIMUTHS: Final = np.radians(np.arange(0.0, 181.0, 15.0))  # mirrored images cover the other side
_SHADES: Final = (("uniform", Sun(azimuth=1.0, elevation=0.6)), ("pebbles", Sun(azimuth=2.0, elevation=0.8)))
_SINKAGES: Final = (0.016, 0.011)  # of El Dorado II on beach sand by the simulated soil, and of a lighter one [m]
_FRAMES: Final = 300  # per pass: 4.8 m
_LEAD: Final = 45  # frames before the first image, in which the trace fills the view
_EVERY: Final = 4  # frames between images: 6 cm, so that each shows new sand


@dataclass(frozen=True, slots=True, kw_only=True)
class _Sweep(RoverPass):
    def slip_angles(self, rng: np.random.Generator) -> FloatArray:
        """Slip angles from the largest of the templates to the smallest [rad], each for the same time."""
        swept: FloatArray = SLIPS[-1] * np.linspace(1.0, -1.0, self.frames)
        return swept


_AZIMUTH_KERNEL: Final = math.radians(6.0)  # width of the kernel over the sun's azimuth
_SLIP_KERNEL: Final = math.radians(1.25)  # the same over slip
_SHADED: Final = 0.68  # largest grey level of a band in shadow, relative to the brightest sand


class Lesson(NamedTuple):
    """Profiles of one image, straightened along the true trace."""

    profiles: Profiles  # (n, CHANNELS, WIDTH)
    slips: FloatArray  # (n,) of the front wheel's rut, see ``path_state.with_fronts`` [rad]
    azimuths: FloatArray  # (n,) of the sun relative to the trace, + left [rad]
    shadow: float  # length of the shadow across a wall, see ``SHADOWS`` [m]
    shaded: NDArray[np.bool_]  # (n,) True: in shadow


def lesson(
    patch: GroundPatch, image: GreyImage, line: FloatArray, front: FloatArray, azimuth: float, shadow: float
) -> Lesson:
    """Training sample from an image with the rear wheel's rut along ``line`` and the front one's along ``front``.

    Both are (n, 2) in R, nearest first [m]. The sun's azimuth is relative to the rover's x axis [rad]. Bands beyond the
    line's ends are left out.
    """
    x, y = patch.rig.wheel
    behind = x - line[:, 0]
    curve = Curve.through(patch.behind, np.interp(patch.behind, behind, line[:, 1] - y))
    bands = banded(curve.behind)
    use = (bands > behind[0] + 0.5 * BAND) & (bands < behind[-1] - 0.5 * BAND)
    seen = patch.along(curve, image, SIDE)
    offset = np.interp(bands, behind, line[:, 1]) - np.interp(bands, x - front[:, 0], front[:, 1])
    return Lesson(
        profiles=straightened(channels(seen), np.zeros(len(seen)), margin=0)[use],
        slips=np.arctan2(offset * np.cos(curve.directions), patch.rig.wheelbase)[use],
        azimuths=(azimuth - curve.directions)[use],
        shadow=shadow,
        shaded=_shaded(seen)[use],
    )


def learned(lessons: Sequence[Lesson]) -> Templates:
    """Templates from lessons; each is used twice, also mirrored."""
    shape = (AZIMUTHS, len(SHADOWS), len(SLIPS))
    sunny, in_sun = np.zeros((*shape, CHANNELS, WIDTH)), np.zeros(shape)
    dark, in_shade = np.zeros((len(SLIPS), CHANNELS, WIDTH)), np.zeros(len(SLIPS))
    for one in lessons:
        level = int(np.argmin(np.abs(SHADOWS - one.shadow)))
        for sign in (1, -1):
            profiles = one.profiles[..., ::sign]
            profiles = profiles - profiles.mean(axis=-1, keepdims=True)
            slip = _near(sign * one.slips, SLIPS, _SLIP_KERNEL)
            sun = _near(sign * one.azimuths, np.linspace(0.0, 2.0 * math.pi, AZIMUTHS, endpoint=False), _AZIMUTH_KERNEL)
            weights = sun[:, :, None] * slip[:, None, :] * ~one.shaded[:, None, None]
            sunny[:, level] += np.einsum("nas,ncw->ascw", weights, profiles)
            in_sun[:, level] += weights.sum(axis=0)
            dark += np.einsum("ns,ncw->scw", slip * one.shaded[:, None], profiles)
            in_shade += (slip * one.shaded[:, None]).sum(axis=0)
    return Templates(profiles=_mean(sunny, in_sun), shaded=_mean(dark, in_shade))


def _shaded(seen: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Mask (bands,) of bands of a trace, in the middle of an image, in shadow."""
    middle = seen[:, seen.shape[1] // 2 - HALF : seen.shape[1] // 2 + HALF + 1].reshape(-1, round(BAND / STEP) * WIDTH)
    dark: NDArray[np.bool_] = np.median(middle, axis=1) < _SHADED * np.percentile(seen, 95)
    return dark


def _near(values: FloatArray, nodes: FloatArray, width: float) -> FloatArray:
    """Gaussian weights (n, nodes) of angles by their distance from nodes [rad]."""
    off = (values[:, None] - nodes + math.pi) % (2.0 * math.pi) - math.pi
    weights: FloatArray = np.exp(-0.5 * (off / width) ** 2)
    return weights


def _mean(total: FloatArray, weight: FloatArray) -> Profiles:
    return np.asarray(total / np.maximum(weight, 1e-9)[..., None, None], dtype=np.float32)


def save(templates: Templates, path: Path) -> None:
    """Save templates as bytes with a scale for each, the format of ``shipped_templates``."""
    kept = {}
    for name in ("profiles", "shaded"):
        profiles = getattr(templates, name)
        scale = np.maximum(np.abs(profiles).max(axis=-1), 1e-6) / 127.0
        kept[name] = np.rint(profiles / scale[..., None]).astype(np.int8)
        kept[f"{name}_scale"] = scale.astype(np.float32)
    np.savez_compressed(path, **kept)


def train_templates(rover: Rover) -> Templates:
    """Templates for the wheels and the camera of a rover."""
    suns = [(float(azimuth), float(shadow)) for shadow in SHADOWS for azimuth in _AZIMUTHS]
    lessons: list[Lesson] = []
    for k, (azimuth, shadow) in enumerate(suns):
        sinkage = _SINKAGES[k % 2]
        sun = Sun(azimuth=azimuth, elevation=math.atan2(sinkage, shadow))
        lessons += _lessons(rover, _KINDS[k % len(_KINDS)], sun, _SEED + k, sinkage, shadow)
    for k, (kind, sun) in enumerate(_SHADES):
        for sinkage in _SINKAGES:
            shaded = _lessons(rover, kind, sun, _SEED + 50 + k, sinkage, 0.0, overcast=True)
            lessons += [one._replace(shaded=np.ones(len(one.slips), dtype=bool)) for one in shaded]
    return learned(lessons)


def _lessons(
    rover: Rover, kind: str, sun: Sun, seed: int, sinkage: float, shadow: float, *, overcast: bool = False
) -> Iterator[Lesson]:
    """Lessons from one pass."""
    path_rng, world_rng, camera_rng = np.random.default_rng([seed, 99]).spawn(3)
    truths = _Sweep(frames=_FRAMES, profile="fast", sinkage=sinkage).truths(rover, Terrain(), path_rng)
    route = route_of(truths)
    world = SandWorld(kind, rng=world_rng, rover=rover, terrain=Terrain(), route=route, sun=sun, overcast=overcast)
    rig = nominal_rig(rover)
    camera = TraceCamera(world, rig, Webcam(), camera_rng)
    patch = GroundPatch(rig=rig)
    world.drive(truths[:_LEAD])
    for k in range(_LEAD, len(truths)):
        world.drive([truths[k]])
        if (k - _LEAD) % _EVERY == 0:
            image, line = camera.sample(truths[k]), world.trace_truth(truths[k]).line
            azimuth = sun.azimuth - float(truths[k].pose[2])
            yield lesson(patch, image, line, _front_rut(truths[: k + 1]), azimuth, shadow)


def _front_rut(truths: Sequence[RoverTruth]) -> FloatArray:
    """Past positions of the left front wheel (n, 2) in R of the last frame, newest first [m]."""
    positions = np.array([truth.wheel_positions[0, :2] for truth in truths])
    return Pose2(*truths[-1].pose.tolist()).inverse().apply(positions)[::-1]


if __name__ == "__main__":
    save(train_templates(load_rover("el_dorado_ii")), Path(sys.argv[1]))
