"""Computing time of a step of the predictive controller: the whole law, an estimate every fifth step, on one core.

Each benchmark reports ``median_ms`` and ``p99_ms`` of the processor time of a step, as other programs may use the
machine too, and fails beyond the bars of a controller that runs every 20 ms. Run with ``make benchmarks``.
"""

import time
from dataclasses import replace

import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from controllers.trailer import Combination
from controllers.trailer_steering.mpc import trailer_model
from controllers.trailer_steering.mpc.law import Mpc
from scenarios.assembly.adapters import trailer_geometry
from tests.fmus.proxies import estimate, reading
from vehicle.combination.description import load_vehicle
from vehicle.engine.compiler import compiler
from vehicle.frames import FloatArray

VEHICLE = load_vehicle("uk_longer_semitrailer")
STEPS = 500
with_compiler = pytest.mark.skipif(compiler() is None, reason="no C compiler here")


def spent(law: Mpc) -> FloatArray:
    """Processor time of every step on a left-hand circle, 0.3 m beside the path [s]."""
    memory, angles, seconds = law.init(), np.zeros(2), []
    for k in range(STEPS):
        tick = 20 * k
        seen = estimate(tick // 100 * 100 - 100) if tick >= 100 else None
        begin = time.process_time()
        memory, command = law.step(memory, tick, seen, replace(reading(tick), angles=angles))
        seconds.append(time.process_time() - begin)
        angles = command.angles
    return np.array(seconds[10:])  # the first ones build what is built once


@pytest.mark.parametrize("engine", [pytest.param("compiled", marks=with_compiler), "interpreted"])
def test_step_in_real_time(benchmark: BenchmarkFixture, engine: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """25 ms at the median and 50 ms at the 99th percentile, with and without a compiler."""
    if engine == "interpreted":
        monkeypatch.setenv("OFFTRACK_COMPILER", "none")
    for built in (trailer_model._prediction, trailer_model._tyres):
        built.cache_clear()
    law = Mpc(trailer_geometry(VEHICLE, 1), combination=Combination(VEHICLE, 1))
    seconds = benchmark.pedantic(spent, (law,), rounds=1)
    median, slowest = 1e3 * np.quantile(seconds, [0.5, 0.99])
    benchmark.extra_info.update(median_ms=median, p99_ms=slowest)
    assert median <= 25.0
    assert slowest <= 50.0
    for built in (trailer_model._prediction, trailer_model._tyres):
        built.cache_clear()
