"""Many vehicles stepped at once, for learning and studies: each lane has its own state, numbers and ground.

The vehicles share a topology. Their numbers are inputs of the compiled functions, so that a lane restarts with another
load, length or lag without building anything anew.
"""

from functools import lru_cache
from typing import Any, Final, Literal, NamedTuple, TypeAlias

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from vehicle.clock import TICK
from vehicle.combination.chain import Kinematics, TruthAssembly, WheelTruth, kinematics_sizes, wheel_truth_sizes
from vehicle.combination.description import Vehicle
from vehicle.combination.functions import (
    body_function,
    kinematics_function,
    numbers,
    start_function,
    step_function,
    wheel_function,
)
from vehicle.combination.layout import GroundInputs, State, command_sizes, ground_input_sizes, slices, state_sizes
from vehicle.combination.plant import SurfaceLookup
from vehicle.combination.truth import Truth
from vehicle.engine.kernels import Engine, kernel_for_one, kernel_for_rows
from vehicle.foundation.plant_like import are_sane
from vehicle.frames import FloatArray

Lanes: TypeAlias = NDArray[np.intp]  # numbers of vehicles, (k,)
_APEX: Final = 3.0  # radius over which the tip of conical ground is rounded, as on ``Surface`` [m]
_NOTHING: Final = np.empty(0)
_FUNCTIONS: Final[tuple[Literal["step", "start", "motion"], ...]] = ("step", "start", "motion")
_KERNELS: Final = ("_advance", "_start", "_observe")  # of these functions


class BatchGround(NamedTuple):
    """Smooth ground of uniform friction under k vehicles."""

    friction: FloatArray  # (k,) [-]
    cross_fall: FloatArray  # (k,) falls to the right, or away from the centre where there is one [-]
    centre: FloatArray  # (k, 2) apex of a conical cross-fall [m]; NaN: a plane


class BatchMotion(NamedTuple):
    """Positions, velocities, steer angles and load transfer of n vehicles."""

    poses: FloatArray  # (n, N, 3) x [m], y [m], psi [rad] of each unit's frame in W
    velocities: FloatArray  # (n, N, 3) v_x, v_y [m/s] along the unit's axes, yaw rate [rad/s]
    steer: FloatArray  # (n, n_steered) angle of every steered axle, front to rear [rad]
    load_transfer: FloatArray  # (n, N) right less left wheel loads of each unit over their sum [-]


