"""Cases drawn by Hypothesis: it generates them, and children try them several at a time."""

from typing import TypeVar

import hypothesis
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

T = TypeVar("T")


_AT_ONCE = 6  # examples of one call: later ones resemble earlier ones, and the first one is the simplest


def drawn(strategy: st.SearchStrategy[T], count: int, seed: int) -> list[T]:
    """``count`` examples; for the same seed the same ones."""
    examples: list[T] = []
    while len(examples) < count:
        examples += _some(strategy, seed)[1:]
        seed += 1_000_003
    return examples[:count]


def _some(strategy: st.SearchStrategy[T], seed: int) -> list[T]:
    examples: list[T] = []

    @hypothesis.seed(seed)
    @settings(
        max_examples=_AT_ONCE,
        database=None,
        deadline=None,
        phases=[Phase.generate],
        suppress_health_check=list(HealthCheck),
    )
    @given(strategy)
    def keep(example: T) -> None:
        examples.append(example)

    keep()
    return examples
