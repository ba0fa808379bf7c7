"""Hardware in the loop: signals out, demands in, by UDP and CAN; hold, fallback, record and replay."""

import json
import math
import socket
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from offtrack.exchange.bench.links import CanLink, LinkedBench, UdpLink
from offtrack.exchange.fmi_import.mapping import Signal
from scenarios.loop.bench import (
    Demands,
    Exchange,
    Link,
    Numbers,
    Sensed,
    Values,
    checked_message,
    driver_demands,
    record_text,
    recorded_demands,
    trailer_demands,
)
from scenarios.loop.runner import run
from scenarios.options.scenario import load_scenario
from scenarios.options.tables import OutsideOptions
from scenarios.results.trailer_result import RunResult
from sensors.messages import EgoState

TRAILER = trailer_demands("semitrailer", 2, is_last=True)
SHORT = ("off_tracking=truth", "reference_unit=false", "course.entry=20", "course.turn_deg=30", "course.exit=5")
SIGNALS = (Signal("speed", "m/s", ""), Signal("steer", "rad", ""), Signal("off_tracking", "m", ""))


class ScriptedBench:
    """A bench whose messages stand in a script: those that come at the k-th look."""

    name = "script"

    def __init__(self, *script: Sequence[Numbers | str]) -> None:
        self.script, self.signals = list(script), list[Mapping[str, float]]()

    def prepare(self, signals: Sequence[Signal], parts: Sequence[Demands]) -> None:
        pass

    def send(self, tick: int, values: Mapping[str, float]) -> None:
        self.signals.append(values)

    def receive(self, timeout: float) -> list[Numbers | str]:
        return list(self.script.pop(0)) if self.script else []

    def close(self) -> None:
        pass


class SilentBench:
    def __init__(self, link: Link) -> None:
        self.links = (link,)

    def prepare(self, parts: object, trailers: object, taken: object) -> None:
        pass

    def signals(self, tick: int, ego: EgoState, sensed: Sequence[Sensed]) -> dict[str, float]:
        return {}


def demand(angle: float, **more: float) -> Numbers:
    return {"steer_demand_1": angle, "steer_demand_2": -angle, **more}


def exchanged(bench: ScriptedBench, steps: int, **options: float) -> tuple[list[Any], Exchange]:
    """Demands that act in steps of 20 ms, and the exchange."""
    exchange = Exchange(OutsideOptions.model_validate(options), [TRAILER], SilentBench(bench))
    ego = EgoState(tick=0, x=0.0, y=0.0, psi=0.0, v_x=0.0, v_y=0.0, yaw_rate=0.0)
    return [exchange.step(20 * k, ego, ()).get("semitrailer") for k in range(steps)], exchange


def test_a_demand_holds_and_then_the_scenarios_own_law_takes_over() -> None:
    """It came at 20 ms and holds for 40 ms; from 80 ms on nothing comes from outside, nor before the first."""
    acting, exchange = exchanged(ScriptedBench([], [demand(0.1)]), 6, hold=0.04)
    assert acting == [None, (0.1, -0.1), (0.1, -0.1), (0.1, -0.1), None, None]
    report = exchange.report()
    assert (report.fresh_steps, report.held_steps, report.fallback_steps) == (1, 2, 3)
    assert report.longest_gap_s == pytest.approx(0.08)
    assert "lacked in 3 steps" in " ".join(report.warnings)
    assert report.warnings[0].startswith("demands came from outside by script")


def test_the_loop_waits_for_the_answer_to_its_own_signals() -> None:
    """The demand that answers an earlier tick comes first; the loop goes on looking until the right one is there."""
    late, right = demand(0.1, tick=0), demand(0.3, tick=20)
    bench = ScriptedBench([demand(0.0, tick=0)], [], [late], [], [right])
    acting, _ = exchanged(bench, 2, wait=5.0)
    assert acting == [(0.0, -0.0), (0.3, -0.3)]
    acting, exchange = exchanged(ScriptedBench([demand(0.1), demand(0.2)]), 1)  # a bench that is faster than the loop
    assert acting == [(0.2, -0.2)]
    assert exchange.report().received == 2


@pytest.mark.parametrize(
    ("message", "line"),
    [
        ({"steer_demand_1": 0.1}, "steer_demand_2 is missing"),
        ({"steer_demand_1": 0.1, "steer_demand_9": 0.1}, "unknown demand 'steer_demand_9'"),
        (demand(math.nan), "steer_demand_1 = nan must be a number within -1.571 to 1.571 rad"),
        (demand(2.0), "steer_demand_1 = 2.0 must be a number within"),
        ({"steer_demand_1": True, "steer_demand_2": 0.0}, "steer_demand_1 = True must be a number"),
        (demand(0.1, tick=0.5), "tick = 0.5 must be a whole number"),
        ({"tick": 20}, "has no demand"),
    ],
)
def test_a_wrong_message_is_refused_as_a_whole(message: Numbers, line: str) -> None:
    acting, exchange = exchanged(ScriptedBench([demand(0.1)], [message]), 2)
    assert acting == [(0.1, -0.1)] * 2
    report = exchange.report()
    assert (report.received, report.refused) == (1, 1)
    assert line in report.first_refusal


