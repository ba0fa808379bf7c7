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
from typing import Final

import numpy as np

from estimators.slip.trace_tracker.templates import (
    SHADOWS,
    SLIPS,
    GroundPatch,
    Lesson,
    Templates,
    learned,
    lesson,
    save,
)
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
