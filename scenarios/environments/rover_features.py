"""Features of a rover's observation."""

from __future__ import annotations

from typing import Final

from scenarios.environments.core import Feature

FEATURES: Final = (
    Feature("cross_track", "m", 2.0),
    Feature("heading_error", "rad", 3.2),
    Feature("curvature", "1/m", 2.0),
    Feature("curvature_ahead", "1/m", 2.0),
    Feature("slip_angle", "rad", 3.2),
    Feature("yaw_rate", "rad/s", 5.0),
    Feature("wheel_speed_left", "set speed", 10.0),
    Feature("wheel_speed_right", "set speed", 10.0),
    Feature("inclination_ahead", "-", 1.0),
    Feature("inclination_left", "-", 1.0),
    Feature("speed", "m/s", 1.0),
)
SLIP: Final = [feature.name for feature in FEATURES].index("slip_angle")
IMAGE_FEATURES: Final = (Feature("age", "s", 60.0), *FEATURES[:SLIP], *FEATURES[SLIP + 1 :])
