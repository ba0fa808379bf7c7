"""Options of the degradation: limits of usable off-tracking estimates, and the fallback."""

from __future__ import annotations

from typing import Any, Final

from controllers.trailer_steering.fallback import FallbackName
from controllers.trailer_steering.guard import LIMITS, Degradation
from scenarios.options.base import Options, option, quantity

_DEFAULT: Final = Degradation()


def _limited(name: str, meaning: str) -> Any:
    low, high, unit = LIMITS[name]
    return quantity(getattr(_DEFAULT, name), unit, low, high, meaning)


class DegradationOptions(Options):
    """Limits of usable estimates, and the fallback law."""

    hold: float = _limited(
        "hold", "Time for which the last good estimate is used; limited to a quarter of the follow distance."
    )
    fade_rate: float = _limited("fade_rate", "Initial rate of the change-over between laws.")
    max_age: float = _limited("max_age", "Largest accepted age of an estimate on arrival.")
    max_std: float = _limited("max_std", "Largest accepted standard deviation of a degraded estimate.")
    max_jump: float = _limited("max_jump", "Largest accepted difference of an estimate from the prediction.")
    recovery: float = _limited("recovery", "Duration of good estimates after which they are used again.")
    fallback: FallbackName = option(
        "Law without usable estimates; all but straight fade out between 30 and 50 km/h.", _DEFAULT.fallback
    )

    def degradation(self) -> Degradation:
        """The controllers' data of these options."""
        return Degradation(**self.model_dump())
