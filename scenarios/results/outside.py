"""What came from outside in a run."""

from __future__ import annotations

from dataclasses import dataclass

from scenarios.results.numbers import Numbers, number


@dataclass(frozen=True, slots=True, kw_only=True)
class Outside:
    """Signals sent and demands received. Steps are counted once for every part that is steered from outside."""

    source: str  # "udp", "can", "udp, can", "record"; empty: no demands are taken
    sent: int  # signals, once a step of control
    received: int  # messages with demands
    refused: int  # messages that can't be read or that break a limit
    first_refusal: str  # why, of the first of them; empty: there is none
    fresh_steps: int  # in which a demand came
    held_steps: int  # in which none came, and the last one held
    fallback_steps: int  # in which it was too old, or there was none yet
    longest_gap_s: float  # between two demands of a part [s]
    record: str  # the demands as CSV; empty: none are taken, or they came from a record

    @property
    def reproducible(self) -> bool:
        """True if scenario and seed decide the results."""
        return self.source in ("", "record")

    @property
    def warnings(self) -> tuple[str, ...]:
        """Lines about demands that came from outside, that failed, and that were refused."""
        lines = []
        if not self.reproducible:
            lines.append(
                f"demands came from outside by {self.source}: another run has others; scenario.toml of this run's "
                "directory repeats those that came, bitwise"
            )
        if self.source and self.fallback_steps:
            lines.append(f"demands from outside lacked in {self.fallback_steps} steps: the scenario's own part acted")
        if self.refused:
            lines.append(f"{self.refused} messages from outside were refused; the first one {self.first_refusal}")
        return tuple(lines)

    def numbers(self) -> Numbers:
        """The group ``outside`` of a summary."""
        return {
            "reproducible": self.reproducible,
            "signals_sent": self.sent,
            "demands_received": self.received,
            "messages_refused": self.refused,
            "fresh_steps": self.fresh_steps,
            "held_steps": self.held_steps,
            "fallback_steps": self.fallback_steps,
            "longest_gap_s": number(self.longest_gap_s),
        }