def test_a_driver_has_a_gear_of_its_own_accord() -> None:
    """Forward, if a message does not say; anything between the gears is refused."""
    given = {"steer_demand": 0.1, "acceleration_demand": -1.0}
    assert checked_message(given, [driver_demands()]).values == {"driver": (0.1, -1.0, 1.0)}
    with pytest.raises(ValueError, match="gear_demand = 0 must be 1 or -1"):
        checked_message({**given, "gear_demand": 0}, [driver_demands()])


def test_a_record_holds_every_demand_exactly(tmp_path: Path) -> None:
    """Numbers are written with all their digits; parts that did not come stay away."""
    parts = [TRAILER, driver_demands()]
    rows: list[tuple[int, Values]] = [
        (20, {"semitrailer": (0.1, 1.0 / 3.0)}),
        (60, {"driver": (-0.2, math.pi, 1.0), "semitrailer": (0.0, -0.0)}),
    ]
    (tmp_path / "demands.csv").write_text(record_text(parts, rows))
    record = recorded_demands(tmp_path / "demands.csv", parts)
    assert [record.get(tick, {}) for tick in (0, 20, 60)] == [{}, rows[0][1], rows[1][1]]


@pytest.fixture(scope="module")
def inside() -> RunResult:
    return run(load_scenario("roundabout", (*SHORT, "trailer_steering=none")), 1)


def test_signals_alone_change_nothing(inside: RunResult) -> None:
    bench = ScriptedBench()
    watched = run(load_scenario("roundabout", (*SHORT, "trailer_steering=none")), 1, bench=LinkedBench([bench]))
    assert watched.log == inside.log
    assert watched.outside is not None
    assert watched.outside.reproducible
    assert len(bench.signals) == watched.outside.sent == math.ceil(len(inside.log) / 2)  # every second row
    third = bench.signals[150]
    row = 300
    assert third["x"] == inside.log["x_tractor"][row]
    assert third["steer_trailer_1"] == inside.log["steer_trailer_1"][row]
    # the sensors' errors: 0.5 % of the speed and 20 mm/s of noise; 0.2 and 0.1 degrees of play (three times each)
    assert third["speed"] == pytest.approx(inside.log["v_x_tractor"][row], abs=0.1)
    assert third["steer"] == pytest.approx(inside.log["steer_tractor"][row], abs=0.012)


@pytest.fixture
def bench_socket() -> Iterator[socket.socket]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as bench:
        bench.bind(("127.0.0.1", 0))
        bench.settimeout(5.0)
        yield bench


def test_udp_datagrams_are_json_objects_with_numbers_by_name(bench_socket: socket.socket) -> None:
    """The bench answers where the signals come from; what is no message says why."""
    link = UdpLink(f"127.0.0.1:{bench_socket.getsockname()[1]}")
    link.send(40, {"speed": 2.5})
    content, sender = bench_socket.recvfrom(2000)
    assert json.loads(content) == {"offtrack": 1, "tick": 40, "speed": 2.5}
    for answer in (b'{"tick":40,"steer_demand_1":0.1}', b"\xff\x00", b"[1]", b'{"offtrack":2}', b"[" * 5000):
        bench_socket.sendto(answer, sender)
    found = [message for _ in range(4) for message in link.receive(0.05)]
    assert found[0] == {"tick": 40, "steer_demand_1": 0.1}
    assert found[1:] == ["is no JSON", "is no JSON object", "has the layout 2, not 1", "is no JSON"]
    assert link.receive(0.0) == []
    link.close()


