"""Environments by name, single and vectorised."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields
from functools import partial
from typing import Any, Final

from scenarios.environments.core import Core
from scenarios.environments.driving import TractorTrailerDriving, TractorTrailerDrivingOptions
from scenarios.environments.repeated import Repeated
from scenarios.environments.rover_options import RoverSteeringOptions
from scenarios.environments.rover_steering import RoverSteering
from scenarios.environments.single import RenderMode, SingleEnv
from scenarios.environments.trailer_steering import TrailerSteering, TrailerSteeringOptions
from scenarios.environments.vector import CoreVectorEnv


def trailer_steering(n: int, **options: Any) -> TrailerSteering:
    """A core of ``TrailerSteering-v0``."""
    return TrailerSteering(n, TrailerSteeringOptions(**options))


def tractor_trailer_driving(n: int, **options: Any) -> TractorTrailerDriving:
    """A core of ``TractorTrailerDriving-v0``."""
    return TractorTrailerDriving(n, TractorTrailerDrivingOptions(**options))


def rover_steering(n: int, **options: Any) -> RoverSteering:
    """A core of ``RoverSteering-v0``."""
    return RoverSteering(n, RoverSteeringOptions(**options))


CORES: Final[dict[str, tuple[Callable[..., Core], Any]]] = {
    "TrailerSteering-v0": (trailer_steering, TrailerSteeringOptions),
    "TractorTrailerDriving-v0": (tractor_trailer_driving, TractorTrailerDrivingOptions),
    "RoverSteering-v0": (rover_steering, RoverSteeringOptions),
}

_REPEAT: Final = "action_repeat"


def single(name: str, render_mode: RenderMode | None = None, **options: Any) -> SingleEnv:
    """One environment of this name; ``action_repeat``, besides its options, lets actions hold for so many steps.

    Raises:
        ValueError: one line, if an option is none or does not fit.
    """
    return SingleEnv(_builder(name, options), render_mode)


def vector(name: str, num_envs: int = 1, **options: Any) -> CoreVectorEnv:
    """Many environments of this name; ``autoreset_mode``, ``render_mode`` and ``action_repeat`` besides its options."""
    own = {key: options.pop(key) for key in ("autoreset_mode", "render_mode") if key in options}
    return CoreVectorEnv(_builder(name, options), num_envs, **own)


def _builder(name: str, options: dict[str, Any]) -> Any:
    build, known = CORES[name]
    repeat = options.pop(_REPEAT, 1)
    names = [field.name for field in fields(known)]
    for option in options:
        if option not in names:
            raise ValueError(f"{name}: unknown option '{option}'; it has {', '.join((*names, _REPEAT))}")
    return partial(build, **options) if repeat == 1 else partial(_repeated, partial(build, **options), repeat)


def _repeated(build: Callable[[int], Core], repeat: int, n: int) -> Repeated:
    return Repeated(build(n), repeat)
