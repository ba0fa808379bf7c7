"""A steered trailer of a running loop, step by step: what it receives, who steers it, and what is told of that."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np

from controllers.trailer_steering.actuators import ActuatorFinding
from controllers.trailer_steering.safeguarded import SafeguardedCommand
from scenarios.assembly.trailer_run import Assembly, assemble
from scenarios.loop.channel import InLine, Stopwatch
from scenarios.loop.trailer_session import SteeredTrailer
from scenarios.options.scenario import load_scenario
from tests.trailers import estimate


def assembled(*settings: str) -> Assembly:
    return assemble(load_scenario("roundabout", ("off_tracking=truth", *settings)), 1)


def test_estimates_are_kept_from_the_law_alone() -> None:
    known = {}
    for faults in ("none", "estimate_loss:1", "estimate_delay:0.1"):
        trailer = SteeredTrailer(assembled(f"faults={faults}").trailers[-1], InLine(), Stopwatch())
        trailer.channel.delivered.append(estimate(0))
        for tick in (0, 90, 100):
            trailer.receive(tick)
            known[faults, tick] = trailer.off_tracking is not None
        assert len(list(trailer.estimates)) == 1
        trailer.off_tracking = None
        trailer.receive(300)
        assert trailer.off_tracking is None  # nothing is received twice
    assert [known["none", tick] for tick in (0, 90, 100)] == [True, True, True]
    assert [known["estimate_loss:1", tick] for tick in (0, 90, 100)] == [False, False, False]
    assert [known["estimate_delay:0.1", tick] for tick in (0, 90, 100)] == [False, False, True]


def test_handovers_are_noted_and_a_bench_that_steers_ends_the_judgement_of_axles() -> None:
    """What it demands goes to the axles when it is new; what they do is then no answer to the law."""

    def step(memory: None, tick: int, *_: object) -> tuple[None, SafeguardedCommand]:
        found = (ActuatorFinding(20, (2,), "stuck"),)
        return None, SafeguardedCommand(angles=np.zeros(2), by_fallback=40 <= tick <= 60, actuator_findings=found)

    parts, law = assembled(), cast(Any, SimpleNamespace(init=lambda: None, step=step))
    trailer = SteeredTrailer(replace(parts.trailers[-1], law=law), InLine(), Stopwatch())
    truth = parts.plant.observe(parts.plant.initial_state(parts.course.start, 5.0), 0)
    for tick in range(0, 140, 20):
        trailer.control(replace(truth, tick=tick))
    assert trailer.handovers == [(40, True), (80, False)]
    assert [finding.kind for finding in trailer.actuator_findings] == ["stuck"]
    trailer.obey(np.full(2, 0.1))
    assert trailer.actuator_findings == ()
    demands = [trailer.actuate(truth, is_new=is_new).tolist() for is_new in (False, True, False)]
    assert demands == [[0.0, 0.0], [0.1, 0.1], [0.1, 0.1]]
