"""EuRoC: a ``sensor.yaml`` for each camera, whose ``T_BS`` is the camera's pose in the body."""

from collections.abc import Sequence

from offtrack.exchange.recordings.calibrations.cameras import Pair, Tables, listed, numbers
from vehicle.frames import inverse


def pair(tables: Tables, size: Sequence[int]) -> Pair:
    """Cameras of two tables with T_BS."""
    X_BCl, X_BCr = (numbers(table["T_BS"]).reshape(4, 4) for table in tables)
    return listed(tables[0], size), listed(tables[1], size), inverse(X_BCl) @ X_BCr