def test_a_bench_that_is_not_there_yet_does_no_harm() -> None:
    """Nobody listens: loopback answers with an error, which is no message."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as unused:
        unused.bind(("127.0.0.1", 0))
        port = unused.getsockname()[1]
    link = UdpLink(f"127.0.0.1:{port}")
    for tick in (0, 20):
        link.send(tick, {"speed": 1.0})
        assert link.receive(0.0) == []
    link.close()


def dbc(tmp_path: Path, *fields: str, name: str = "my.dbc") -> str:
    """A DBC file with one message of these signals from the run, and one with the demands."""
    lines = ['VERSION ""', "", "BU_: A B", "", "BO_ 256 Signals: 8 A", *fields, "", "BO_ 257 Demands: 8 B"]
    lines += [
        f' SG_ steer_demand_{k} : {16 * k - 16}|16@1- (0.01,0) [-90|90] "deg" A' for k in (1, 2) if "lacks" not in name
    ]
    (tmp_path / name).write_text("\n".join(lines) + "\n")
    return str(tmp_path / name)


SPEED = ' SG_ speed : 0|8@1+ (0.5,0) [0|100] "km/h" B'


def test_a_can_bus_carries_signals_and_demands_in_the_units_of_its_file(tmp_path: Path) -> None:
    """36 km/h are 72 steps of 0.5; 500 km/h are sent as the limit. 5 degrees come as radians."""
    can, cantools = pytest.importorskip("can"), pytest.importorskip("cantools")
    file = dbc(tmp_path, SPEED)
    link = CanLink(f"dbc={file},channel=one")
    link.prepare(SIGNALS, [TRAILER])
    bus, database = can.Bus("one", interface="virtual"), cantools.database.load_file(file)
    for speed, raw in ((10.0, 72), (500.0 / 3.6, 200), (-1.0, 0)):
        link.send(0, {"speed": speed})
        assert bus.recv(1.0).data[0] == raw
    demands = database.get_message_by_name("Demands")
    data = demands.encode({"steer_demand_1": 5.0, "steer_demand_2": -2.5})
    for frame_id, content in ((257, data), (700, b"other"), (257, b"\x01")):
        bus.send(can.Message(arbitration_id=frame_id, data=content, is_extended_id=False))
    good, short = link.receive(0.1)
    assert good == {"steer_demand_1": pytest.approx(math.radians(5.0)), "steer_demand_2": pytest.approx(-0.04363323)}
    assert isinstance(short, str)
    assert short.startswith("is no Demands")
    link.close()
    bus.shutdown()


@pytest.mark.parametrize(
    ("fields", "line"),
    [
        ([SPEED.replace("(0.5", "(0")], "my.dbc: speed has the factor 0"),
        ([SPEED, ' SG_ spare : 8|8@1+ (0,0) [0|0] "" B'], "message Signals can not be sent"),
        ([SPEED, "", "BO_ 256 Again: 8 A", SPEED], "my.dbc: the messages Signals and Again have the same id"),
    ],
)
def test_a_can_bus_that_can_not_be_served_is_refused_at_once(fields: list[str], line: str, tmp_path: Path) -> None:
    pytest.importorskip("cantools")
    with pytest.raises(ValueError, match=line), closing(CanLink(f"dbc={dbc(tmp_path, *fields)},channel=one")) as link:
        link.prepare(SIGNALS, [TRAILER])


def test_the_shipped_dbc_file_fits_the_signals(inside: RunResult) -> None:
    """Every signal of the file is known, in its unit, and all demands are there."""
    pytest.importorskip("cantools")
    from offtrack.exchange.bench.links import signals_of

    link = CanLink("dbc=example,channel=two")
    signals = signals_of([trailer_demands("semitrailer", 3, is_last=True)], 2)
    link.prepare(signals, [trailer_demands("semitrailer", 3, is_last=True), driver_demands()])
    known = {signal.name for signal in signals}
    known |= {one.name for one in (*driver_demands().numbers, *trailer_demands("", 3, is_last=True).numbers)}
    assert {signal.name for message in link._messages for signal in message.signals} <= known
    link.close()


class BenchDriver(ScriptedBench):
    """A driver on the bench: curvature ahead, corrected by the errors of position and heading; keeps the speed."""

    def send(self, tick: int, values: Mapping[str, float]) -> None:
        super().send(tick, values)
        steer = 4.0 * values["curvature"] - 0.2 * values["lateral_error"] - 1.0 * values["heading_error"]
        acceleration = 0.5 * (values["set_speed"] - values["speed"])
        self.script.append([{"tick": tick, "steer_demand": steer, "acceleration_demand": acceleration}])


@pytest.mark.slow
def test_a_bench_drives_the_tractor() -> None:
    """It sees what a driver sees, and its demands are in the log; the scenario's own law steers the trailer."""
    bench = BenchDriver()
    settings = (*SHORT, "trailer_steering=command_steer", "outside.demands=driver", "outside.wait=1")
    result = run(load_scenario("roundabout", settings), 1, bench=LinkedBench([bench]))
    assert result.outcome == "completed"
    assert result.outside is not None
    assert result.outside.fallback_steps == 0
    assert 'record = "' in result.scenario_toml  # a run of it again repeats the demands
    errors = [abs(values["lateral_error"]) for values in bench.signals]
    assert max(errors) < 1.5  # without preview it meets the bend late, and finds back
    assert errors[-1] < 0.5 * max(errors)
    assert result.log["acceleration_command"][0] == pytest.approx(
        0.5 * (bench.signals[0]["set_speed"] - bench.signals[0]["speed"])
    )
    assert np.abs(result.log["steer_trailer_1_command"]).max() > 0.02
