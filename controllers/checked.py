"""Checks of controllers while they run: exceptions and commands that are not finite numbers end with one line."""

import math
import textwrap
from typing import Any, Generic, TypeVar

import numpy as np

from controllers.driver import DriverCommand, DriverLike
from controllers.rover_driver import RoverDriverLike
from controllers.trailer import Memory, SteerCommand
from estimators.slip.rover_odometry import RoverPose
from sensors.messages import EgoState
from vehicle.clock import TICK
from vehicle.foundation.own_parts import close_part, defined_at, raised_at
from vehicle.foundation.plant_like import EndedError
from vehicle.rover.command import RoverCommand

Command = TypeVar("Command", SteerCommand, DriverCommand, RoverCommand)


class LawError(ValueError):
    """Misbehaviour of a controller: one line with its name, the tick and the wrong value."""


class CheckedDriver(Generic[Memory]):
    """A tractor driver whose every step is checked."""

    def __init__(self, driver: DriverLike[Memory], name: str) -> None:
        """Check a driver, whom messages call ``name``."""
        self.driver, self._name = driver, name

    def init(self) -> Memory:
        """Memory before the first step."""
        return self.driver.init()

    def step(self, memory: Memory, tick: int, ego: EgoState, /) -> tuple[Memory, DriverCommand]:
        """Step of the driver.

        Raises:
            LawError: if the driver raises an exception, or returns anything but finite numbers.
        """
        result = checked_step(self.driver, self._name, DriverCommand, tick, memory, tick, ego)
        _check_numbers(self._name, tick, self.driver, result[1]._asdict())
        return result

    def close(self) -> None:
        """Close the driver."""
        close_part(self.driver)


class CheckedRoverDriver(Generic[Memory]):
    """A rover driver whose every step is checked."""

    def __init__(self, driver: RoverDriverLike[Memory], name: str, n_wheels: int) -> None:
        """Check a driver, whom messages call ``name``, of a rover with ``n_wheels``."""
        self.driver, self._name, self._n_wheels = driver, name, n_wheels

    def init(self) -> Memory:
        """Memory before the first step."""
        return self.driver.init()

    def step(self, memory: Memory, pose: RoverPose, /) -> tuple[Memory, RoverCommand]:
        """Step of the driver.

        Raises:
            LawError: if the driver raises an exception, or returns anything but a finite number for every wheel.
        """
        driver = self.driver
        result = checked_step(driver, self._name, RoverCommand, pose.tick, memory, pose)
        for field, values in result[1]._asdict().items():
            if not isinstance(values, tuple) or len(values) != self._n_wheels:
                event = f"returned {field} = {values!r}, the rover has {self._n_wheels} wheels"
                raise misbehaviour(self._name, pose.tick, event, driver)
            _check_numbers(self._name, pose.tick, driver, {f"{field}[{k}]": value for k, value in enumerate(values)})
        return result

    def close(self) -> None:
        """Close the driver."""
        close_part(self.driver)


def checked_step(
    part: Any, name: str, kind: type[Command], tick: int, memory: Memory, *inputs: object
) -> tuple[Memory, Command]:
    """Result of ``part.step(memory, *inputs)`` at a tick; a user's code may raise or return anything.

    Raises:
        LawError: if the part, which messages call ``name``, raises an exception, or returns no command of this kind.
    """
    try:
        result: object = part.step(memory, *inputs)
    except EndedError:
        raise
    except Exception as error:
        raise misbehaviour(name, tick, f"raised {type(error).__name__}: {error}", part, error) from error
    if not (isinstance(result, tuple) and len(result) == 2 and isinstance(result[1], kind)):
        raise misbehaviour(name, tick, f"returned {result!r}, not (memory, {kind.__name__})", part)
    return result


def check_angles(law: object, name: str, tick: int, angles: object, n_steered: int) -> None:
    """Refuse angles of a law, which messages call ``name``, that are not an array of finite numbers.

    Raises:
        LawError: if they are not ``n_steered`` finite numbers.
    """
    if not isinstance(angles, np.ndarray) or angles.dtype.kind not in "fiu":
        raise misbehaviour(name, tick, f"returned the angles {angles!r}, not an array of numbers", law)
    if angles.shape != (n_steered,):
        count = f"{angles.size} angles" if angles.ndim == 1 else f"angles of shape {angles.shape}"
        axles = "1 steered axle" if n_steered == 1 else f"{n_steered} steered axles"
        raise misbehaviour(name, tick, f"returned {count}, the trailer has {axles}", law)
    if not all(map(math.isfinite, angles.tolist())):
        raise misbehaviour(name, tick, f"returned the angles {angles.tolist()} rad", law)


def _check_numbers(name: str, tick: int, part: object, values: dict[str, object]) -> None:
    for field, value in values.items():
        if not isinstance(value, int | float | np.number) or not math.isfinite(value):
            raise misbehaviour(name, tick, f"returned {field} = {value}", part)


def misbehaviour(name: str, tick: int, event: str, part: object, error: BaseException | None = None) -> LawError:
    """Error with one line that names a part, the time, what it did, such as "raised ValueError: …", and where.

    The place is that of the exception, if there is one, or of the part's method ``step``, in the user's own code.
    """
    place = (raised_at(error) if error else "") or defined_at(getattr(type(part), "step", None))
    one_line = textwrap.shorten(event, 500, placeholder=" …") + place
    one_line = one_line.encode(errors="replace").decode()  # without lone surrogates, which no file can hold
    return LawError(f"{name}: at tick {tick} ({tick * TICK:g} s) it {one_line}")
