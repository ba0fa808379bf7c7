"""A trailer steering law by its name, given its trailer, its parameters and, if it asks, the whole combination."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from typing import Any

from controllers.trailer import Combination, TrailerGeometry, TrailerSteering
from controllers.trailer_steering.guard import Degradation, Guarded
from controllers.trailer_steering.reverse_lock import ReverseLock
from scenarios.catalogue import TRAILER_STEERING, resolve
from vehicle.parameter_file import nearest

_COMBINATION = "combination"  # the keyword by which a law asks for it


def trailer_law(
    name: str,
    trailer: TrailerGeometry,
    combination: Combination,
    parameters: Mapping[str, bool | int | float | str],
    degradation: Degradation | None = None,
) -> TrailerSteering[Any]:
    """The law of that name, a known one or ``package.module:Name``, for the trailer.

    It is guarded against bad estimates, by default as `Degradation` says, unless its class has
    ``uses_off_tracking = False``; backwards the axles are locked straight.

    Raises:
        ValueError: one line, if there is no such law, it has no such parameter, or it can not be constructed.
    """
    part = resolve("trailer_steering", name, TRAILER_STEERING)
    keywords = [p.name for p in inspect.signature(part).parameters.values() if p.kind is not p.VAR_KEYWORD][1:]
    known = [keyword for keyword in keywords if keyword != _COMBINATION]
    for parameter in parameters:
        if parameter not in known:
            raise ValueError(f"steering.{parameter}: {name} has no such parameter{nearest(parameter, known)}")
    told: dict[str, Any] = {_COMBINATION: combination} if _COMBINATION in keywords else {}
    try:
        law: TrailerSteering[Any] = part(trailer, **told, **parameters)
    except TypeError as error:
        shape = f"{part.__name__}(trailer, ...)"
        raise ValueError(f"trailer_steering = {name}: can not be constructed as {shape}: {error}") from error
    if not trailer.steered_distances:
        return law
    if getattr(part, "uses_off_tracking", True):
        law = Guarded(law, trailer, combination, degradation or Degradation())
    return ReverseLock(law, trailer)
