"""Combination on a straight line at constant speed and slip angle: its off-tracking is known in closed form.

De Saxe & Cebon 2018, "Estimation of trailer off-tracking using visual odometry", section 3.1: constant speed, constant
slip angle. With the follow point L_f behind the hitch the off-tracking is e = -L_f tan(slip angle).
"""

from __future__ import annotations

import math

import numpy as np

from vehicle.clock import TICK
from vehicle.combination.description import Vehicle
from vehicle.combination.layout import wheels
from vehicle.combination.loads import static_axle_loads
from vehicle.combination.plant import VehicleCommand
from vehicle.combination.truth import Truth
from vehicle.frames import FloatArray, Pose2
from vehicle.surface import Surface


class ConstantSlipPlant:
    """A combination with prescribed motion at a constant slip angle.

    Units ahead of ``unit`` point in the direction of travel; ``unit`` and those behind it travel ``slip_angle`` [rad]
    to the left of their heading. Tyre forces are not modelled: commands have no effect, loads are static, no friction
    is used.
    """

    def __init__(self, vehicle: Vehicle, surface: Surface, *, unit: int, slip_angle: float, speed: float) -> None:
        if not 1 <= unit < len(vehicle.units):
            raise ValueError(f"unit = {unit} must be a towed unit of {vehicle.name}, 1 to {len(vehicle.units) - 1}")
        if not abs(slip_angle) <= math.radians(80.0):
            raise ValueError(f"slip_angle = {slip_angle} rad must be within +-{math.radians(80.0):.4f} rad (80 deg)")
        if not speed > 0.0:
            raise ValueError(f"speed = {speed} m/s must be positive")
        self._vehicle = vehicle
        self._surface = surface
        self._speed = speed
        n = len(vehicle.units)
        self._slip = np.where(np.arange(n) < unit, 0.0, slip_angle)  # of every unit [rad]
        self._loads = np.repeat(0.5 * np.concatenate(static_axle_loads(vehicle)), 2)  # (n_wheels,) [N]
        self._wheel_unit = [wheel.unit for wheel in wheels(vehicle)]
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
