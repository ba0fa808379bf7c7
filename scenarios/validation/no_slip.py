"""Kinematic model of a combination that rolls without slip: the limit of the dynamic model.

Every unit rolls on one axle; a group of axles is replaced by one in its middle.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from controllers.path import Path
from vehicle.combination.description import Vehicle
from vehicle.frames import FloatArray

_SPACING = 0.02  # step size along the path [m]: the fourth-order error is far below a micrometre


class RollingChain(NamedTuple):
    """Lengths of a combination that rolls without slip."""

    hitches: tuple[float, ...]  # x of the hitch of every unit but the last [m]
    lengths: tuple[float, ...]  # hitch to axle of every towed unit [m]


def rolling_chain(vehicle: Vehicle) -> RollingChain:
    """Lengths of a vehicle, with one axle in the middle of the axles of each towed unit."""
    return RollingChain(
        hitches=tuple(unit.hitch_x or 0.0 for unit in vehicle.units[:-1]),
        lengths=tuple(-float(np.mean([axle.x for axle in unit.axles])) for unit in vehicle.units[1:]),
    )


def poses_along(chain: RollingChain, path: Path, reference: tuple[float, float], extra: float = 0.0) -> FloatArray:
    """x [m], y [m], psi [rad] of every unit's frame, (n, N, 3), while a point of the tractor moves along a path.

    ``reference`` is the position of that point in the tractor [m]. The combination is straight at the start. It
    continues straight for ``extra`` [m] beyond the end of the path.
    """
    steps = int(np.ceil((path.length + extra) / _SPACING))
    h = (path.length + extra) / steps
    psi = np.full(1 + len(chain.lengths), path.start.psi)
    poses = [_poses(chain, path, reference, 0.0, psi)]
    for k in range(steps):
        s = k * h
        k_1 = _turning(chain, path, reference, s, psi)
        k_2 = _turning(chain, path, reference, s + 0.5 * h, psi + 0.5 * h * k_1)
        k_3 = _turning(chain, path, reference, s + 0.5 * h, psi + 0.5 * h * k_2)
        k_4 = _turning(chain, path, reference, s + h, psi + h * k_3)
        psi = psi + h / 6.0 * (k_1 + 2.0 * k_2 + 2.0 * k_3 + k_4)
        poses.append(_poses(chain, path, reference, s + h, psi))
    return np.array(poses)


def _turning(chain: RollingChain, path: Path, reference: tuple[float, float], s: float, psi: FloatArray) -> FloatArray:
    """Yaw of each unit per distance of the guided point [rad/m], with no axle moving sideways."""
    x_ref, y_ref = reference
    chi = path.pose(s).psi - psi[0]
    turning = np.empty(len(psi))
    turning[0] = np.sin(chi) / x_ref
    forward, left = np.cos(chi) + turning[0] * y_ref, 0.0  # velocity of the unit's origin over that of the guided point
    for k, (hitch, length) in enumerate(zip(chain.hitches, chain.lengths, strict=True)):
        left = left + turning[k] * hitch
        gamma = psi[k] - psi[k + 1]
        c, sn = np.cos(gamma), np.sin(gamma)
        forward, left = c * forward - sn * left, sn * forward + c * left
        turning[k + 1] = left / length
    return turning


def _poses(chain: RollingChain, path: Path, reference: tuple[float, float], s: float, psi: FloatArray) -> FloatArray:
    point = path.pose(s)
    c, sn = np.cos(psi), np.sin(psi)
    x = point.x - c[0] * reference[0] + sn[0] * reference[1]
    y = point.y - sn[0] * reference[0] - c[0] * reference[1]
    ahead = np.array(chain.hitches)
    x_of = x + np.concatenate([[0.0], np.cumsum(ahead * c[:-1])])
    y_of = y + np.concatenate([[0.0], np.cumsum(ahead * sn[:-1])])
    return np.column_stack([x_of, y_of, psi])
