"""offtrack's own laws on a bench, behind UDP and CAN, against the same laws inside the loop.

UDP goes to a process of its own over loopback, CAN to a thread over python-can's virtual bus.
"""

import subprocess
import sys
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, contextmanager
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from offtrack.exchange.bench.links import CanLink, LinkedBench, UdpLink
from offtrack.reports.run_files import write_run
from scenarios.loop.channel import Pacer
from scenarios.loop.runner import run
from scenarios.options.scenario import load_scenario
from scenarios.results.trailer_result import RunResult
from tests.bench_controller import Controller

BENCH = Path(__file__).parents[1] / "bench_controller.py"
EXACT = ("off_tracking=truth",)
OUTSIDE = (*EXACT, "trailer_steering=none", "outside.demands=trailer")


def follow_errors(result: RunResult) -> tuple[float, float]:
    """RMS and maximum of the follow point's distance from the hitch's path [m]."""
    true = result.log["off_tracking_true"]
    return float(np.sqrt(np.nanmean(true**2))), float(np.nanmax(np.abs(true)))


@contextmanager
def bench(law: str, *more: str) -> Iterator[UdpLink]:
    """A link to a controller in a process of its own."""
    command = [sys.executable, str(BENCH), law, "0", *more]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        link = UdpLink(f"127.0.0.1:{int(process.stdout.readline())}")
        try:
            yield link
        finally:
            link.close()
            process.kill()


@pytest.fixture(scope="module")
def inside() -> tuple[float, float]:
    result = run(load_scenario("roundabout", EXACT), 1)
    assert result.outcome == "completed"
    return follow_errors(result)


def test_a_law_behind_udp_in_step_is_the_law_inside(inside: tuple[float, float], tmp_path: Path) -> None:
    """The loop waits for every answer: only the path's points, a metre apart, are coarser, which is worth 1 mm.

    The run's directory then repeats it without the bench, bitwise.
    """
    with bench("path_preview") as link:
        result = run(load_scenario("roundabout", (*OUTSIDE, "outside.wait=5")), 1, bench=LinkedBench([link]))
    assert result.outcome == "completed"
    assert result.outside is not None
    assert (result.outside.held_steps, result.outside.fallback_steps, result.outside.refused) == (0, 0, 0)
    np.testing.assert_allclose(follow_errors(result), inside, atol=1e-3)
    write_run(result, tmp_path / "run", video=False)
    assert run(load_scenario(str(tmp_path / "run/scenario.toml")), 1).log == result.log


def test_a_law_behind_udp_in_wall_time_steers_one_step_later(inside: tuple[float, float]) -> None:
    """A demand acts 20 ms after its signals; at 10 km/h that is 6 cm of path. Some come late on a busy machine."""
    with bench("path_preview") as link:
        result = run(load_scenario("roundabout", OUTSIDE), 1, bench=LinkedBench([link]), pacer=Pacer(1.0))
    assert result.outcome == "completed"
    assert result.outside is not None
    assert result.outside.fresh_steps > 0.5 * result.outside.sent
    np.testing.assert_allclose(follow_errors(result), inside, atol=0.01)


def test_lost_answers_are_bridged_by_the_last_demand(inside: tuple[float, float]) -> None:
    with bench("path_preview", "3") as link:
        result = run(load_scenario("roundabout", (*OUTSIDE, "outside.wait=0.02")), 1, bench=LinkedBench([link]))
    assert result.outside is not None
    assert result.outside.held_steps == pytest.approx(result.outside.sent / 3, rel=0.1)
    assert result.outside.fallback_steps <= 2
    np.testing.assert_allclose(follow_errors(result), inside, atol=0.01)


def test_a_law_behind_can_is_the_law_inside() -> None:
    """The shipped DBC file has steps of 0.1 mrad and 2 mm/s: a law without path is the same to millimetres."""
    can, cantools = pytest.importorskip("can"), pytest.importorskip("cantools")
    database = cantools.database.load_file(str(files("offtrack.exchange.bench") / "example.dbc"))
    demand = database.get_message_by_name("TrailerDemand")
    ended = threading.Event()

    def control(bus: Any) -> None:
        controller, signals, tick = Controller("command_steer"), dict[str, float](), 0
        while not ended.is_set():
            if (frame := bus.recv(0.1)) is None:
                continue
            message = database.get_message_by_frame_id(frame.arbitration_id)
            signals |= message.decode(frame.data)
            if message.name == "OfftrackTractor":  # the last one of a step
                data = demand.encode({one.name: 0.0 for one in demand.signals} | controller.demands(tick, signals))
                tick += 20
                bus.send(can.Message(arbitration_id=demand.frame_id, data=data, is_extended_id=True))

    scenario = load_scenario("roundabout", (*OUTSIDE, "outside.wait=5"))
    with (
        can.Bus("bench", interface="virtual") as bus,
        ThreadPoolExecutor(1) as bench,
        closing(CanLink("dbc=example,channel=bench")) as link,
    ):
        controlling = bench.submit(control, bus)
        try:
            result = run(scenario, 1, bench=LinkedBench([link]))
        finally:
            ended.set()
        controlling.result()
    inside = run(load_scenario("roundabout", (*EXACT, "trailer_steering=command_steer")), 1)
    assert result.outside is not None
    assert result.outside.fresh_steps == result.outside.sent
    np.testing.assert_allclose(follow_errors(result), follow_errors(inside), atol=3e-3)
