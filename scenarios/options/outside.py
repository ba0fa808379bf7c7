"""Options of demands that come from outside: from a controller on a bench."""

from __future__ import annotations

from typing import Literal

from scenarios.options.base import FullPath, Options, option, quantity


class OutsideOptions(Options):
    """Demands from outside by ``--udp`` or ``--can``; the scenario's own law or driver stands in where they fail."""

    demands: Literal["none", "trailer", "driver", "both"] = option(
        "Parts that are steered from outside: the trailers' axles, the tractor by its driver, or both.", "none"
    )
    hold: float = quantity(
        0.1, "s", 0.0, 10.0, "Time that a demand holds when no new one comes; then the scenario's own part takes over."
    )
    wait: float = quantity(
        0.0, "s", 0.0, 10.0, "Longest time that the loop waits for the answer to the signals it has just sent."
    )
    record: FullPath | None = option(
        "CSV file of the demands that came in an earlier run, which are repeated; a run directory has one.", None
    )
