"""A controller that misbehaves ends with one line that names it, the tick and the value."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import pytest

from controllers.checked import CheckedDriver, CheckedLaw, CheckedRoverDriver, LawError
from controllers.driver import DriverCommand
from controllers.trailer import SteerCommand
from estimators.estimates import OffTracking
from estimators.slip.rover_odometry import Rolling, RoverPose
from sensors.messages import CombinationSignals, EgoState
from vehicle.rover.command import RoverCommand

TICK = 1200
EGO = EgoState(tick=TICK, x=0.0, y=0.0, psi=0.0, v_x=2.0, v_y=0.0, yaw_rate=0.0)
SIGNALS = CombinationSignals(
    tick=TICK,
    angles=np.zeros(2),
    speed=2.0,
    steer=0.0,
    articulation=np.zeros(1),
    yaw_rates=np.zeros(2),
    lateral_acceleration=0.0,
)
POSE = RoverPose(tick=TICK, x=0.0, y=0.0, psi=0.0, drift=0.0, rolling=Rolling(0.0, 0.0, 0.0))


class Stub(NamedTuple):
    """A law or driver that returns what it was made with, or raises it."""

    command: object
    duration: float = 10.0
    start_speed: float | None = None

    def init(self) -> int:
        return 0

    def _result(self, memory: int) -> tuple[int, object]:
        if isinstance(self.command, Exception):
            raise self.command
        return memory + 1, self.command


class Law(Stub):
    def step(
        self, memory: int, tick: int, off_tracking: OffTracking | None, signals: CombinationSignals
    ) -> tuple[int, SteerCommand]:
        return self._result(memory)  # type: ignore[return-value]  # as a user's law may


class Driver(Stub):
    def step(self, memory: int, tick: int, ego: EgoState, /) -> tuple[int, DriverCommand]:
        return self._result(memory)  # type: ignore[return-value]


class RoverDriver(Stub):
    def step(self, memory: int, pose: RoverPose, /) -> tuple[int, RoverCommand]:
        return self._result(memory)  # type: ignore[return-value]


def angles(*values: float) -> SteerCommand:
    return SteerCommand(angles=np.array(values))


def test_a_good_step_passes_through_unchanged() -> None:
    """Memory and command of the part itself."""
    command = angles(0.1, -0.2)
    law = CheckedLaw(Law(command), "trailer_steering = mine", 2)
    assert law.step(law.init(), TICK, None, SIGNALS) == (1, command)
    demand = DriverCommand(steer=0.1, acceleration=0.2)
    driver = CheckedDriver(Driver(demand, 12.0, 3.0), "driver = mine")
    assert driver.step(driver.init(), TICK, EGO) == (1, demand)
    wheels = RoverCommand(wheel_speed=(1.0,) * 4, steer=(0.0,) * 4)
    rover = CheckedRoverDriver(RoverDriver(wheels), "driver = mine", 4)
    assert rover.step(rover.init(), POSE) == (1, wheels)


@pytest.mark.parametrize(
    ("command", "message"),
    [
        (angles(0.1, 0.2, 0.3), r"returned 3 angles, the trailer has 2 steered axles"),
        (SteerCommand(angles=np.zeros((2, 1))), r"returned angles of shape \(2, 1\), the trailer has 2 steered axles"),
        (angles(0.1, math.nan), r"returned the angles \[0\.1, nan\] rad"),
        (angles(math.inf, 0.0), r"returned the angles \[inf, 0\.0\] rad"),
        (SteerCommand(angles=[0.1, 0.2]), r"returned the angles \[0\.1, 0\.2\], not an array of numbers"),  # type: ignore[arg-type]
        (SteerCommand(angles=np.array(["a", "b"])), r"not an array of numbers"),
        (np.zeros(2), r"returned \(1, array\(\[0\., 0\.\]\)\), not \(memory, SteerCommand\)"),
        (ZeroDivisionError("float division by zero"), r"raised ZeroDivisionError: float division by zero"),
        (ValueError("two\nlines"), r"raised ValueError: two lines"),
    ],
)
def test_a_law_that_misbehaves_is_named_with_tick_and_value(command: object, message: str) -> None:
    """In one line, with the time in seconds."""
    law = CheckedLaw(Law(command), "trailer_steering = mymod:Mine", 2)
    with pytest.raises(LawError, match=rf"^trailer_steering = mymod:Mine: at tick 1200 \(1\.2 s\) it .*{message}"):
        law.step(0, TICK, None, SIGNALS)


@pytest.mark.parametrize(
    ("command", "message"),
    [
        (DriverCommand(steer=math.nan, acceleration=0.0), r"returned steer = nan"),
        (DriverCommand(steer=0.0, acceleration=-math.inf), r"returned acceleration = -inf"),
        ((0.0, 0.0), r"not \(memory, DriverCommand\)"),
        (KeyError("lane"), r"raised KeyError: 'lane'"),
    ],
)
def test_a_tractor_driver_that_misbehaves_is_named(command: object, message: str) -> None:
    """As a law is."""
    driver = CheckedDriver(Driver(command), "driver.kind = mymod:Mine")
    with pytest.raises(LawError, match=rf"^driver\.kind = mymod:Mine: at tick 1200 \(1\.2 s\) it .*{message}"):
        driver.step(0, TICK, EGO)


@pytest.mark.parametrize(
    ("command", "message"),
    [
        (RoverCommand(wheel_speed=(1.0, 1.0, math.nan, 1.0), steer=(0.0,) * 4), r"returned wheel_speed\[2\] = nan"),
        (
            RoverCommand._make(((1.0,) * 4, (0.0, 0.0))),
            r"returned steer = \(0\.0, 0\.0\), the rover has 4 wheels",
        ),
        (None, r"returned \(1, None\), not \(memory, RoverCommand\)"),
    ],
)
def test_a_rover_driver_that_misbehaves_is_named(command: object, message: str) -> None:
    """As a law is; every wheel needs its number."""
    driver = CheckedRoverDriver(RoverDriver(command), "driver = mymod:Mine", 4)
    with pytest.raises(LawError, match=rf"^driver = mymod:Mine: at tick 1200 \(1\.2 s\) it .*{message}"):
        driver.step(0, POSE)
