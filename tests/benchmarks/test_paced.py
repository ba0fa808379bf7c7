"""Deadlines of paced runs, for two cores that do nothing else: less than 1 % of the steps of 10 ms may end late."""

import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from scenarios.loop.channel import Pacer
from scenarios.loop.runner import run
from scenarios.options.scenario import load_scenario


@pytest.mark.parametrize("off_tracking", ["truth", "viso_ot"])
def test_a_roundabout_keeps_wall_time(benchmark: BenchmarkFixture, off_tracking: str) -> None:
    """Without cameras and with the default ones."""
    scenario = load_scenario("roundabout", (f"off_tracking={off_tracking}",))
    result = benchmark.pedantic(lambda: run(scenario, 1, pacer=Pacer(1.0)), rounds=1)
    assert result.paced is not None
    assert result.paced.misses_share < 0.01, result.paced
