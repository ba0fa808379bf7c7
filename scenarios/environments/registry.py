"""Single and vector environments by name."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields
from functools import partial
from typing import Any, Final

from scenarios.environments.checks import checked_count, checked_options
from scenarios.environments.core import Core
from scenarios.environments.driving import TractorTrailerDriving, TractorTrailerDrivingOptions
from scenarios.environments.repeated import Repeated
from scenarios.environments.rover_options import RoverSteeringOptions
from scenarios.environments.rover_steering import RoverSteering
from scenarios.environments.single import RenderMode, SingleEnv
from scenarios.environments.trailer_steering import TrailerSteering, TrailerSteeringOptions
from scenarios.environments.vector import CoreVectorEnv
from vehicle.parameter_file import nearest

CORES: Final[dict[str, tuple[Callable[[int, Any], Core], type[Any]]]] = {  # core and its options
    "TrailerSteering-v0": (TrailerSteering, TrailerSteeringOptions),
    "TractorTrailerDriving-v0": (TractorTrailerDriving, TractorTrailerDrivingOptions),
    "RoverSteering-v0": (RoverSteering, RoverSteeringOptions),
}

_REPEAT: Final = "action_repeat"
_MAX_REPEAT: Final = 1000  # control steps


def single(name: str, render_mode: RenderMode | None = None, **options: Any) -> SingleEnv:
    """One environment of this name; besides its options, ``action_repeat`` repeats each action for that many steps.

    Raises:
        ValueError: one line, if an option is unknown or does not fit.
    """
    return SingleEnv(_builder(name, options), render_mode)


def vector(name: str, num_envs: int = 1, **options: Any) -> CoreVectorEnv:
    """Vector environment of this name; options also include ``autoreset_mode``, ``render_mode``, ``action_repeat``."""
    own = {key: options.pop(key) for key in ("autoreset_mode", "render_mode") if key in options}
    return CoreVectorEnv(_builder(name, options), num_envs, **own)


def _builder(name: str, options: dict[str, Any]) -> Callable[[int], Core]:
    """Function that builds a core of n episodes; it can be pickled."""
    if name not in CORES:
        raise ValueError(f"unknown environment {name!r:.80}{nearest(str(name), CORES)}")
    repeat = checked_count(_REPEAT, options.pop(_REPEAT, 1), _MAX_REPEAT)
    names = [field.name for field in fields(CORES[name][1])]
    for option in options:
        if option not in names:
            raise ValueError(f"{name}: unknown option '{option:.80}'; it has {', '.join((*names, _REPEAT))}")
    return partial(_core, name, repeat, options)


def _core(name: str, repeat: int, options: dict[str, Any], n: int) -> Core:
    build, options_type = CORES[name]
    core = build(n, checked_options(options_type, options, name))
    return core if repeat == 1 else Repeated(core, repeat)
