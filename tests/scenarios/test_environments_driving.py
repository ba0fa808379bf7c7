"""Driving a combination oneself: the bay can be reached, backwards and on slipping tyres."""

from __future__ import annotations

import math

import gymnasium
import numpy as np
import pytest

import offtrack.environments.registry  # noqa: F401  # it registers the environments
from controllers.driver import PreviewDriver
from controllers.path import Path, line
from controllers.reversing_law import ReverseReference, ReversingLaw, RollingChain
from controllers.tractor import TractorGeometry
from offtrack.environments.driving import SlippingTyreFleet
from offtrack.environments.rewards import N_DRAWN, Circumstances, Domain
from sensors.messages import EgoState
from vehicle.clock import to_ticks
from vehicle.combination.description import load_vehicle
from vehicle.engine.compiler import compiler
from vehicle.frames import FloatArray, Pose2

DRIVING = "offtrack/TractorTrailerDriving-v0"
VEHICLE = load_vehicle("eu_tractor_semitrailer")
STEP = to_ticks(0.02, "control step")
RUN_UP = 30.0  # drawn out of the bay before it is backed into: three lengths of the trailer [m]
ON_BRAKES = 0.05  # [m/s]


class Docker:
    """Pulls forward along the bay's axis until the trailer stands on it, and backs down that axis.

    All of it in the bay's frame, whose origin is where the trailer's end is to come.
    """

    def __init__(self) -> None:
        tractor, trailer = VEHICLE.units
        self.chain = RollingChain.of(VEHICLE)
        self.law = ReversingLaw(self.chain)
        self.axis = ReverseReference.of(self.chain, np.array([[-20.0, 0.0], [120.0, 0.0]]))
        self.to_axle = -trailer.rear_x - self.chain.lengths[-1]  # of the trailer's end [m]
        assert tractor.steering is not None
        geometry = TractorGeometry(
            wheelbase=self.chain.wheelbase,
            x_ref=tractor.front_x,
            y_ref=1e-9,  # the front's middle
            max_steer=tractor.steering.limit,
            max_steer_rate=tractor.steering.rate_limit,
            actuator_lag=tractor.steering.lag,
        )
        self.driver = PreviewDriver(geometry, Path(Pose2(-50.0, 0.0, 0.0), (line(200.0),)), 2.0, gain=0.2)
        self.memory = self.driver.init()
        self.limit, self.tick, self.backing = tractor.steering.limit, 0, False

    def act(self, seen: FloatArray) -> tuple[float, float]:
        """Action for an observation."""
        ahead, aside, c, s, gamma, speed, steer = seen.tolist()
        end = Pose2(-c * ahead - s * aside, s * ahead - c * aside, -math.atan2(s, c))
        axle = end @ Pose2(self.to_axle, 0.0, 0.0)
        self.tick += STEP
        if not self.backing:
            self.backing = end.x > RUN_UP and (abs(end.y) + 8.0 * abs(end.psi) < 0.3 or end.x > 42.0)
            return self._forward(axle, gamma, speed, steer)
        if speed > ON_BRAKES:
            return steer / self.limit, -1.0
        station = self.axis.project(axle.x, axle.y, axle.x + 20.0)
        demand = self.law.steer(axle, np.array([gamma]), self.axis.at(station))
        pace = min(1.6, math.sqrt(0.5 * max(end.x, 0.0)) + 0.05)
        return demand / self.limit, 2.0 * (-pace - speed)

    def _forward(self, axle: Pose2, gamma: float, speed: float, steer: float) -> tuple[float, float]:
        hitch = axle @ Pose2(self.chain.lengths[0], 0.0, gamma)
        tractor = hitch @ Pose2(-self.chain.hitches[0], 0.0, 0.0)
        yaw_rate = speed * math.tan(steer) / self.chain.wheelbase
        ego = EgoState(tick=self.tick, x=tractor.x, y=tractor.y, psi=tractor.psi, v_x=speed, v_y=0.0, yaw_rate=yaw_rate)
        self.memory, command = self.driver.step(self.memory, self.tick, ego, 1.9)
        return command.steer / self.limit, command.acceleration


