"""A rover's pass over sand with prescribed slip, and labelled image sequences of it.

Kinematics only: the body moves by its speed, heading and slip angle; the wheels point straight ahead.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final, Literal, NamedTuple

import numpy as np

from sensors.instruments.navigation import RoverInstruments
from sensors.messages import RoverView
from sensors.sand.trace_camera import TraceCamera, Webcam
from sensors.sand.trace_rig import nominal_rig
from sensors.sand.world import SandWorld, TraceTruth
from vehicle.clock import TICK
from vehicle.frames import FloatArray, rotation_zyx, transform
from vehicle.rover.description import Rover
from vehicle.rover.terrain import Terrain
from vehicle.rover.truth import RoverTruth

SlipProfile = Literal["none", "slow", "fast"]

FRAME_TICKS: Final = 200  # between images: 5 Hz (Reina 2008)
SPEED: Final = 0.08  # (Reina 2008) [m/s]
_SINKAGE: Final = 0.011  # mean and standard deviation of a light El Dorado II on beach sand, assumed [m]
_SINKAGE_STD: Final = 0.001  # [m]
_EDGE: Final = 0.03  # length of the transition between sand and crust [m]
_SHAKE: Final = (math.radians(0.22), 0.5)  # roll and pitch over relief: standard deviation [rad] and time [s], assumed
_WANDER: Final = (math.radians(1.5), 12.0)  # the same of the heading


@dataclass(frozen=True, slots=True, kw_only=True)
class RoverPass:
    """Prescription of a pass: ``frames`` moments at ``FRAME_TICKS``, from W's origin along x.

    ``slow`` is slip as in Fig. 8 of Reina 2008: none until the onset, then growing for part of a minute. ``fast``
    varies by 1.6 deg within 5 s about a mean of 6 to 11 deg.
    """

    frames: int  # at least 2
    profile: SlipProfile
    onset: float = 20.0  # of the slip, from the start [s]
    sinkage: float = _SINKAGE  # mean [m]
    bare: Sequence[tuple[float, float]] = ()  # stretches of x with a crust that takes no imprint [m]

    def truths(self, rover: Rover, terrain: Terrain, rng: np.random.Generator) -> list[RoverTruth]:
        """Truth at every moment."""
        dt = FRAME_TICKS * TICK
        slip = self.slip_angles(rng)
        psi = _wandering(rng, self.frames, dt, *_WANDER)
        psi -= psi[0]
        speed = SPEED * (1.0 + _wandering(rng, self.frames, dt, 0.03, 4.0))
        spin = 0.10 + _wandering(rng, self.frames, dt, 0.03, 6.0)  # slip ratio of the wheels
        shake = np.stack([_wandering(rng, self.frames, dt, *_SHAKE) for _ in range(2)], axis=-1)
        sinkage = self.sinkage + _wandering(rng, self.frames, dt, _SINKAGE_STD, 3.0)
        course = psi + slip
        steps = dt * speed[:-1, None] * _directions(0.5 * (course[:-1] + course[1:]))
        places = np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
        yaw_rate = np.gradient(psi, dt)
        velocity = np.column_stack([speed * np.cos(slip), speed * np.sin(slip), yaw_rate])
        turns = np.concatenate(
            [np.zeros((1, len(rover.wheels))), np.cumsum(dt * _wheel_speeds(rover, velocity, spin)[:-1], axis=0)]
        )
        truths = []
        n = len(rover.wheels)
        for k, (x, y, heading) in enumerate(np.column_stack([places, psi]).tolist()):
            c, s = math.cos(heading), math.sin(heading)
            at = rover.wheel_places @ np.array([[c, s], [-s, c]]) + [x, y]
            sinkages = sinkage[k] * self._soft(at[:, 0])
            along, across = _wheel_velocities(rover, velocity[k])
            X_WB = transform(_on(terrain, x, y, heading) @ rotation_zyx(0.0, shake[k, 0], shake[k, 1]), np.zeros(3))
            X_WB[:3, 3] = x, y, float(terrain.height(x, y)) - float(sinkages.mean())
            truth = RoverTruth(
                tick=k * FRAME_TICKS,
                pose=np.array([x, y, heading]),
                velocity=velocity[k],
                X_WB=X_WB,
                wheel_positions=np.column_stack([at, terrain.height(at[:, 0], at[:, 1]) - sinkages]),
                wheel_headings=np.full(n, heading),
                wheel_velocities=np.column_stack([along, across]),
                wheel_speeds=along / (rover.radius * (1.0 - spin[k])),
                wheel_turns=turns[k],
                steer=np.zeros(n),
                slip_ratios=np.full(n, spin[k]),
                slip_angles=np.arctan2(across, along),
                sinkages=sinkages,
                loads=np.full(n, 9.81 * rover.mass / n),
            )
            truths.append(truth)
        return truths

    def slip_angles(self, rng: np.random.Generator) -> FloatArray:
        """Slip angle of the body at every moment [rad]."""
        dt = FRAME_TICKS * TICK
        t = dt * np.arange(self.frames)
        noise = _wandering(rng, self.frames, dt, math.radians(0.25), 4.0)
        side = rng.choice((-1.0, 1.0))
        if self.profile == "none":
            return noise
        if self.profile == "slow":
            size, rise, std, time = rng.uniform(5.0, 9.0), 8.0, 0.5, 12.0
        else:
            size, rise, std, time = rng.uniform(6.0, 11.0), 1.4, 1.6, 5.0
        onset = 1.0 / (1.0 + np.exp(-(t - self.onset - 2.0 * rise) / rise))
        varying = size + _wandering(rng, self.frames, dt, std, time)
        slip: FloatArray = noise + side * np.radians(onset * varying)
        return slip

    def _soft(self, x: FloatArray) -> FloatArray:
        """1 on sand, 0 on crust."""
        soft = np.ones_like(x)
        for start, end in self.bare:
            soft *= np.clip(np.maximum(start - x, x - end) / _EDGE, 0.0, 1.0)
        return soft


def bare_stretches(rng: np.random.Generator, length: float, share: float) -> tuple[tuple[float, float], ...]:
    """Draw stretches of crust, 1.1 to 1.9 m long, which make up a ``share`` of a path of ``length`` [m]."""
    stretches = []
    x = 0.0
    while share > 0.0 and x < length:
        crust = rng.uniform(1.1, 1.9)
        sand = crust * (1.0 - share) / share
        stretches.append((x, x + crust))
        x += crust + sand
    return tuple(stretches)


def _wandering(rng: np.random.Generator, n: int, dt: float, std: float, time: float) -> FloatArray:
    """Smooth Gauss-Markov process with a standard deviation and a correlation time [s]."""
    kept = math.exp(-dt / time)
    noise = rng.standard_normal(n)
    x = np.empty(n)
    x[0] = noise[0]
    for k in range(1, n):
        x[k] = kept * x[k - 1] + math.sqrt(1.0 - kept**2) * noise[k]
    reach = max(1, round(0.35 * min(time, 5.0) / dt))  # a mass moves without corners
    smooth = np.convolve(np.pad(x, reach, mode="edge"), np.hanning(2 * reach + 3)[1:-1], mode="valid")
    scaled: FloatArray = std * smooth / np.hanning(2 * reach + 3).sum()
    return scaled


def _directions(angle: FloatArray) -> FloatArray:
    return np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def _wheel_velocities(rover: Rover, velocity: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Velocity of every wheel (..., n) along and across the body [m/s]."""
    v_x, v_y, yaw_rate = (velocity[..., k, None] for k in range(3))
    x, y = rover.wheel_places.T
    return v_x - yaw_rate * y, v_y + yaw_rate * x


