"""What tests of environments share."""

from __future__ import annotations

from typing import Any

import numpy as np

from offtrack.environments.core import Features, Observation
from offtrack.environments.registry import CORES
from offtrack.environments.rewards import Moment

TRAILER, DRIVING, ROVER = CORES


def off_path(moment: Moment) -> Any:
    """Ending that random steering meets within seconds."""
    return np.abs(moment.off_tracking) > 0.03


def features(observation: Observation) -> Features:
    """The observation of an environment without images."""
    assert isinstance(observation, np.ndarray)
    return observation
