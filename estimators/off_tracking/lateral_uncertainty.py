"""Standard deviation of the off-tracking from the errors of the measurements along the path."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from estimators.off_tracking.hitch_path import Crossing
from estimators.off_tracking.pose_chain import Link, Sample
from vehicle.frames import FloatArray

# Share of the variance that is common to all measurements. With it the normalised error of the off-tracking on
# rendered frames has an RMS of 0.5 to 1.0 with scenery and 1.0 to 1.7 on bare ground; without it 1.1 to 1.9 and 1.8 to
# 2.1 (circular matching).
_COMMON = 0.04


def lateral_std(
    samples: Sequence[Sample],
    links: Sequence[Link],
    positions: FloatArray,
    passed: Crossing,
    path_tangent: float,
) -> float:
    """Standard deviation [m] of the path's y at the crossing, from the errors of the measurements that lead there.

    An error (d_theta, d_p) in the measurement that ends at p_i moves the older path by -(d_theta x r + d_p), with r its
    position from p_i; along the normal n of the path this is -(d_theta . (r x n) + d_p . n). The measurement that
    contains the crossing counts in full. Errors are independent except for a common share of their variance, constant
    in the axes of the body: the odometry's slowly varying bias.
    """
    ends = [link.end for link in links]
    R_CO = samples[0].X_OS[:3, :3].T
    n = np.array([-math.tan(path_tangent), 1.0, 0.0])  # y at a fixed x, so along the normal over its y part
    point = np.array([positions[passed.beyond, 0], passed.y, positions[passed.beyond, 2]])
    r = point - positions[ends]
    gradient = np.concatenate([np.cross(r, n), np.broadcast_to(n, r.shape)], axis=1).reshape(-1, 2, 3) @ R_CO
    covariances = np.array([samples[end].covariance for end in ends])
    independent = np.einsum("ij,ijk,ik->", gradient.reshape(-1, 6), covariances, gradient.reshape(-1, 6))
    R_OS = np.array([samples[end].X_OS[:3, :3] for end in ends])
    blocks = covariances.reshape(-1, 2, 3, 2, 3)
    body = np.einsum("iba,imbmc,icd->imad", R_OS, blocks, R_OS)  # of rotation and of translation, along the body
    spread = np.sqrt(np.einsum("imaa->ima", body))
    sense = np.array([link.sense for link in links])
    together = np.einsum("i,ima,ima->ma", sense, gradient @ R_OS, spread)
    return math.sqrt(float(independent + _COMMON * np.sum(np.square(together))))
