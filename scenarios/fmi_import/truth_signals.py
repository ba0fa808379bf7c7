"""Motion of a combination as signals, and back: what sensors sample, by the names of an exported plant's outputs."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping

import numpy as np

from scenarios.fmi_import.mapping import Signal
from vehicle.combination.description import Vehicle
from vehicle.combination.loads import static_axle_loads
from vehicle.combination.truth import Truth
from vehicle.frames import FloatArray, rotation_zyx, transform

_BODY = ("x", "y", "z", "roll", "pitch", "yaw")
OnGround = Callable[[int, float, float, float], FloatArray]


def truth_signals(vehicle: Vehicle) -> tuple[Signal, ...]:
    """Signals of the motion of a vehicle; units count from 1, the tractor."""
    units = range(1, len(vehicle.units) + 1)
    axles = [(unit.name, k) for unit in vehicle.units for k, _ in enumerate(unit.steered_axles, start=1)]
    return (
        *(Signal(f"x_{k}", "m", f"position of the frame of unit {k} in the world") for k in units),
        *(Signal(f"y_{k}", "m", f"position of the frame of unit {k} in the world") for k in units),
        *(Signal(f"psi_{k}", "rad", f"heading of unit {k}, + left, continuous") for k in units),
        *(Signal(f"v_x_{k}", "m/s", f"velocity of that point along the x axis of unit {k}") for k in units),
        *(Signal(f"v_y_{k}", "m/s", f"along the y axis of unit {k}") for k in units),
        *(Signal(f"yaw_rate_{k}", "rad/s", f"of unit {k}") for k in units),
        *(Signal(f"body_{axis}_{k}", "m" if axis in "xyz" else "rad", f"pose of the body of unit {k} in the world; "
                 "all six 0: it stands on the ground") for k in units for axis in _BODY),
        *(Signal(f"steer_angle_{k}", "rad", f"steered axle {axle} of {name}, + left")
          for k, (name, axle) in enumerate(axles, start=1)),
    )  # fmt: skip


def truth_values(truth: Truth) -> dict[str, float]:
    """Signals [SI] of a ground truth."""
    return {
        **{f"{name}_{k}": value for name, column in zip(("x", "y", "psi"), truth.poses.T, strict=True)
           for k, value in enumerate(column.tolist(), start=1)},
        **{f"{name}_{k}": value for name, column in zip(("v_x", "v_y", "yaw_rate"), truth.velocities.T, strict=True)
           for k, value in enumerate(column.tolist(), start=1)},
        **{f"body_{axis}_{k}": value for k, body in enumerate(truth.bodies, start=1)
           for axis, value in zip(_BODY, _six(body), strict=True)},
        **{f"steer_angle_{k}": value for k, value in enumerate(truth.steer.tolist(), start=1)},
    }  # fmt: skip


def truth_of(tick: int, values: Mapping[str, float], vehicle: Vehicle, on_ground: OnGround) -> Truth:
    """The ground truth behind signals; wheel loads are the static ones, slip angles and friction used are 0.

    Args:
        tick: its time.
        values: signals by name.
        vehicle: the vehicle that moves.
        on_ground: pose (4, 4) of the body of a unit that stands on the ground at x, y, psi.
    """
    n, steered = len(vehicle.units), sum(len(unit.steered_axles) for unit in vehicle.units)
    poses = _columns(values, ("x", "y", "psi"), n)
    bodies = []
    for k, (x, y, psi) in enumerate(poses.tolist()):
        six = [values[f"body_{axis}_{k + 1}"] for axis in _BODY]
        is_given = any(six)
        R_WB = rotation_zyx(six[5], six[4], six[3])
        bodies.append(transform(R_WB, np.array(six[:3])) if is_given else on_ground(k, x, y, psi))
    return Truth(
        tick=tick,
        poses=poses,
        velocities=_columns(values, ("v_x", "v_y", "yaw_rate"), n),
        bodies=np.array(bodies),
        steer=_columns(values, ("steer_angle",), steered)[:, 0],
        wheel_loads=np.repeat(0.5 * np.concatenate(static_axle_loads(vehicle)), 2),
        wheel_slip_angles=np.zeros(vehicle.n_wheels),
        friction_used=np.zeros(vehicle.n_wheels),
        load_transfer=np.zeros(n),
    )


def _columns(values: Mapping[str, float], names: Iterable[str], count: int) -> FloatArray:
    return np.array([[values[f"{name}_{k}"] for name in names] for k in range(1, count + 1)])


def _six(X: FloatArray) -> list[float]:
    """Position [m], then roll, pitch and yaw [rad] of a pose (4, 4)."""
    x, y, z = X[:3, 3].tolist()
    roll = math.atan2(X[2, 1], X[2, 2])
    pitch = math.atan2(-X[2, 0], math.hypot(X[2, 1], X[2, 2]))
    return [x, y, z, roll, pitch, math.atan2(X[1, 0], X[0, 0])]
