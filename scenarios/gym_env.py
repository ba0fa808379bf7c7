"""Gymnasium environments; importing this module registers them.

    import gymnasium
    import scenarios.gym_env

    env = gymnasium.make("offtrack/TrailerSteering-v0")
    many = gymnasium.make_vec("offtrack/TrailerSteering-v0", num_envs=1024)

``gymnasium.make("scenarios.gym_env:offtrack/TrailerSteering-v0")`` imports it implicitly.
"""

from __future__ import annotations

from dataclasses import fields

import gymnasium

from scenarios.environments.registry import CORES, single, vector

__all__ = ["CORES", "single", "vector"]

for _name, (_, _options) in CORES.items():
    _observed = {field.name: field.default for field in fields(_options) if field.name == "observation"}
    gymnasium.register(
        f"offtrack/{_name}",
        entry_point="scenarios.gym_env:single",
        vector_entry_point="scenarios.gym_env:vector",
        kwargs={"name": _name, **_observed},  # every spec records its observation
    )
