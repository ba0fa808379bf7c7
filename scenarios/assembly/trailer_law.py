"""Construct trailer steering laws by name, guarded against bad estimates, reversing and actuators at fault."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from typing import Any, Final

from controllers.checked import CheckedLaw
from controllers.trailer import Combination, TrailerGeometry, TrailerSteering
from controllers.trailer_steering.guard import Degradation, Guarded, guard_memory
from controllers.trailer_steering.reverse_lock import ReverseLock
from controllers.trailer_steering.supervision import Supervised
from scenarios.catalogue import TRAILER_STEERING, constructed, resolve
from scenarios.options.scenario import Scenario
from vehicle.option import Option, Parameter, declared_options
from vehicle.parameter_file import nearest

_COMBINATION: Final = "combination"  # keyword for the data sheet of the whole combination


def law_options(law: Callable[..., object]) -> tuple[Option, ...]:
    """Options of a law's class."""
    return declared_options(law, skip=(_COMBINATION,))


def law_uses_off_tracking(name: str) -> bool:
    """True if a law uses the estimated off-tracking, which is the default of its class."""
    return bool(getattr(resolve("trailer_steering", name, TRAILER_STEERING), "uses_off_tracking", True))


def steering_parameters(scenario: Scenario) -> dict[str, Parameter]:
    """Parameters of a scenario's law.

    Raises:
        ValueError: one line, if the file of a policy is missing.
    """
    parameters = dict(scenario.steering)
    if scenario.trailer_steering == "policy":
        if scenario.policy.path is None:
            raise ValueError("trailer_steering = policy: policy.path is missing (the file of the network)")
        parameters["path"] = scenario.policy.path
    return parameters


def trailer_law(
    name: str,
    trailer: TrailerGeometry,
    combination: Combination,
    parameters: Mapping[str, Parameter],
    degradation: Degradation | None = None,
) -> TrailerSteering[Any]:
    """Construct a trailer's law by its name in the catalogue or as ``package.module:Name``.

    Every step is checked. The law is guarded against bad estimates, by default as `Degradation` says, unless its
    class has ``uses_off_tracking = False``; in reverse the axles are locked straight. The actuators are supervised.

    Raises:
        ValueError: one line, if there is no such law, a parameter is unknown or outside its limits, or the law cannot
            be constructed.
    """
    law: TrailerSteering[Any] = bare_law(name, trailer, combination, parameters)
    if not trailer.steered_distances:
        return law
    if law_uses_off_tracking(name):
        law = Guarded(law, trailer, combination, degradation or Degradation())
    return Supervised(ReverseLock(law, trailer), trailer, combination)


def fallback_steers(memory: object) -> bool:
    """True while the fallback steers in place of a law, by the memory of what `trailer_law` has constructed."""
    guard = guard_memory(memory)
    return guard is not None and not guard.steers


def bare_law(
    name: str, trailer: TrailerGeometry, combination: Combination, parameters: Mapping[str, Parameter]
) -> TrailerSteering[Any]:
    """The same without guard and lock: a law whose every step is checked.

    Raises:
        ValueError: one line, as `trailer_law`.
    """
    part = resolve("trailer_steering", name, TRAILER_STEERING)
    options = {option.name: option for option in law_options(part)}
    for key, value in parameters.items():
        if key not in options:
            raise ValueError(f"steering.{key}: {name} has no such parameter{nearest(key, options)}")
        options[key].check(value, f"steering.{key}")
    context = {_COMBINATION: combination} if _COMBINATION in inspect.signature(part).parameters else {}
    try:
        law: TrailerSteering[Any] = constructed(
            "trailer_steering", name, lambda: part(trailer, **context, **parameters)
        )
    except TypeError as error:
        shape = f"{part.__name__}(trailer, ...)"
        raise ValueError(f"trailer_steering = {name}: cannot be constructed as {shape}: {error}") from error
    return CheckedLaw(law, f"trailer_steering = {name}", len(trailer.steered_distances))
