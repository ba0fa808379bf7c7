"""Ground under a combination as signals: what an exported plant takes, by the poses of its units."""

from __future__ import annotations

import numpy as np

from scenarios.fmi_import.mapping import Signal
from vehicle.combination.attitude import SmoothGround, smooth_ground_sizes
from vehicle.combination.description import Vehicle
from vehicle.combination.ground_inputs import SurfaceLookup
from vehicle.combination.layout import wheels
from vehicle.combination.plant_inputs import GroundInputs, ground_input_sizes, slices
from vehicle.combination.truth_vectors import Kinematics, kinematics_sizes
from vehicle.frames import FloatArray
from vehicle.surface import Surface

_NAMES = GroundInputs("friction_wheel", "ground_slope_x", "ground_slope_y", "road_height", "wind")
_HEIGHT = "ground_height"


def ground_signals(vehicle: Vehicle) -> tuple[Signal, ...]:
    """Signals of the ground under a vehicle; units and wheels count from the front, left before right."""
    units, tyres = range(1, len(vehicle.units) + 1), range(1, vehicle.n_wheels + 1)
    supports = range(1, 1 + smooth_ground_sizes(vehicle).height)
    return (
        *(Signal(f"friction_wheel_{k}", "-", f"friction coefficient under wheel {k}") for k in tyres),
        *(Signal(f"ground_slope_x_{k}", "-", "under its centre of gravity, along x of the world") for k in units),
        *(Signal(f"ground_slope_y_{k}", "-", "along y of the world") for k in units),
        *(Signal(f"road_height_{k}", "m", f"of the road under wheel {k}, roughness alone") for k in tyres),
        *(Signal(f"wind_{k}", "m/s", f"at unit {k}, along y of the world") for k in units if vehicle.exposed),
        *(
            Signal(f"{_HEIGHT}_{k}", "m", f"of the smooth ground at {'rear' if k % 2 == 0 else 'front'} support of "
                   f"unit {(k + 1) // 2}")
            for k in supports
        ),
        *(Signal(f"body_slope_x_{k}", "-", "mean of its supports less ground_slope_x") for k in units),
        *(Signal(f"body_slope_y_{k}", "-", "mean of its supports less ground_slope_y") for k in units),
    )  # fmt: skip


class GroundUnder:
    """Ground of a surface under the wheels, centres of gravity and supports of a vehicle."""

    def __init__(self, surface: Surface, vehicle: Vehicle) -> None:
        self._lookup = SurfaceLookup(surface, vehicle)
        self._into = Kinematics(*slices(kinematics_sizes(vehicle)))
        self._parts = GroundInputs(*slices(ground_input_sizes(vehicle)))
        self._smooth = SmoothGround(*slices(smooth_ground_sizes(vehicle)))
        self._size = sum(kinematics_sizes(vehicle))
        units = range(len(vehicle.units))
        self._centres = np.array([(k, vehicle.units[k].cg_x, 0.0) for k in units])
        self._wheels = np.array([(wheel.unit, wheel.axle.x, wheel.y) for wheel in wheels(vehicle)])
        self._supports = np.array([(k, x, 0.0) for k in units for x in vehicle.supports(k)])

    def values(self, poses: FloatArray) -> dict[str, float]:
        """Signals [SI] under units at these poses (N, 3)."""
        at, into = np.zeros(self._size), self._into
        at[into.centre_x], at[into.centre_y] = _places(poses, self._centres)
        at[into.wheel_x], at[into.wheel_y] = _places(poses, self._wheels)
        at[into.support_x], at[into.support_y] = _places(poses, self._supports)
        inputs, smooth = self._lookup.ground_inputs(at), self._lookup.smooth_ground(at)
        columns = dict(zip(_NAMES, (inputs[part] for part in self._parts), strict=True))
        columns[_HEIGHT] = smooth[self._smooth.height]
        for axis, of_supports in (("x", self._smooth.slope_x), ("y", self._smooth.slope_y)):
            columns[f"body_slope_{axis}"] = _means(smooth[of_supports]) - columns[f"ground_slope_{axis}"]
        return {f"{name}_{k}": x for name, column in columns.items() for k, x in enumerate(column.tolist(), start=1)}


def _means(of_supports: FloatArray) -> FloatArray:
    """Means (N,) of the front and rear support of every unit."""
    means: FloatArray = 0.5 * (of_supports[0::2] + of_supports[1::2])
    return means


def _places(poses: FloatArray, points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Positions x, y in the world of points (unit, x, y) in the frames of their units."""
    x, y, psi = poses[points[:, 0].astype(int)].T
    _, along, left = points.T
    c, s = np.cos(psi), np.sin(psi)
    return x + (c * along - s * left), y + (s * along + c * left)
