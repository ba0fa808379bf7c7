"""The simulated combination on a surface, stepped over whole ticks, and one of prescribed motion.

Values that are the same everywhere are looked up once. Lookups take ``Kinematics`` as a vector (..., n), for one
vehicle or many.

De Saxe & Cebon 2018, "Estimation of trailer off-tracking using visual odometry", section 3.1: constant speed, constant
slip angle. With the follow point L_f behind the hitch the off-tracking is e = -L_f tan(slip angle).
"""

import math
from typing import Final, NamedTuple

import numpy as np

from vehicle.clock import TICK
from vehicle.combination import functions, layout
from vehicle.combination.chain import Kinematics, SmoothGround, TruthAssembly, kinematics_sizes, smooth_ground_sizes
from vehicle.combination.description import Vehicle
from vehicle.combination.loads import static_axle_loads
from vehicle.combination.truth import Truth
from vehicle.engine.kernels import Engine, kernel_for_one
from vehicle.foundation.plant_like import is_sane
from vehicle.frames import FloatArray, Pose2
from vehicle.surface import Surface

_LOOKUP_DISTANCE: Final = 0.1  # travelled between two lookups of changing ground [m]: half a contact patch
_LEAST_SPEED: Final = 1.0  # that a vehicle at rest may reach before the next lookup [m/s]


def ticks_to_next_lookup(speed: float) -> int:
    """Number of ticks for which changing ground is held, at a speed [m/s]."""
    return max(1, int(_LOOKUP_DISTANCE / (max(_LEAST_SPEED, speed) * TICK)))


class SurfaceLookup:
    """A surface, sampled at the wheels and units of vehicles of one topology."""

    def __init__(self, surface: Surface, vehicle: Vehicle) -> None:
        self._surface = surface
        self._is_plane = surface.is_plane
        self._is_uniform, self._is_smooth = surface.is_uniform, surface.is_smooth
        self._at = Kinematics(*layout.slices(kinematics_sizes(vehicle)))
        self._inputs = layout.GroundInputs(*layout.slices(layout.ground_input_sizes(vehicle)))
        self._smooth = SmoothGround(*layout.slices(smooth_ground_sizes(vehicle)))
        slope_x, slope_y = surface.gradient(0.0, 0.0)
        self._default_inputs = np.zeros(self._inputs.wind.stop)  # the values that do not change with position
        self._default_inputs[self._inputs.friction] = surface.friction_at(0.0, 0.0)
        self._default_inputs[self._inputs.slope_x] = slope_x
        self._default_inputs[self._inputs.slope_y] = slope_y
        self._default_smooth = np.zeros(self._smooth.slope_y.stop)
        self._default_smooth[self._smooth.slope_x] = slope_x
        self._default_smooth[self._smooth.slope_y] = slope_y

    @property
    def constant(self) -> FloatArray | None:
        """The ``GroundInputs`` of a smooth plane of one friction; None if they change with position."""
        calm = self._surface.gust is None
        return self._default_inputs if calm and self._is_plane and self._is_uniform and self._is_smooth else None

    def ground_inputs(self, kinematics: FloatArray) -> FloatArray:
        """``GroundInputs`` of vehicles at these positions, (..., n)."""
        surface, at, into = self._surface, self._at, self._inputs
        inputs = _copies(self._default_inputs, kinematics)
        if not self._is_plane:
            slope = surface.gradient(kinematics[..., at.centre_x], kinematics[..., at.centre_y])
            inputs[..., into.slope_x], inputs[..., into.slope_y] = slope[..., 0], slope[..., 1]
        if not self._is_uniform:
            inputs[..., into.friction] = surface.friction_at(kinematics[..., at.wheel_x], kinematics[..., at.wheel_y])
        if not self._is_smooth:
            inputs[..., into.road] = surface.roughness_at(kinematics[..., at.wheel_x], kinematics[..., at.wheel_y])
        if surface.gust is not None and into.wind.stop > into.wind.start:
            inputs[..., into.wind] = surface.gust.velocity_at(kinematics[..., at.centre_x])
        return inputs

    def smooth_ground(self, kinematics: FloatArray) -> FloatArray:
        """``SmoothGround`` of vehicles at these positions, (..., n)."""
        x, y = kinematics[..., self._at.support_x], kinematics[..., self._at.support_y]
        ground = _copies(self._default_smooth, kinematics)
        ground[..., self._smooth.height] = self._surface.height(x, y)
        if not self._is_plane:
            slope = self._surface.gradient(x, y)
            ground[..., self._smooth.slope_x], ground[..., self._smooth.slope_y] = slope[..., 0], slope[..., 1]
        return ground


def _copies(row: FloatArray, kinematics: FloatArray) -> FloatArray:
    """An array with a copy of the row for every vehicle."""
    copies = np.empty((*kinematics.shape[:-1], len(row)))
    copies[...] = row
    return copies


