"""``Truth`` from the vectors that the plants' functions return."""

from __future__ import annotations

from vehicle.combination.description import Vehicle
from vehicle.combination.kinematics import Kinematics, kinematics_sizes
from vehicle.combination.plant_inputs import slices
from vehicle.combination.truth import Truth
from vehicle.combination.wheel_truth import WheelTruth, wheel_truth_sizes
from vehicle.frames import FloatArray


class TruthAssembly:
    """Builds ``Truth`` for vehicles of one topology."""

    def __init__(self, vehicle: Vehicle) -> None:
        self._kinematics = Kinematics(*slices(kinematics_sizes(vehicle)))
        self._wheels = WheelTruth(*slices(wheel_truth_sizes(vehicle)))

    def truth(self, tick: int, kinematics: FloatArray, wheels: FloatArray, bodies: FloatArray) -> Truth:
        """Ground truth from the vectors ``Kinematics`` and ``WheelTruth``, and all X_WB row by row."""
        return Truth(
            tick=tick,
            poses=kinematics[self._kinematics.poses].reshape(-1, 3),
            velocities=kinematics[self._kinematics.velocities].reshape(-1, 3),
            bodies=bodies.reshape(-1, 4, 4),
            steer=wheels[self._wheels.steer],
            wheel_loads=wheels[self._wheels.loads],
            wheel_slip_angles=wheels[self._wheels.slip_angles],
            friction_used=wheels[self._wheels.friction_used],
            load_transfer=wheels[self._wheels.load_transfer],
        )
