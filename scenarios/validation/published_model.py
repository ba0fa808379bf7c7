"""Kinematic trailer model of the package commonroad-vehicle-models, driven like the dynamic model.

The package is a development dependency; nothing else of the program needs it.
"""

from __future__ import annotations

from collections.abc import Sequence
from importlib.util import find_spec
from types import SimpleNamespace
from typing import Final

import numpy as np
from scipy.interpolate import CubicSpline

from vehicle.clock import TICK
from vehicle.combination.description import Vehicle
from vehicle.combination.truth import Truth
from vehicle.frames import FloatArray

PACKAGE: Final = "commonroad-vehicle-models"
_WIDE: Final = 1e3  # limits of steering, speed and acceleration that are never reached, in any unit


def installed() -> bool:
    """True if the package is installed."""
    return find_spec("vehiclemodels") is not None


def kinematic_poses(vehicle: Vehicle, truths: Sequence[Truth]) -> FloatArray:
    """Poses (n, 2, 3) of a tractor and a trailer hitched to its rear axle, steered and driven like the dynamic model.

    Steer rate and acceleration come from splines through the steer angles and speeds of the dynamic model.
    """
    from vehiclemodels.vehicle_dynamics_kst import vehicle_dynamics_kst

    time = np.array([now.tick for now in truths]) * TICK
    steer = CubicSpline(time, [now.steer[0] for now in truths])
    speed = CubicSpline(time, [now.velocities[0, 0] for now in truths])
    parameters, (steer_rate, acceleration) = _parameters(vehicle), (steer.derivative(), speed.derivative())

    def rate(t: float, x: FloatArray) -> FloatArray:
        inputs = [float(steer_rate(t)), float(acceleration(t))]
        return np.array(vehicle_dynamics_kst(x.tolist(), inputs, parameters))

    x_0, y_0, psi_0 = truths[0].poses[0]
    # the package's hitch angle is the trailer's yaw minus the tractor's
    x = np.array([x_0, y_0, float(steer(0.0)), float(speed(0.0)), psi_0, truths[0].poses[1, 2] - psi_0])
    states = [x]
    for t, h in zip(time[:-1].tolist(), np.diff(time).tolist(), strict=True):
        k_1 = rate(t, x)
        k_2 = rate(t + 0.5 * h, x + 0.5 * h * k_1)
        k_3 = rate(t + 0.5 * h, x + 0.5 * h * k_2)
        k_4 = rate(t + h, x + h * k_3)
        x = x + h / 6.0 * (k_1 + 2.0 * k_2 + 2.0 * k_3 + k_4)
        states.append(x)
    x_T, y_T, _, _, psi_T, hitch = np.array(states).T
    return np.stack([np.stack([x_T, y_T, psi_T], axis=1), np.stack([x_T, y_T, psi_T + hitch], axis=1)], axis=1)


def _parameters(vehicle: Vehicle) -> SimpleNamespace:
    """Parameters of the package's model; only the sum of ``a`` and ``b``, the wheelbase, matters."""
    return SimpleNamespace(
        a=vehicle.units[0].steered_axles[0].x,
        b=0.0,
        trailer=SimpleNamespace(l_wb=-vehicle.units[1].axles[0].x),
        steering=SimpleNamespace(min=-_WIDE, max=_WIDE, v_min=-_WIDE, v_max=_WIDE),
        longitudinal=SimpleNamespace(v_min=-_WIDE, v_max=_WIDE, v_switch=_WIDE, a_max=_WIDE),
    )