_NOTHING: Final = np.empty(0)


class VehicleCommand(NamedTuple):
    """Command of the driver and the trailer controllers."""

    steer: float  # of the tractor's foremost steered axle [rad]
    acceleration: float  # above 0 drives the way the gear does, below 0 brakes [m/s2]
    trailer_steer: tuple[float, ...]  # of every axle that a law turns, front to rear [rad]
    gear: float = 1.0  # +1 forward, -1 backward; takes effect at once, so change it at a standstill
    brake_share: tuple[float, ...] = ()  # of each wheel's brake torque that acts, of a vehicle ``with_failing_brakes``


class DivergedError(Exception):
    """A step led to a state that is not finite, or beyond 1e12 in any SI unit."""

    def __init__(self, state: FloatArray, u: FloatArray) -> None:
        super().__init__(f"the state diverged in a step from state {state} with input {u}")
        self.state = state
        self.input = u


class Plant:
    """A vehicle on a surface, compiled or interpreted; one per thread.

    Ground that changes with position is looked up at the beginning of a call and every 0.1 m.
    """

    def __init__(self, vehicle: Vehicle, surface: Surface, engine: Engine = "auto") -> None:
        self._vehicle, self._surface, self._engine = vehicle, surface, engine
        if surface.gust is not None:
            vehicle = vehicle.in_wind()
            self._vehicle = vehicle
        values = functions.numbers(vehicle)
        self._lookup = SurfaceLookup(surface, vehicle)
        self._constant_ground = self._lookup.constant
        always = _NOTHING if self._constant_ground is None else self._constant_ground
        self._advance = kernel_for_one(functions.step_function(vehicle), values, engine, always=always)
        # Interpreted where it is called rarely: a call costs more than its arithmetic.
        self._kinematics = kernel_for_one(functions.kinematics_function(vehicle), values, "interpreted")
        self._wheels = kernel_for_one(functions.wheel_function(vehicle), values, "interpreted")
        self._bodies = kernel_for_one(functions.body_function(vehicle), values, "interpreted")
        self._start = kernel_for_one(functions.start_function(vehicle), values, "interpreted")
        self._assembly = TruthAssembly(vehicle)
        self._n_trailer = layout.command_sizes(vehicle).trailer_steer
        self._sound_brakes = (1.0,) * layout.command_sizes(vehicle).brake_share
        self._known: tuple[bytes, FloatArray] = b"", _NOTHING  # state last observed, and its ground inputs
        self._idle = np.zeros(sum(layout.command_sizes(vehicle)))
        in_state = layout.State(*layout.slices(layout.state_sizes(vehicle)))
        self._velocity = [in_state.v_x.start, in_state.v_y.start]

    def __reduce__(self) -> "tuple[type[Plant], tuple[Vehicle, Surface, Engine]]":
        return (Plant, (self._vehicle, self._surface, self._engine))  # compiled functions cannot be pickled

    def initial_state(self, pose: Pose2, speed: float) -> FloatArray:
        """State of the straight combination rolling freely at ``speed`` [m/s] with its tractor at X_WT."""
        start = (*pose, speed)
        level = self._start(_NOTHING, np.array([*start, *np.zeros(sum(layout.ground_input_sizes(self._vehicle)))]))
        return self._start(_NOTHING, np.array([*start, *self._ground_inputs(self._kinematics_of(level))]))

    def step(self, state: FloatArray, command: VehicleCommand, ticks: int) -> FloatArray:
        """State after whole ticks under a held command, a new array.

        Raises:
            ValueError: if the number of ticks or of trailer steer angles does not fit, a value is not finite, or the
                gear is neither 1 nor -1.
            DivergedError: if the new state is not finite, or beyond 1e12 in any SI unit.
        """
        if ticks < 1:
            raise ValueError(f"ticks = {ticks} must be at least 1 tick of {TICK * 1e3:g} ms")
        inputs = self._command_inputs(command)
        if self._constant_ground is not None:
            return self._stepped(state, np.concatenate([inputs, self._constant_ground]), ticks)
        while ticks > 0:
            u = np.concatenate([inputs, self._ground_under(state)])
            before_next_lookup = min(ticks, ticks_to_next_lookup(math.hypot(*state[self._velocity].tolist())))
            state = self._stepped(state, u, before_next_lookup)
            ticks -= before_next_lookup
        return state

    def observe(self, state: FloatArray, tick: int) -> Truth:
        """Ground truth of this state."""
        kinematics = self._kinematics_of(state)
        self._known = state.tobytes(), self._ground_inputs(kinematics)
        inputs = np.concatenate([self._idle, self._known[1]])  # no truth depends on a command
        bodies = self._bodies(state, self._lookup.smooth_ground(kinematics))
        return self._assembly.truth(tick, kinematics, self._wheels(state, inputs), bodies)

    def _stepped(self, state: FloatArray, u: FloatArray, ticks: int) -> FloatArray:
        after = self._advance(state, u, ticks)
        if not is_sane(after):
            raise DivergedError(state, u)
        return after

    def _command_inputs(self, command: VehicleCommand) -> tuple[float, ...]:
        shares = command.brake_share or self._sound_brakes
        inputs = (command.steer, command.acceleration, *command.trailer_steer, command.gear, *shares)
        if len(command.trailer_steer) != self._n_trailer:
            raise ValueError(
                f"trailer_steer has {len(command.trailer_steer)} angles, "
                f"{self._vehicle.name} steers {self._n_trailer} trailer axles"
            )
        if len(shares) != len(self._sound_brakes):
            raise ValueError(f"brake_share has {len(shares)} numbers, not {len(self._sound_brakes)}")
        if not math.isfinite(sum(inputs)):
            raise ValueError(f"{command} must be of finite numbers [rad, m/s2]")
        if command.gear not in (1.0, -1.0):
            raise ValueError(f"gear = {command.gear} must be 1 (forward) or -1 (backward)")
        return inputs

    def _kinematics_of(self, state: FloatArray) -> FloatArray:
        """``Kinematics``; of a diverged state those at the origin, as the ground has no height elsewhere."""
        kinematics = self._kinematics(state, _NOTHING)
        return kinematics if is_sane(kinematics) else np.zeros_like(kinematics)

    def _ground_under(self, state: FloatArray) -> FloatArray:
        """Ground inputs of a state, looked up once where it is observed and then stepped from."""
        of_state, ground = self._known
        return ground if state.tobytes() == of_state else self._ground_inputs(self._kinematics_of(state))

    def _ground_inputs(self, kinematics: FloatArray) -> FloatArray:
        return self._lookup.ground_inputs(kinematics) if self._constant_ground is None else self._constant_ground


