"""A combination that rolls without slip: the purely kinematic model the dynamic one has to tend to.

Every unit rolls on one axle, or on a group of axles as if it were one in the middle of the group.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from controllers.path import Path
from vehicle.combination.description import Vehicle
from vehicle.frames import FloatArray

_SPACING = 0.02  # of the steps along the path [m]: fourth order, far below a micrometre


class RollingChain(NamedTuple):
    """Lengths of a combination that rolls without slip."""

    hitches: tuple[float, ...]  # x of the hitch of every unit but the last [m]
    lengths: tuple[float, ...]  # hitch to axle of every towed unit [m]


def rolling_chain(vehicle: Vehicle) -> RollingChain:
    """The lengths of a vehicle, the unsteered axles of each towed unit taken as one in their middle."""
    return RollingChain(
        hitches=tuple(unit.hitch_x or 0.0 for unit in vehicle.units[:-1]),
        lengths=tuple(-float(np.mean([axle.x for axle in unit.axles])) for unit in vehicle.units[1:]),
    )


def poses_along(chain: RollingChain, path: Path, reference: tuple[float, float], extra: float = 0.0) -> FloatArray:
    """x [m], y [m], psi [rad] of every unit's frame, (n, N, 3), while a point of the tractor runs along a path.

    ``reference`` is that point's place in the tractor [m]; the combination is straight at the start, and goes on
    straight for ``extra`` [m] past the path's end.
    """
    steps = int(np.ceil((path.length + extra) / _SPACING))
    h = (path.length + extra) / steps
    psi = np.full(1 + len(chain.lengths), path.start.psi)
    found = [_poses(chain, path, reference, 0.0, psi)]
    for k in range(steps):
        s = k * h
        k_1 = _turning(chain, path, reference, s, psi)
        k_2 = _turning(chain, path, reference, s + 0.5 * h, psi + 0.5 * h * k_1)
        k_3 = _turning(chain, path, reference, s + 0.5 * h, psi + 0.5 * h * k_2)
        k_4 = _turning(chain, path, reference, s + h, psi + h * k_3)
        psi = psi + h / 6.0 * (k_1 + 2.0 * k_2 + 2.0 * k_3 + k_4)
        found.append(_poses(chain, path, reference, s + h, psi))
    return np.array(found)


def _turning(chain: RollingChain, path: Path, reference: tuple[float, float], s: float, psi: FloatArray) -> FloatArray:
    """Yaw of each unit per metre of the guided point's way [rad/m]: no axle moves sideways."""
    x_ref, y_ref = reference
    chi = path.pose(s).psi - psi[0]
    turning = np.empty(len(psi))
    turning[0] = np.sin(chi) / x_ref
    forward, left = np.cos(chi) + turning[0] * y_ref, 0.0  # velocity of the unit's origin, per metre of way
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
