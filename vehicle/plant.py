"""The vehicle as it really moves: its equations stepped over whole ticks on a surface."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from vehicle.clock import TICK
from vehicle.compiled import Buffered, compiled_output, compiled_steps
from vehicle.description import GRAVITY, Vehicle
from vehicle.frames import FloatArray, Pose2, rotation_zyx, transform
from vehicle.layout import Input, Output, State, output_sizes, parts, state_sizes, wheels
from vehicle.surface import Surface
from vehicle.truth import Truth


class VehicleCommand(NamedTuple):
    """What driver and trailer controllers demand of the vehicle."""

    steer: float  # of the tractor's road wheels [rad]
    acceleration: float  # [m/s2]
    trailer_steer: tuple[float, ...]  # of every steered trailer axle, front to rear [rad]


class DivergedError(Exception):
    """The physics broke: a step led to a state that is not finite."""

    def __init__(self, state: FloatArray, u: FloatArray) -> None:
        super().__init__(f"the state is no longer finite after a step from state {state} with input {u}")
        self.state = state
        self.input = u


class Plant:
    """A vehicle on a surface. Friction and slope are looked up once a call, at its beginning."""

    def __init__(self, vehicle: Vehicle, surface: Surface) -> None:
        self._vehicle = vehicle
        self._surface = surface
        self._state_sizes = state_sizes(vehicle)
        self._output_sizes = output_sizes(vehicle)
        self._n_steered = [len(unit.steered_axles) for unit in vehicle.units]
        self._hitch_x = np.array([unit.hitch_x or 0.0 for unit in vehicle.units[:-1]])  # [m]
        self._cg_x = np.array([unit.cg_x for unit in vehicle.units])  # [m]
        layout = wheels(vehicle)
        self._wheel_unit = np.array([wheel.unit for wheel in layout])
        self._wheel_xy = np.array([(wheel.axle.x, wheel.y) for wheel in layout])  # (n_wheels, 2) in its unit [m]
        self._wheel_radius = np.array([wheel.axle.wheel_radius for wheel in layout])  # [m]
        self._output = Buffered(compiled_output(vehicle))
        self._steps: dict[int, Buffered] = {}  # by number of ticks

    def __reduce__(self) -> tuple[type[Plant], tuple[Vehicle, Surface]]:
        return (Plant, (self._vehicle, self._surface))  # buffers do not travel: they are made anew where it arrives

    def initial_state(self, pose: Pose2, speed: float) -> FloatArray:
        """State of the straight combination rolling freely at ``speed`` [m/s] with its tractor at X_WT."""
        resting = State(*(np.zeros(size) for size in self._state_sizes))
        standing = resting._replace(
            x=np.array([pose.x]), y=np.array([pose.y]), psi=np.full(len(resting.psi), pose.psi), v_x=np.array([speed])
        )
        gravity_x, gravity_y = self._gravity(self._poses(standing))
        c, s = np.cos(pose.psi), np.sin(pose.psi)
        rolling = standing._replace(
            a_x=-(c * gravity_x + s * gravity_y),  # carried by the wheels from the start, as after a long wait
            a_y=-(c * gravity_y - s * gravity_x),
            omega=speed / self._wheel_radius,
        )
        return np.concatenate(rolling)

    def step(self, state: FloatArray, command: VehicleCommand, ticks: int) -> FloatArray:
        """State after whole ticks under a held command, a new array.

        Raises:
            ValueError: if the number of ticks or of trailer steer demands does not fit.
            DivergedError: if the new state is not finite.
        """
        u = self._input(self._poses(self._named(state)), command)
        after = self._compiled(ticks)(state, u)
        if not np.isfinite(after).all():
            raise DivergedError(state, u)
        return after

    def observe(self, state: FloatArray, tick: int) -> Truth:
        """What is really so in this state."""
        s = self._named(state)
        poses = self._poses(s)
        idle = VehicleCommand(0.0, 0.0, (0.0,) * sum(self._n_steered[1:]))  # no output depends on a demand
        told = Output(*parts(self._output(state, self._input(poses, idle)), self._output_sizes))
        return Truth(
            tick=tick,
            poses=poses,
            velocities=self._velocities(s),
            bodies=self._bodies(s, poses),
            steer=s.steer.copy(),
            wheel_loads=told.load,
            wheel_slip_angles=told.slip_angle,
            friction_used=told.friction_used,
        )

    def _named(self, state: FloatArray) -> State[FloatArray]:
        return State(*parts(state, self._state_sizes))

    def _compiled(self, ticks: int) -> Buffered:
        if ticks not in self._steps:
            if ticks < 1:
                raise ValueError(f"ticks = {ticks} must be at least 1 tick of {TICK * 1e3:g} ms")
            self._steps[ticks] = Buffered(compiled_steps(self._vehicle, ticks))
        return self._steps[ticks]

    def _input(self, poses: FloatArray, command: VehicleCommand) -> FloatArray:
        expected = sum(self._n_steered[1:])
        if len(command.trailer_steer) != expected:
            got = len(command.trailer_steer)
            raise ValueError(f"trailer_steer has {got} angles, {self._vehicle.name} steers {expected} trailer axles")
        gravity_x, gravity_y = self._gravity(poses)
        u = Input(
            steer=np.array([*[command.steer] * self._n_steered[0], *command.trailer_steer]),
            acceleration=np.array([command.acceleration]),
            friction=self._friction(poses),
            gravity_x=gravity_x,
            gravity_y=gravity_y,
        )
        return np.concatenate(u)

    def _friction(self, poses: FloatArray) -> FloatArray:
        """Friction coefficient under every wheel, (n_wheels,)."""
        x, y, psi = poses[self._wheel_unit].T
        c, s = np.cos(psi), np.sin(psi)
        ahead, left = self._wheel_xy.T
        return self._surface.friction_at(x + c * ahead - s * left, y + s * ahead + c * left)

    def _gravity(self, poses: FloatArray) -> FloatArray:
        """Gravity along the ground under every unit's centre of gravity, along W, (2, N) [m/s2]."""
        x, y, psi = poses.T
        slope = self._surface.gradient(x + self._cg_x * np.cos(psi), y + self._cg_x * np.sin(psi))
        along: FloatArray = -GRAVITY * slope.T / np.sqrt(1.0 + np.sum(slope**2, axis=1))
        return along

    def _poses(self, s: State[FloatArray]) -> FloatArray:
        """x [m], y [m], psi [rad] of each unit's frame in W, (N, 3)."""
        ahead = s.psi[:-1]
        x = np.cumsum(np.concatenate([s.x, self._hitch_x * np.cos(ahead)]))
        y = np.cumsum(np.concatenate([s.y, self._hitch_x * np.sin(ahead)]))
        return np.column_stack([x, y, s.psi])

    def _velocities(self, s: State[FloatArray]) -> FloatArray:
        """v_x, v_y [m/s] of each frame's origin along its unit's axes and yaw rate [rad/s], (N, 3)."""
        relative = s.psi - s.psi[0]
        x = s.v_x - np.concatenate([[0.0], np.cumsum(s.yaw_rate[:-1] * self._hitch_x * np.sin(relative[:-1]))])
        y = s.v_y + np.concatenate([[0.0], np.cumsum(s.yaw_rate[:-1] * self._hitch_x * np.cos(relative[:-1]))])
        c, sin = np.cos(relative), np.sin(relative)
        return np.column_stack([c * x + sin * y, c * y - sin * x, s.yaw_rate])

    def _bodies(self, s: State[FloatArray], poses: FloatArray) -> FloatArray:
        """X_WB of every sprung body, (N, 4, 4): on the ground, rolled outwards and pitched with the specific forces."""
        bodies = np.empty((len(poses), 4, 4))
        for i, unit in enumerate(self._vehicle.units):
            R = rotation_zyx(0.0, -unit.pitch_gradient * s.a_x[i], unit.roll_gradient * s.a_y[i])
            axis = np.array([0.0, 0.0, unit.roll_axis_height])
            x, y, psi = poses[i].tolist()
            bodies[i] = self._surface.pose_on(x, y, psi, unit.supports) @ transform(R, axis - R @ axis)
        return bodies