class ConstantSlipPlant:
    """A combination with prescribed motion at a constant slip angle.

    Units ahead of ``unit`` point in the direction of travel; ``unit`` and those behind it travel ``slip_angle`` [rad]
    to the left of their heading. Tyre forces are not modelled: commands have no effect, loads are static, no friction
    is used.
    """

    def __init__(self, vehicle: Vehicle, surface: Surface, *, unit: int, slip_angle: float, speed: float) -> None:
        vehicle.check_towed(unit)
        self._vehicle = vehicle
        self._surface = surface
        self._speed = speed
        n = len(vehicle.units)
        self._slip = np.where(np.arange(n) < unit, 0.0, slip_angle)  # of every unit [rad]
        self._loads = np.repeat(0.5 * np.concatenate(static_axle_loads(vehicle)), 2)  # (n_wheels,) [N]
        self._wheel_unit = [wheel.unit for wheel in layout.wheels(vehicle)]
        self._n_steered = sum(len(unit.steered_axles) for unit in vehicle.units)

    def initial_state(self, pose: Pose2, speed: float) -> FloatArray:
        """State: the tractor's pose X_WT, with psi as the direction of travel.

        Raises:
            ValueError: if ``speed`` [m/s] is not the constant one.
        """
        if speed != self._speed:
            raise ValueError(f"speed = {speed} m/s must be the constant speed, {self._speed} m/s")
        return np.array(pose)

    def step(self, state: FloatArray, command: VehicleCommand, ticks: int) -> FloatArray:
        """State after whole ticks; the command has no effect."""
        return np.array(Pose2(*state) @ Pose2(self._speed * ticks * TICK, 0.0, 0.0))

    def observe(self, state: FloatArray, tick: int) -> Truth:
        """Ground truth of this state."""
        poses = self._poses(Pose2(*state))
        velocities = self._speed * np.column_stack([np.cos(self._slip), np.sin(self._slip), np.zeros(len(poses))])
        return Truth(
            tick=tick,
            poses=poses,
            velocities=velocities,
            bodies=np.array(
                [
                    self._surface.pose_on(x, y, psi, self._vehicle.supports(i))
                    for i, (x, y, psi) in enumerate(poses.tolist())
                ]
            ),
            steer=np.zeros(self._n_steered),
            wheel_loads=self._loads.copy(),
            wheel_slip_angles=self._slip[self._wheel_unit],
            friction_used=np.zeros(len(self._wheel_unit)),
            load_transfer=np.zeros(len(poses)),
        )

    def _poses(self, X_WT: Pose2) -> FloatArray:
        """x [m], y [m], psi [rad] of each unit's frame in W, (N, 3)."""
        poses = [X_WT]
        for k, ahead in enumerate(self._vehicle.units[:-1]):
            turn = float(self._slip[k] - self._slip[k + 1])
            poses.append(poses[-1] @ Pose2(ahead.rear_hitch[0], 0.0, turn))
        return np.array(poses)
