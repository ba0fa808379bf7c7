"""Loop closure: a recognised pose on the path corrects the drift since then, in proportion to the distance."""

from __future__ import annotations

import numpy as np

from estimators.off_tracking.pose_chain import Sample, positions_now
from estimators.rigid_motion import chained, stretched
from vehicle.frames import FloatArray, inverse
from vehicle.polyline import arc_length


def closed(samples: tuple[Sample, ...], index: int, X_CK: FloatArray) -> tuple[Sample, ...]:
    """Samples corrected so that the one at ``index`` has its measured pose X_CK (4, 4) in the newest one.

    Older samples move with it rigidly; those between are corrected by their share of the distance.
    """
    X_OC = samples[0].X_OS
    distance = arc_length(positions_now(samples)[:, :2])
    share = np.minimum(distance / distance[index], 1.0)
    correction = X_CK @ inverse(inverse(X_OC) @ samples[index].X_OS)
    return tuple(
        sample._replace(X_OS=chained(X_OC, stretched(correction, float(part)) @ inverse(X_OC) @ sample.X_OS))
        for sample, part in zip(samples, share, strict=True)
    )
