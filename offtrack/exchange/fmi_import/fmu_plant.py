"""FMUs as plants: another tool's vehicle under offtrack's cameras, drivers and laws.

The vehicle of the scenario stays the data sheet that cameras, outlines, drivers and laws go by.

Models of other tools often take the angles of the road wheels as they are. Drivers and laws are designed for lag and
limits of the data sheet, and the monitor of the actuators expects them: with axles that jump the loop would oscillate.
"""

import copy
import math
from collections import defaultdict
from collections.abc import Container, Mapping
from pathlib import Path
from typing import Any, ClassVar, Final

import numpy as np

from controllers.equations import settle
from offtrack.exchange.fmi_import.fmu_file import FmuFile, open_fmu
from offtrack.exchange.fmi_import.instance import FmuInstance
from offtrack.exchange.fmi_import.mapping import FmuMap, PartSignals, Signal, numbered, read_map
from offtrack.exchange.fmi_import.numbered_signals import (
    GroundUnder,
    column,
    columns,
    ground_signals,
    kind_of,
    motion_signals,
    numbered_values,
)
from scenarios.assembly.adapters import PlantContext
from vehicle.clock import TICK
from vehicle.combination.description import Vehicle
from vehicle.combination.layout import steering_actuators, turned_axles
from vehicle.combination.loads import static_axle_loads
from vehicle.combination.plant import VehicleCommand
from vehicle.combination.truth import Truth
from vehicle.frames import FloatArray, Pose2, rotation_zyx


class SteeringActuators:
    """Actuators of a vehicle's steered axles, which are counted front to rear, from the tractor's on."""

    def __init__(self, vehicle: Vehicle, given: Container[str]) -> None:
        """For the axles whose ``steer_angle_1``, ``steer_angle_2``, … are not among the FMU's ``given`` outputs."""
        self._n_tractor = vehicle.units[0].n_by_driver
        self._n_driver = len(vehicle.units[0].driver_actuators)
        self._actuators = tuple(zip(steering_actuators(vehicle), turned_axles(vehicle), strict=True))
        self._n_axles = sum(len(turned) for _, turned in self._actuators)
        self._given = np.array([f"steer_angle_{k}" in given for k in range(1, self._n_axles + 1)], dtype=bool)

    def straight(self) -> FloatArray:
        """Angles (n_steered,) at the start [rad]."""
        return np.zeros(self._n_axles)

    def turned(self, angles: FloatArray, command: VehicleCommand, duration: float) -> FloatArray:
        """Angles (n_steered,) [rad] after a command was held for ``duration`` [s]; of given axles the demands."""
        demands = self._demands(command)
        after = np.empty(self._n_axles)
        for steering, axles in self._actuators:
            demand = np.mean([demands[axle] / ratio for axle, ratio in axles])
            demand = np.clip(demand, -steering.limit, steering.limit)
            for axle, ratio in axles:
                settled = settle(angles[axle] / ratio, demand, duration, lag=steering.lag, max_rate=steering.rate_limit)
                after[axle] = ratio * float(settled)
        return np.where(self._given, demands, after)

    def _demands(self, command: VehicleCommand) -> FloatArray:
        """Demands of the axles (n_steered,): the driver's turns the first axle of each of the tractor's actuators."""
        demands = np.concatenate([np.empty(self._n_tractor), command.trailer_steer])
        for _, axles in self._actuators[: self._n_driver]:
            for axle, ratio in axles:
                demands[axle] = command.steer * ratio / axles[0][1]
        return demands

    def command(self, command: VehicleCommand, angles: FloatArray) -> VehicleCommand:
        """The command with angles of the axles in the place of demands."""
        return command._replace(steer=float(angles[0]), trailer_steer=tuple(angles[self._n_tractor :].tolist()))


_GAP: Final = 0.05  # between the two ends of a hitch, by the data sheet [m]


def plant_signals(vehicle: Vehicle) -> PartSignals:
    """Signals of a plant of a vehicle; units count from 1, the tractor."""
    units = range(1, len(vehicle.units) + 1)
    trailer = [(unit.name, k) for unit in vehicle.units[1:] for k, _ in enumerate(unit.steered_axles, start=1)]
    return PartSignals(
        kind="plant.fmu",
        inputs=(
            Signal("time", "s", "since the start"),
            Signal("steer", "rad", "demanded road-wheel angle of the tractor's foremost steered axle, + left"),
            Signal("acceleration", "m/s2", "demanded: above 0 drives the way the gear does, below 0 brakes"),
            Signal("gear", "-", "1 forward, -1 backward"),
            *numbered("steer_trailer", "rad", [f"demanded angle of steered axle {k} of {name}" for name, k in trailer]),
            *numbered("friction", "-", [f"friction coefficient under unit {k}" for k in units]),
            *numbered("slope_x", "-", [f"rise of the ground along the x axis of unit {k}" for k in units]),
            *numbered("slope_y", "-", [f"rise of the ground along the y axis of unit {k}" for k in units]),
            *ground_signals(vehicle),
        ),
        outputs=tuple(
            signal._replace(required=kind_of(signal) in ("x", "y", "psi"))
            for signal in motion_signals(vehicle)
            if not kind_of(signal).startswith(("body_", "articulation"))
        ),
        starts=(
            Signal("start_x", "m", "position of the tractor's rear axle at the start"),
            Signal("start_y", "m", "position of the tractor's rear axle at the start"),
            Signal("start_psi", "rad", "heading of all units at the start"),
            Signal("start_speed", "m/s", "speed at the start"),
        ),
    )  # fmt: skip


