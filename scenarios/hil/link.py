"""Interface of the links to a bench."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol

from scenarios.fmi_import.mapping import Signal
from scenarios.hil.demands import Demands

Numbers = Mapping[str, object]  # of a message by name, not checked yet


class Link(Protocol):
    """A link that sends signals and receives demands."""

    @property
    def name(self) -> str:
        """Name in messages, such as "udp"."""

    def prepare(self, signals: Sequence[Signal], parts: Sequence[Demands]) -> None:
        """Learn which signals there are and which demands are taken.

        Raises:
            ValueError: one line, if the link can't carry the demands.
        """

    def send(self, tick: int, values: Mapping[str, float]) -> None:
        """Send signals [SI]; never waits."""

    def receive(self, timeout: float) -> list[Numbers | str]:
        """All messages that have come, oldest first; a text is the reason why one can't be read.

        Waits for the first one, at most for the timeout [s].
        """

    def close(self) -> None:
        """Close the link; closing twice does no harm."""
