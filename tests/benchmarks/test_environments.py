"""Environments: steps a second on one core, all of them with slip, surrogate, driver, rewards and info."""

import time

import gymnasium
import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture

import offtrack  # noqa: F401  # registers the environments
from vehicle.engine.compiler import compiler

pytestmark = pytest.mark.benchmark(timer=time.process_time)
with_compiler = pytest.mark.skipif(compiler() is None, reason="no C compiler here")


@pytest.mark.parametrize(
    ("engine", "n", "least"),
    [
        pytest.param("compiled", 1024, 150_000, marks=with_compiler),
        ("interpreted", 1024, 25_000),
        pytest.param("compiled", 1, 5_000, marks=with_compiler),
    ],
)
def test_trailers_are_stepped_fast_enough_to_learn_from(
    benchmark: BenchmarkFixture, engine: str, n: int, least: int
) -> None:
    """Environment steps of 20 ms a second, of one environment or of a vector."""
    name = "offtrack/TrailerSteering-v0"
    many = (
        gymnasium.make_vec(name, num_envs=n, engine=engine)
        if n > 1
        else gymnasium.make(name, engine=engine, disable_env_checker=True).unwrapped
    )
    many.reset(seed=1)
    action = np.random.default_rng(1).uniform(-0.1, 0.1, many.action_space.shape).astype(np.float32)
    benchmark.pedantic(many.step, (action,), rounds=20, iterations=5, warmup_rounds=1)
    assert benchmark.stats is not None
    assert n / benchmark.stats.stats.min >= least
