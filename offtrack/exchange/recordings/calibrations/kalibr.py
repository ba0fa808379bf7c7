"""Kalibr: ``camchain*.yaml``, whose ``T_cn_cnm1`` of cam1 leads from the left camera to the right one."""

from collections.abc import Sequence

from offtrack.exchange.recordings.calibrations.cameras import Pair, Tables, listed, numbers
from vehicle.frames import inverse


def pair(tables: Tables, size: Sequence[int]) -> Pair:
    """Cameras of one table with cam0 and cam1."""
    left, right = (listed(tables[0][name], size) for name in ("cam0", "cam1"))
    return left, right, inverse(numbers(tables[0]["cam1"]["T_cn_cnm1"]).reshape(4, 4))
