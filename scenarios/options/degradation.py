"""What happens when the off-tracking is not known well enough, as a scenario file describes it."""

from __future__ import annotations

from typing import Any, Final

from controllers.trailer_steering.fallback import FallbackName
from controllers.trailer_steering.guard import LIMITS, Degradation
from scenarios.options.base import Options, quantity

_DEFAULT: Final = Degradation()


def _limited(name: str) -> Any:
    low, high, unit = LIMITS[name]
    return quantity(getattr(_DEFAULT, name), unit, ge=low, le=high)


class DegradationOptions(Options):
    """When an estimate is passed over, how long its last good one is steered by, and what by after that."""

    hold: float = _limited("hold")  # by the last good estimate, and for a quarter of the follow distance at most
    fade_rate: float = _limited("fade_rate")  # at which a change of hands begins; it quickens
    max_age: float = _limited("max_age")  # of an estimate when it arrives
    max_std: float = _limited("max_std")  # of a degraded one
    max_jump: float = _limited("max_jump")  # of an estimate beside what is expected
    recovery: float = _limited("recovery")  # good ones for so long, and they are relied on again
    fallback: FallbackName = _DEFAULT.fallback  # or straight; command steer is whole to 30 km/h and gone at 50 km/h

    def degradation(self) -> Degradation:
        """In the words of the controllers."""
        return Degradation(**self.model_dump())
