"""A run that is watched goes on as if nobody watched, and shows itself to those alone who have the link."""

import dataclasses
import http.client
import json
import socket
import threading
from typing import Any
from urllib.parse import urlsplit

import pytest

from offtrack.reports.watching import Watcher, watched
from scenarios.loop.runner import run
from scenarios.options.scenario import Scenario, load_any_scenario
from scenarios.results.log import Log
from scenarios.results.trailer_result import RunResult
from tests.browser import Opened


def so_far(result: RunResult, share: float) -> RunResult:
    rows = int(share * len(result.log))
    log = Log(result.log.signals, result.log.rows[:rows])
    frames = tuple(frame for frame in result.frames if frame.tick <= log["tick"][-1])
    return dataclasses.replace(result, log=log, frames=frames)


def answer(link: str, path: str = "", host: str | None = None) -> tuple[int, str]:
    address = urlsplit(link)
    connection = http.client.HTTPConnection(address.hostname or "", address.port, timeout=20)
    connection.request(
        "GET", (address.path if not path.startswith("/") else "") + path, headers={"Host": host} if host else {}
    )
    response = connection.getresponse()
    return response.status, response.read().decode()


def test_only_the_whole_link_on_this_machine_is_answered(camera_run: RunResult) -> None:
    watcher = Watcher("a run")
    watcher.show(so_far(camera_run, 0.3))
    with watched(watcher) as link:
        assert answer(link)[0] == 200
        assert answer(link, "/")[0] == 403
        assert answer(link, "/wrong-token/playback")[0] == 403
        assert answer(link, host="evil.example")[0] == 403
        assert answer(link, "passwords")[0] == 404
        address = urlsplit(link)
        assert address.hostname == "127.0.0.1"
        with socket.socket() as other:  # bound to loopback alone
            other.settimeout(0.5)
            assert other.connect_ex((_own_address(), address.port or 0)) != 0 or _own_address() == "127.0.0.1"


def _own_address() -> str:
    try:
        return socket.gethostbyname(socket.gethostname())
    except OSError:
        return "127.0.0.1"


def test_a_snapshot_holds_the_run_so_far_and_only_new_pictures(camera_run: RunResult) -> None:
    watcher = Watcher("a run")
    with watched(watcher) as link:
        assert answer(link, "playback")[0] == 404
        watcher.show(so_far(camera_run, 0.3))
        first = json.loads(answer(link, "playback?have=0")[1])
        watcher.show(so_far(camera_run, 0.6))
        second = json.loads(answer(link, f"playback?have={len(first['pictures'])}")[1])
        rows = [json.loads(one["table"])["runs"][0]["rows"] for one in (first, second)]
        assert rows == [int(share * len(camera_run.log)) for share in (0.3, 0.6)]
        times = [picture["time"] for picture in (*first["pictures"], *second["pictures"])]
        assert times == [1e-3 * frame.tick for frame in camera_run.frames[: len(times)]]
        assert answer(link, "playback?have=x")[0] == 404


@pytest.mark.slow
def test_a_page_follows_the_run_to_its_end(browser: Any, camera_run: RunResult) -> None:
    watcher = Watcher("a run")
    watcher.show(so_far(camera_run, 0.3))
    with watched(watcher) as link:
        page = browser.new_page()
        opened = Opened(page)
        page.goto(link)
        page.wait_for_selector("#player[data-ready]", state="attached", timeout=20_000)
        for share in (0.6, 1.0):
            part = so_far(camera_run, share)
            watcher.show(part)
            page.wait_for_function(f"Math.abs(player.end - {part.log['time'][-1]}) < 0.02", timeout=10_000)
            assert opened.value("player.t") == opened.value("player.end")
        watcher.finish("completed")
        page.wait_for_function("player.part('note').textContent.includes('The run is over: completed')", timeout=10_000)
        assert opened.messages == []
        page.close()


@pytest.mark.slow
def test_a_watched_run_is_bitwise_the_same_and_a_page_that_goes_away_does_not_matter() -> None:
    scenario = load_any_scenario("turn-90", ["off_tracking=truth", "course.turn_deg=10", "speed_kmh=15"])
    assert isinstance(scenario, Scenario)
    alone = run(scenario, 1)
    watcher = Watcher("a run")
    shown = []
    show = watcher.show

    def counted(result: Any) -> None:
        shown.append(len(result.log))
        show(result)

    watcher.show = counted  # type: ignore[method-assign]
    with watched(watcher) as link:

        def read_a_little() -> None:
            address = urlsplit(link)
            with socket.create_connection((address.hostname, address.port)) as page:
                page.sendall(f"GET {address.path}events HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n".encode())
                page.recv(100)

        thread = threading.Thread(target=read_a_little)
        thread.start()
        seen = run(scenario, 1, watch=[watcher.step])
        thread.join()
        watcher.finish(seen.outcome)
    assert shown
    assert seen.log == alone.log


def test_a_result_that_can_not_be_shown_does_not_end_the_run(camera_run: RunResult) -> None:
    watcher = Watcher("a run")
    watcher.asked()
    watcher.step(lambda: dataclasses.replace(camera_run, units=()))
    assert "can not be shown" in watcher.finished
