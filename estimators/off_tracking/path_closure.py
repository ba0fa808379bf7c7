"""A path corrected where a place on it has been recognised: the drift since then is spread over the way since then."""

from __future__ import annotations

import numpy as np

from estimators.off_tracking.pose_chain import Sample, positions_now
from estimators.rigid_motion import chained, stretched
from vehicle.frames import FloatArray, inverse
from vehicle.polyline import arc_length


def closed(samples: tuple[Sample, ...], index: int, X_CK: FloatArray) -> tuple[Sample, ...]:
    """The samples with the one at ``index`` at its measured pose X_CK (4, 4) in the newest one.

    Older samples move with it as one piece; those between turn and shift by their share of the way.
    """
    X_OC = samples[0].X_OS
    way = arc_length(positions_now(samples)[:, :2])
    share = np.minimum(way / way[index], 1.0)
    correction = X_CK @ inverse(inverse(X_OC) @ samples[index].X_OS)
    return tuple(
        sample._replace(X_OS=chained(X_OC, stretched(correction, float(part)) @ inverse(X_OC) @ sample.X_OS))
        for sample, part in zip(samples, share, strict=True)
    )
