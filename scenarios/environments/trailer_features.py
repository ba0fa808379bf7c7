"""Features of a trailer's observation."""

from __future__ import annotations

from typing import Final

from controllers.trailer_steering.policy import feature_names
from scenarios.environments.core import Feature
from vehicle.combination.description import Vehicle


def features(vehicle: Vehicle, n_steered: int) -> tuple[Feature, ...]:
    """All entries of the observation, as a policy in the loop gets them."""
    names = feature_names(n_steered, [unit.name for unit in vehicle.units])
    return tuple(
        Feature(name, *next(kind for start, kind in _KINDS.items() if name.startswith(start))) for name in names
    )


def own_features(vehicle: Vehicle, n_steered: int) -> tuple[Feature, ...]:
    """Features next to an image: its age, and the signals of the combination's own sensors."""
    entries = features(vehicle, n_steered)
    names = [feature.name for feature in entries]
    return (entries[names.index("age")], *entries[names.index("usable") + 1 :])


_KINDS: Final = {  # prefix of the name: unit and limit
    "off_tracking": ("m", 10.0),
    "path_direction": ("rad", 3.2),
    "path_": ("m", 20.0),
    "hitch_v_": ("m/s", 40.0),
    "trailer_yaw_rate": ("rad/s", 5.0),
    "age": ("s", 60.0),
    "usable": ("-", 1.0),
    "steer_": ("rad", 1.6),
    "speed": ("m/s", 40.0),
    "articulation_": ("rad", 3.2),
    "yaw_rate_": ("rad/s", 5.0),
    "follow_distance": ("m", 50.0),
}