class PlantBatch:
    """n vehicles stepped together; one batch per thread.

    A vehicle whose state breaks, or whose command is not finite, gets a state that is not finite and keeps it until it
    is placed again; the others are not affected.
    """

    def __init__(self, vehicle: Vehicle, n: int, engine: Engine = "auto") -> None:
        """All lanes have the numbers of ``vehicle`` until they are placed.

        Raises:
            ValueError: if ``n`` or the engine does not fit.
        """
        if n < 1:
            raise ValueError(f"n = {n} vehicles must be at least 1")
        self.n, self._vehicle, self._n_units = n, vehicle, len(vehicle.units)
        self._engine: Engine = engine
        self._open_kernels()
        commands, ground = command_sizes(vehicle), ground_input_sizes(vehicle)
        self._n_command, self._n_trailer = sum(commands), commands.trailer_steer
        # behind the command
        self._ground = GroundInputs(*slices((self._n_command, *ground))[1:])
        first_number = self._n_command + sum(ground)
        self._numbers = slice(first_number, None)
        nominal = numbers(vehicle)
        self._u = np.zeros((n, first_number + len(nominal)))
        self._u[:, self._numbers] = nominal
        self._u[:, self._n_command - 1] = 1.0  # forward
        self._u[:, self._ground.friction] = 1.0
        self._state = np.zeros((n, sum(state_sizes(vehicle))))
        self._start_u = np.zeros((n, 4 + sum(ground) + len(nominal)))
        self._cross_fall, self._centre = np.zeros(n), np.full((n, 2), np.nan)
        self._conical, self._no_state = False, np.empty((n, 0))
        self._in_motion = _BatchMotionParts(
            *slices(_BatchMotionParts.of(kinematics_sizes(vehicle), wheel_truth_sizes(vehicle)))
        )

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in vars(self).items() if name not in _KERNELS}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        self._open_kernels()  # they belong to a process, and hold no state

    def _open_kernels(self) -> None:
        self._advance, self._start, self._observe = (
            kernel_for_rows(_with_numbers_in_input(self._vehicle, name), self.n, self._engine) for name in _FUNCTIONS
        )

    @property
    def state(self) -> FloatArray:
        """States of all vehicles (n, n_state), as ``layout.State`` orders them."""
        return self._state

    @property
    def finite(self) -> NDArray[np.bool_]:
        """True for each vehicle whose state is finite and below 1e12 in any SI unit, (n,)."""
        return are_sane(self._state)

    def place(self, lanes: Lanes, own_numbers: FloatArray, ground: BatchGround, speeds: FloatArray) -> BatchMotion:
        """Restart k vehicles at W's origin, straight along x and rolling freely; the other lanes stay as they are.

        Args:
            lanes: (k,) which vehicles.
            own_numbers: (k, n_numbers) in the order of ``symbolic.numbers``.
            ground: under these vehicles.
            speeds: (k,) [m/s].

        Returns:
            The motion of all n vehicles.
        """
        self._u[lanes, self._numbers] = own_numbers
        self._u[lanes, self._ground.friction] = ground.friction[:, None]
        self._cross_fall[lanes], self._centre[lanes] = ground.cross_fall, ground.centre
        self._conical = bool(np.isfinite(self._centre[:, 0]).any())
        self._u[lanes, : self._n_command - 1] = 0.0
        self._u[lanes, self._ground.slope_x] = 0.0
        slope_y = np.where(np.isfinite(ground.centre[:, 0]), 0.0, ground.cross_fall)
        self._u[lanes, self._ground.slope_y] = slope_y[:, None]
        self._start_u[:, 3] = 0.0
        self._start_u[lanes, 3] = speeds
        self._settle(lanes)
        motion = self.observe()
        if not self._conical:
            return motion
        self._settle(lanes)  # on the slope at the positions that are known now
        return self.observe()

    def step(
        self,
        steer: ArrayLike,
        acceleration: ArrayLike,
        trailer_steer: FloatArray,
        ticks: int,
        gear: ArrayLike | None = None,
    ) -> BatchMotion:
        """Step all vehicles over whole ticks under held commands.

        Args:
            steer: (n,) of the tractors [rad].
            acceleration: (n,) above 0 drives the way the gear does, below 0 brakes [m/s2].
            trailer_steer: (n, n_steered) of the trailer axles [rad].
            ticks: at least 1.
            gear: (n,) +1 forward, -1 backward; None: all forward.

        Raises:
            ValueError: if the number of ticks, the shape of ``trailer_steer`` or a gear does not fit.
        """
        if ticks < 1:
            raise ValueError(f"ticks = {ticks} must be at least 1 tick of {TICK * 1e3:g} ms")
        if trailer_steer.shape != (self.n, self._n_trailer):
            raise ValueError(
                f"trailer_steer of shape {trailer_steer.shape} must be ({self.n}, {self._n_trailer}): "
                f"{self._vehicle.name} steers {self._n_trailer} trailer axles"
            )
        last = self._n_command - 1
        self._u[:, 0], self._u[:, 1], self._u[:, 2:last] = steer, acceleration, trailer_steer
        self._u[:, last] = 1.0 if gear is None else gear
        if gear is not None and not (np.abs(self._u[:, last]) == 1.0).all():
            raise ValueError("gear must be 1 (forward) or -1 (backward) for every vehicle")
        self._state = self._advance(self._state, self._u, ticks)
        finite = np.isfinite(self._u[:, : self._n_command])
        if not finite.all():
            self._state[~finite.all(axis=1)] = np.nan  # the actuators' limits would hide such a command
        return self.observe()

    def observe(self) -> BatchMotion:
        """Motion of all vehicles. Sets the slope that the next step uses on conical ground."""
        motion = self._observe(self._state, self._u)
        at = self._in_motion
        if self._conical:
            self._set_slopes(motion[:, at.centre_x], motion[:, at.centre_y])
        return BatchMotion(
            poses=motion[:, at.poses].reshape(self.n, self._n_units, 3),
            velocities=motion[:, at.velocities].reshape(self.n, self._n_units, 3),
            steer=motion[:, at.steer],
            load_transfer=motion[:, at.load_transfer],
        )

    def lane(self, lane: int) -> "BatchLane":
        """State, inputs and numbers of one vehicle."""
        return BatchLane(self._state[lane], self._u[lane, : self._numbers.start], self._u[lane, self._numbers])

    def _settle(self, lanes: Lanes) -> None:
        """Set the start state of these vehicles on the ground under them now."""
        self._start_u[:, 4:] = self._u[:, self._n_command :]
        self._state[lanes] = self._start(self._no_state, self._start_u)[lanes]

    def _set_slopes(self, x: FloatArray, y: FloatArray) -> None:
        """Set the slope of conical ground under each unit's centre of gravity [-]."""
        d_x, d_y = x - self._centre[:, :1], y - self._centre[:, 1:]
        share = -self._cross_fall[:, None] / np.sqrt(d_x * d_x + d_y * d_y + _APEX**2)
        conical = np.isfinite(share)
        np.copyto(self._u[:, self._ground.slope_x], share * d_x, where=conical)
        np.copyto(self._u[:, self._ground.slope_y], share * d_y, where=conical)