def docked(seeds: range) -> list[str]:
    """Outcomes of the episodes of these seeds."""
    n = len(seeds)
    environment = gymnasium.make_vec(DRIVING, num_envs=n, task="bay")
    seen, _ = environment.reset(seed=list(seeds))  # type: ignore[arg-type]  # gymnasium's hint knows of one seed only
    drivers, outcomes = [Docker() for _ in range(n)], [""] * n
    while "" in outcomes:
        actions = np.array([driver.act(one.astype(np.float64)) for driver, one in zip(drivers, seen, strict=True)])
        seen, _, terminated, truncated, info = environment.step(np.clip(actions, -1.0, 1.0).astype(np.float32))
        for k in np.flatnonzero((terminated | truncated) & np.array([not outcome for outcome in outcomes])):
            outcomes[k] = info["outcome"][k]
    environment.close()
    return outcomes


@pytest.mark.skipif(compiler() is None, reason="no C compiler here: it takes a minute then")
def test_a_scripted_driver_backs_into_most_bays() -> None:
    """Twelve drawn bays, frictions, loads and lengths; a law that knows the nominal lengths reaches at least nine."""
    outcomes = docked(range(12))
    assert outcomes.count("completed") >= 9, outcomes


def gentle() -> Circumstances:
    """One combination as its file says, on dry and level ground."""
    return (
        Domain()
        .drawn(np.full((1, N_DRAWN), 0.5))
        ._replace(
            friction=np.array([0.8]),
            cross_fall=np.zeros(1),
            load=np.ones(1),
            length=np.ones(1),
            actuator_lag=np.ones(1),
        )
    )


def moved(mover: SlippingTyreFleet, acceleration: float, seconds: float) -> FloatArray:
    """Speeds of the tractor every 20 ms [m/s]."""
    demand = np.zeros(1), np.full(1, acceleration)
    return np.array([mover.step(*demand).velocities[0, 0, 0] for _ in range(round(50 * seconds))])


def test_the_gear_follows_the_demand_once_the_brakes_have_stopped_the_combination() -> None:
    """1 m/s2 back for 2 s, forward for 4 s: it slows, stops and goes on the other way at the same rate, no jump."""
    mover = SlippingTyreFleet(VEHICLE, 1, "auto")
    mover.place(np.arange(1), gentle())
    back, forward = moved(mover, -1.0, 2.0), moved(mover, 1.0, 4.0)
    # 0.25 s of lag and 0.006 g of rolling drag at first; wheels and gearing take 1 to 2 %.
    assert back[-1] == pytest.approx(-(2.0 - 0.25) * (1.0 - 0.06), abs=0.05)
    braking, driving = (forward[80] - forward[55]) / 0.5, (forward[-1] - forward[-26]) / 0.5
    assert braking == pytest.approx(1.06 / 1.013, rel=0.02)  # drag helps the brakes ...
    assert driving == pytest.approx(0.94 / 1.013, rel=0.02)  # ... and holds the engine back
    assert np.abs(np.diff(np.concatenate([back, forward]))).max() < 0.03  # 1.5 m/s2: it rocks on its tyres as it stops


def test_driven_wheels_slip_backwards_too() -> None:
    """On ice of friction 0.05 an axle that carries 11.4 of 40 t pushes with 0.14 m/s2 at most, at any demand."""
    speeds = {}
    for friction in (0.8, 0.05):
        mover = SlippingTyreFleet(VEHICLE, 1, "auto")
        mover.place(np.arange(1), gentle()._replace(friction=np.array([friction])))
        speeds[friction] = moved(mover, -1.0, 2.0)[-1]
    assert -2.0 * 0.05 * 9.81 * 12.0 / 40.0 < speeds[0.05] < -0.02
    assert speeds[0.8] < -1.5
