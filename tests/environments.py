"""What tests of environments share."""

from typing import Any

import numpy as np

from offtrack.environments.core import Features, Observation
from offtrack.environments.registry import CORES
from offtrack.environments.rewards import Moment
from scenarios.assembly.surrogate import SurrogateParameters

TRAILER, DRIVING, ROVER = CORES
PERFECT = SurrogateParameters(
    bias=0.0, drift=0.0, drift_time=2.0, noise=0.0, loss_rate=0.0, loss_duration=0.5, velocity_noise=0.0,
    yaw_rate_noise=0.0,
)  # fmt: skip


def off_path(moment: Moment) -> Any:
    """Ending that random steering meets within seconds."""
    return np.abs(moment.off_tracking) > 0.03


def features(observation: Observation) -> Features:
    """The observation of an environment without images."""
    assert isinstance(observation, np.ndarray)
    return observation