def _wheel_speeds(rover: Rover, velocity: FloatArray, spin: FloatArray) -> FloatArray:
    along, _ = _wheel_velocities(rover, velocity)
    return along / (rover.radius * (1.0 - spin[:, None]))


def _on(terrain: Terrain, x: float, y: float, psi: float) -> FloatArray:
    """Attitude (3, 3) of a body on a slope with heading psi [rad]."""
    slope = np.asarray(terrain.gradient(x, y)).reshape(2)
    up = np.array([-slope[0], -slope[1], 1.0])
    up /= np.linalg.norm(up)
    ahead = np.array([math.cos(psi), math.sin(psi), slope[0] * math.cos(psi) + slope[1] * math.sin(psi)])
    ahead /= np.linalg.norm(ahead)
    return np.column_stack([ahead, np.cross(up, ahead), up])


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
    return recorded(truths, kind, rng=rng, rover=rover, terrain=ground, lead=_LEAD)


def recorded(
    truths: Sequence[RoverTruth],
    kind: str,
    *,
    rng: np.random.Generator,
    rover: Rover,
    terrain: Terrain,
    lead: int = 0,
) -> Iterator[Labelled]:
    """Views at the moments of a drive, after the first ``lead`` of them."""
    world_rng, camera_rng, instrument_rng = rng.spawn(3)
    world = SandWorld(kind, rng=world_rng, rover=rover, terrain=terrain, route=route_of(truths))
    camera = TraceCamera(world, nominal_rig(rover), Webcam(), camera_rng)
    instruments = RoverInstruments(rng=instrument_rng)
    world.drive(truths[:lead])
    for truth in truths[lead:]:
        world.drive([truth])
        readings = instruments.sample(truth)
        yield Labelled(readings.seen(camera.sample(truth)), truth, world.trace_truth(truth))


def route_of(truths: Sequence[RoverTruth]) -> FloatArray:
    """Path of R's origin (n, 2) [m]."""
    return np.array([truth.pose[:2] for truth in truths])