class FmuPlant:
    """A plant that is an FMU. The state of a run is the number of its step; the FMU keeps its own."""

    fmu: ClassVar[FmuFile]

    @classmethod
    def of(cls, context: PlantContext) -> "FmuPlant":
        """Plant of the scenario's vehicle on its surface.

        Raises:
            ValueError: one line, if the map does not fit.
        """
        return cls(context)

    def __init__(self, context: PlantContext) -> None:
        self._vehicle, self._surface = context.vehicle, context.surface
        if self._surface.gust is not None:
            self._vehicle = self._vehicle.in_wind()
        self._map: FmuMap = read_map(self.fmu, plant_signals(self._vehicle))
        self._ground = GroundUnder(self._surface, self._vehicle)
        self._instance: FmuInstance | None = None
        self._truths: dict[int, Truth] = {}
        self._actuators = SteeringActuators(self._vehicle, given={link.signal for link in self._map.outputs})
        self._n_steered = sum(len(unit.steered_axles) for unit in self._vehicle.units)
        self._loads = np.repeat(0.5 * np.concatenate(static_axle_loads(self._vehicle)), 2)

    def initial_state(self, pose: Pose2, speed: float) -> FloatArray:
        """State at a pose of the tractor, rolling straight at a speed [m/s].

        Raises:
            ValueError: one line, if the FMU can't be started, or its lengths are not those of the data sheet.
        """
        self.close()
        starts = {"start_x": pose.x, "start_y": pose.y, "start_psi": pose.psi, "start_speed": speed}
        self._instance = FmuInstance(self.fmu, self._map, self._map.start_values(starts))
        command = VehicleCommand(0.0, 0.0, (0.0,) * self._vehicle.n_by_law)
        found = self._instance.outputs(self._signals(pose_of_all(self._vehicle, pose), command))
        self._check_place(found, pose)
        self._check_hitches(found)
        self._truths = {0: self._truth(0, found, None, self._actuators.straight())}
        return np.zeros(1)

    def step(self, state: FloatArray, command: VehicleCommand, ticks: int) -> FloatArray:
        """State so many ticks later.

        Raises:
            FmuError: if the FMU fails, stalls, crashes or gives no finite number.
        """
        now = int(state[0])
        instance, last = self._instance, self._truths[now]
        assert instance is not None
        if ticks % instance.period:
            raise ValueError(f"{self.fmu.path}: period = {instance.period} ms does not divide the loop's {ticks} ms")
        poses, found, angles, half = last.poses, {}, last.steer, 0.5 * instance.period * TICK
        for _ in range(ticks // instance.period):
            angles = self._actuators.turned(angles, command, half)
            found = instance.step(instance.period, self._signals(poses, self._actuators.command(command, angles)))
            poses, angles = self._poses(found), self._actuators.turned(angles, command, half)
        self._truths = {now: last, now + ticks: self._truth(now + ticks, found, last, angles)}
        return np.array([float(now + ticks)])

    def observe(self, state: FloatArray, tick: int) -> Truth:
        """Ground truth of this state."""
        return self._truths[int(state[0])]

    def close(self) -> None:
        """End the FMU's process."""
        if self._instance is not None:
            self._instance.close()

    def _signals(self, poses: FloatArray, command: VehicleCommand) -> dict[str, float]:
        x, y, psi = poses.T
        ground = self._surface
        slopes = ground.gradient(x, y)
        c, s = np.cos(psi), np.sin(psi)
        ticks = 0 if self._instance is None else self._instance.ticks
        return {
            "time": ticks * TICK,
            "steer": command.steer,
            "acceleration": command.acceleration,
            "gear": command.gear,
            **numbered_values("steer_trailer", command.trailer_steer),
            **numbered_values("friction", ground.friction_at(x, y)),
            **numbered_values("slope_x", c * slopes[:, 0] + s * slopes[:, 1]),
            **numbered_values("slope_y", c * slopes[:, 1] - s * slopes[:, 0]),
            **self._ground.values(poses),
        }

    def _poses(self, found: Mapping[str, float]) -> FloatArray:
        return columns(found, ("x", "y", "psi"), len(self._vehicle.units))

    def _truth(self, tick: int, found: Mapping[str, float], last: Truth | None, steer: FloatArray) -> Truth:
        found = defaultdict(lambda: math.nan, found)  # signals that are not connected
        poses, n, wheel_count = self._poses(found), len(self._vehicle.units), self._vehicle.n_wheels
        velocities = columns(found, ("v_x", "v_y", "yaw_rate"), n)
        unknown = np.isnan(velocities)
        if unknown.any():
            velocities = np.where(unknown, _velocities(poses, last, tick), velocities)
        speeds = column(found, "wheel_speed", wheel_count)
        return Truth(
            tick=tick,
            poses=poses,
            velocities=velocities,
            bodies=self._bodies(poses, found),
            steer=_or(column(found, "steer_angle", self._n_steered), steer),
            wheel_loads=_or(column(found, "wheel_load", wheel_count), self._loads),
            wheel_slip_angles=_or(column(found, "wheel_slip_angle", wheel_count), np.zeros(wheel_count)),
            friction_used=_or(column(found, "friction_used", wheel_count), np.zeros(wheel_count)),
            load_transfer=_or(column(found, "load_transfer", n), np.zeros(n)),
            wheel_speeds=None if np.isnan(speeds).any() else speeds,
        )

    def _bodies(self, poses: FloatArray, found: Mapping[str, float]) -> FloatArray:
        """Poses of the bodies: on the ground, with heave, pitch and roll about the roll axis below the mass centre."""
        n = len(poses)
        heave, pitch, roll = (_or(column(found, name, n), np.zeros(n)) for name in ("heave", "pitch", "roll"))
        bodies = []
        for k, (x, y, psi) in enumerate(poses.tolist()):
            motion = np.eye(4)
            motion[:3, :3] = rotation_zyx(0.0, float(pitch[k]), float(roll[k]))
            unit = self._vehicle.units[k]
            pivot = np.array([unit.cg_x, 0.0, unit.roll_axis_height])
            motion[:3, 3] = pivot + np.array([0.0, 0.0, heave[k]]) - motion[:3, :3] @ pivot
            bodies.append(self._surface.pose_on(x, y, psi, self._vehicle.supports(k)) @ motion)
        return np.array(bodies)

    def _check_place(self, found: Mapping[str, float], pose: Pose2) -> None:
        away = math.hypot(found["x_1"] - pose.x, found["y_1"] - pose.y)
        turn = abs(math.remainder(found["psi_1"] - pose.psi, math.tau))
        if away > _GAP or turn > _GAP:
            raise ValueError(
                f"{self.fmu.path}: unit 1 begins {away:.2f} m and {math.degrees(turn):.1f} deg from the start of the "
                f"course, ({pose.x:.2f}, {pose.y:.2f}) m and {math.degrees(pose.psi):.1f} deg: connect its start "
                "values to start_x, start_y, start_psi and start_speed in the map's [parameters]"
            )

    def _check_hitches(self, found: Mapping[str, float]) -> None:
        poses = self._poses(found)
        for k, ahead in enumerate(self._vehicle.units[:-1]):
            hitch = Pose2(*poses[k]) @ Pose2(ahead.rear_hitch[0], 0.0, 0.0)
            gap = math.hypot(hitch.x - poses[k + 1, 0], hitch.y - poses[k + 1, 1])
            if gap > _GAP:
                raise ValueError(
                    f"{self.fmu.path}: unit {k + 2} begins {gap:.2f} m from the hitch of {ahead.name}, which is at "
                    f"x = {ahead.rear_hitch[0]:g} m by the data sheet {self._vehicle.name}: its lengths are others; "
                    "choose the vehicle that the FMU simulates"
                )

    def __deepcopy__(self, memo: dict[int, Any]) -> "FmuPlant":
        other = copy.copy(self)
        other._instance, other._truths = copy.deepcopy(self._instance, memo), dict(self._truths)
        return other


def pose_of_all(vehicle: Vehicle, pose: Pose2) -> FloatArray:
    """Poses (N, 3) of the units of a straight combination by the pose of its tractor."""
    poses = [pose]
    for ahead in vehicle.units[:-1]:
        poses.append(poses[-1] @ Pose2(ahead.rear_hitch[0], 0.0, 0.0))
    return np.array(poses)


def _velocities(poses: FloatArray, last: Truth | None, tick: int) -> FloatArray:
    """Velocities (N, 3) along the units' axes, from the poses now and at the last step."""
    if last is None:
        return np.zeros_like(poses)
    time = (tick - last.tick) * TICK
    dx, dy = ((poses - last.poses) / time)[:, :2].T
    turn = np.remainder(poses[:, 2] - last.poses[:, 2] + math.pi, math.tau) - math.pi
    heading = poses[:, 2] - 0.5 * turn
    c, s = np.cos(heading), np.sin(heading)
    return np.column_stack([c * dx + s * dy, c * dy - s * dx, turn / time])


def _or(values: FloatArray, default: FloatArray) -> FloatArray:
    return np.where(np.isnan(values), default, values)


def plant_of(file: str) -> type[FmuPlant]:
    """Class of the plant of an FMU.

    Raises:
        ValueError: one line, if it is no FMU that runs here.
    """
    return type("FmuPlant", (FmuPlant,), {"fmu": open_fmu(Path(file))})
