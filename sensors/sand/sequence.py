"""Labelled image sequences: views of a rover's camera with their ground truth, made on the fly."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final, NamedTuple

import numpy as np

from sensors.instruments.rover_navigation import RoverInstruments
from sensors.messages import RoverView
from sensors.sand.rig import nominal_rig
from sensors.sand.rover_pass import FRAME_TICKS, SPEED, RoverPass, SlipProfile, bare_stretches
from sensors.sand.trace import TraceTruth
from sensors.sand.trace_camera import TraceCamera, Webcam
from sensors.sand.trace_rig import TraceRig
from sensors.sand.world import SandWorld, Sun
from vehicle.clock import TICK
from vehicle.frames import FloatArray
from vehicle.rover.description import Rover
from vehicle.rover.terrain import Terrain
from vehicle.rover.truth import RoverTruth

_LEAD: Final = 45  # moments before the first image; the trace grows to the length of the view, 0.72 m


class Labelled(NamedTuple):
    """View with its ground truth."""

    view: RoverView
    truth: RoverTruth
    trace: TraceTruth


def labelled_sequence(
    kind: str,
    *,
    seed: int,
    frames: int,
    rover: Rover,
    profile: SlipProfile = "fast",
    bare: float = 0.25,
    terrain: Terrain | None = None,
    sun: Sun | None = None,
    webcam: Webcam | None = None,
) -> Iterator[Labelled]:
    """Images of a rover that crosses a kind of sand with prescribed slip.

    ``bare`` is the share of the path with a crust that takes no imprint.
    """
    pass_rng, rng = np.random.default_rng([seed, _LEAD]).spawn(2)
    length = (frames + _LEAD) * FRAME_TICKS * TICK * SPEED
    stretches = bare_stretches(pass_rng, length + rover.wheelbase, bare)
    ground = Terrain() if terrain is None else terrain
    rover_pass = RoverPass(frames=frames + _LEAD, profile=profile, bare=stretches)
    truths = rover_pass.truths(rover, ground, pass_rng)
    return recorded(truths, kind, rng=rng, rover=rover, terrain=ground, sun=sun, webcam=webcam, lead=_LEAD)


def recorded(
    truths: Sequence[RoverTruth],
    kind: str,
    *,
    rng: np.random.Generator,
    rover: Rover,
    terrain: Terrain,
    sun: Sun | None = None,
    webcam: Webcam | None = None,
    rig: TraceRig | None = None,
    lead: int = 0,
) -> Iterator[Labelled]:
    """Views at the moments of a drive, after the first ``lead`` of them."""
    world_rng, camera_rng, instrument_rng = rng.spawn(3)
    world = SandWorld(kind, rng=world_rng, rover=rover, terrain=terrain, route=route_of(truths), sun=sun)
    camera = TraceCamera(world, nominal_rig(rover) if rig is None else rig, webcam or Webcam(), camera_rng)
    instruments = RoverInstruments(rng=instrument_rng)
    world.drive(truths[:lead])
    for truth in truths[lead:]:
        world.drive([truth])
        readings = instruments.sample(truth)
        view = RoverView(
            tick=truth.tick,
            image=camera.sample(truth),
            heading=readings.heading,
            wheel_speeds=readings.wheel_speeds,
            steer=readings.steer,
        )
        yield Labelled(view, truth, world.trace_truth(truth))


def route_of(truths: Sequence[RoverTruth]) -> FloatArray:
    """Path of R's origin (n, 2) [m]."""
    return np.array([truth.pose[:2] for truth in truths])
