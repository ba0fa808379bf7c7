"""A controller that misbehaves ends with one line that names it, the tick and the value."""

from __future__ import annotations

import math
from typing import NamedTuple

import pytest

from controllers.checked import CheckedDriver, CheckedRoverDriver, LawError
from controllers.driver import DriverCommand
from estimators.slip.rover_odometry import Rolling, RoverPose
from sensors.messages import EgoState
from vehicle.rover.command import RoverCommand

TICK = 1200
EGO = EgoState(tick=TICK, x=0.0, y=0.0, psi=0.0, v_x=2.0, v_y=0.0, yaw_rate=0.0)
POSE = RoverPose(tick=TICK, x=0.0, y=0.0, psi=0.0, drift=0.0, rolling=Rolling(0.0, 0.0, 0.0))


class Stub(NamedTuple):
    command: object
    duration: float = 10.0
    start_speed: float | None = None

    def init(self) -> int:
        return 0

    def _result(self, memory: int) -> tuple[int, object]:
        if isinstance(self.command, Exception):
            raise self.command
        return memory + 1, self.command


class Driver(Stub):
    def step(self, memory: int, tick: int, ego: EgoState, /) -> tuple[int, DriverCommand]:
        return self._result(memory)  # type: ignore[return-value]  # as a user's driver may


class RoverDriver(Stub):
    def step(self, memory: int, pose: RoverPose, /) -> tuple[int, RoverCommand]:
        return self._result(memory)  # type: ignore[return-value]


def test_a_good_step_passes_through_unchanged() -> None:
    demand = DriverCommand(steer=0.1, acceleration=0.2)
    driver = CheckedDriver(Driver(demand, 12.0, 3.0), "driver = mine")
    assert driver.step(driver.init(), TICK, EGO) == (1, demand)
    wheels = RoverCommand(wheel_speed=(1.0,) * 4, steer=(0.0,) * 4)
    rover = CheckedRoverDriver(RoverDriver(wheels), "driver = mine", 4)
    assert rover.step(rover.init(), POSE) == (1, wheels)


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
    """In one line, with the time in seconds."""
    driver = CheckedDriver(Driver(command), "driver.kind = mymod:Mine")
    with pytest.raises(LawError, match=rf"^driver\.kind = mymod:Mine: at tick 1200 \(1\.2 s\) it .*{message}"):
        driver.step(0, TICK, EGO)


@pytest.mark.parametrize(
    ("command", "message"),
    [
        (RoverCommand(wheel_speed=(1.0, 1.0, math.nan, 1.0), steer=(0.0,) * 4), r"returned wheel_speed\[2\] = nan"),
        (RoverCommand._make(((1.0,) * 4, (0.0, 0.0))), r"returned steer = \(0\.0, 0\.0\), the rover has 4 wheels"),
        (None, r"returned \(1, None\), not \(memory, RoverCommand\)"),
    ],
)
def test_a_rover_driver_that_misbehaves_is_named(command: object, message: str) -> None:
    driver = CheckedRoverDriver(RoverDriver(command), "driver = mymod:Mine", 4)
    with pytest.raises(LawError, match=rf"^driver = mymod:Mine: at tick 1200 \(1\.2 s\) it .*{message}"):
        driver.step(0, POSE)