class BatchLane(NamedTuple):
    """One vehicle of a batch, as ``vehicle.combination.functions`` takes it."""

    state: FloatArray
    inputs: FloatArray  # command and ground inputs
    numbers: FloatArray


class LaneObserver:
    """Full ground truth of single vehicles of a batch."""

    def __init__(self, vehicle: Vehicle, batch: PlantBatch) -> None:
        """Of a batch of vehicles of this topology."""
        self._batch = batch
        of_vehicle = kinematics_function(vehicle), wheel_function(vehicle), body_function(vehicle)
        self._kinematics, self._wheels, self._bodies = (
            kernel_for_one(_taking_numbers_as_input(function), _NOTHING, "interpreted") for function in of_vehicle
        )
        self._assembly = TruthAssembly(vehicle)
        in_state = State(*slices(state_sizes(vehicle)))
        self._x, self._y, self._psi = in_state.x.start, in_state.y.start, in_state.psi.start

    def truth(self, lane: int, surface: SurfaceLookup, tick: int, *, back: float = 0.0) -> Truth:
        """Ground truth of one vehicle on this surface, as if it stood ``back`` [m] behind its position."""
        state, inputs, own_numbers = self._batch.lane(lane)
        if back:
            state = state.copy()
            state[self._x] -= back * np.cos(state[self._psi])
            state[self._y] -= back * np.sin(state[self._psi])
        kinematics = self._kinematics(state, own_numbers)
        wheels = self._wheels(state, np.concatenate([inputs, own_numbers]))
        bodies = self._bodies(state, np.concatenate([surface.smooth_ground(kinematics), own_numbers]))
        return self._assembly.truth(tick, kinematics, wheels, bodies)


class _BatchMotionParts(NamedTuple):
    """Parts of the vector of the function "motion": their sizes, slices or values."""

    poses: Any
    velocities: Any
    centre_x: Any
    centre_y: Any
    steer: Any
    load_transfer: Any

    @classmethod
    def of(cls, k: Kinematics[Any], wheels: WheelTruth[Any]) -> "_BatchMotionParts":
        return cls(k.poses, k.velocities, k.centre_x, k.centre_y, wheels.steer, wheels.load_transfer)


@lru_cache(maxsize=16)
def _with_numbers_in_input(vehicle: Vehicle, name: Literal["step", "start", "motion"]) -> Any:
    """The function (state, input and numbers, nothing); cached, as a program is made once per function."""
    if name == "motion":
        return _motion_function(vehicle)
    if name == "step":
        return step_function(vehicle).of_functions(_taking_numbers_as_input)
    return _taking_numbers_as_input(start_function(vehicle))


def _taking_numbers_as_input(function: Any) -> Any:
    x, u, own, *results = (ca.SX.sym("v", function.numel_in(k)) for k in range(function.n_in()))
    value = function(x, u, own, *results)
    return ca.Function(function.name(), [x, ca.vertcat(u, own), ca.SX(0, 1), *results], [value])


def _motion_function(vehicle: Vehicle) -> Any:
    """The parts of kinematics and wheel truth that ``BatchMotion`` and conical ground need."""
    of_kinematics, of_wheels = kinematics_function(vehicle), wheel_function(vehicle)
    x, u, own = (ca.SX.sym("v", of_wheels.numel_in(k)) for k in range(3))
    kinematics = Kinematics(*(of_kinematics(x, ca.SX(0, 1), own)[part] for part in slices(kinematics_sizes(vehicle))))
    wheels = WheelTruth(*(of_wheels(x, u, own)[part] for part in slices(wheel_truth_sizes(vehicle))))
    motion = ca.cse(ca.densify(ca.vertcat(*_BatchMotionParts.of(kinematics, wheels))))
    return ca.Function("motion", [x, ca.vertcat(u, own), ca.SX(0, 1)], [motion])
