"""A run watched in a browser while it goes on: snapshots between steps, and a web server on this machine alone.

The link's token keeps other users and pages of other sites out; requests under another host's name are refused too.

A snapshot is taken between two steps, only while somebody watches, and so seldom that the run loses little time by it.
It reads the run and changes nothing, so the results are those of a run that nobody watches.
"""

import dataclasses
import json
import secrets
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any, Final
from urllib.parse import parse_qs, urlsplit

from offtrack.reports.page import Page, Player, Section
from offtrack.reports.player.encoding import EncodedPlayback, encoded, live_picture
from offtrack.reports.player.playback import Picture, Playback
from offtrack.reports.run_files import KINDS
from scenarios.results.run_summary import Result

_SHORTEST: Final = 1.0  # time between snapshots [s]
_SHARE: Final = 20.0  # the run goes on for this multiple of what a snapshot costs it
_UNDER_WAY: Final = 3  # newest pictures, whose estimates may not have arrived yet
_WATCHED: Final = 5.0  # a page that has not asked for so long is gone [s]


class Watcher:
    """The newest snapshot of a run, shared by the run's thread and those of the server."""

    def __init__(self, title: str) -> None:
        self.title = title
        self.finished = ""  # what came of the run, once it is over
        self._changed = threading.Condition()
        self._number = 0  # of the newest snapshot
        self._playback: Playback | None = None
        self._encoded: tuple[int, EncodedPlayback] | None = None
        self._pictures: list[dict[str, Any]] = []
        self._asked = self._next = -float("inf")

    def step(self, result: Callable[[], Result]) -> None:
        """Take a snapshot if one is due; the run calls this between two steps."""
        now = time.monotonic()
        if now < self._next or now - self._asked > _WATCHED:
            return
        try:
            self.show(result())
        except Exception as error:  # of a part or a signal that can't be shown: the run itself goes on
            self._next = float("inf")
            self.finish(f"the run goes on, but can not be shown: {type(error).__name__}: {error}")
            return
        self._next = time.monotonic() + max(_SHORTEST, _SHARE * (time.monotonic() - now))

    def show(self, result: Result) -> None:
        """Show the run as it is in this result; too short ones are passed over."""
        if len(result.log) < 2:
            return
        playback = KINDS[result.kind].playback(result)
        with self._changed:
            self._playback, self._number = playback, self._number + 1
            self._changed.notify_all()

    def finish(self, what: str) -> None:
        """Tell those who watch that the run is over, and what came of it."""
        with self._changed:
            self.finished = what
            self._changed.notify_all()

    def asked(self) -> None:
        """Note that somebody watches."""
        self._asked = time.monotonic()

    def wait(self, seen: int, timeout: float) -> int:
        """Wait for a snapshot after ``seen``, or for the end of the run, and return the newest one's number."""
        with self._changed:
            self._changed.wait_for(lambda: self._number > seen or bool(self.finished), timeout)
            return self._number

    def snapshot(self) -> EncodedPlayback | None:
        """The newest snapshot without its pictures; None before the first one."""
        with self._changed:
            playback, number = self._playback, self._number
            if playback is None:
                return None
            if self._encoded is None or self._encoded[0] != number:
                bare = [dataclasses.replace(run, pictures=()) for run in playback.runs]
                self._encoded = number, encoded(dataclasses.replace(playback, runs=tuple(bare)))
            return self._encoded[1]

    def pictures(self, have: int) -> list[dict[str, Any]]:
        """The pictures after the first ``have`` ones, ready for JSON."""
        with self._changed:
            pictures: list[Picture] = [] if self._playback is None else list(self._playback.runs[0].pictures)
            if not self.finished:
                pictures = pictures[:-_UNDER_WAY]
            for picture in pictures[len(self._pictures) :]:
                self._pictures.append(live_picture(picture))
            return self._pictures[max(0, have) :]


_HOST: Final = "127.0.0.1"
_FIRST: Final = 300.0  # longest wait for the first snapshot [s]
_BEAT: Final = 2.0  # an event at least so often, so that a page that is gone is noticed [s]
_LAST: Final = 3.0  # time in which pages take the last snapshot [s]


class _Server(ThreadingHTTPServer):
    daemon_threads = True  # a page that stays open does not keep the command from ending

    def __init__(self, port: int, watcher: Watcher) -> None:
        super().__init__((_HOST, port), _Handler)
        self.watcher = watcher
        self.token = secrets.token_urlsafe(16)
        self.streams = 0
        self.closing = threading.Event()

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Say nothing: a page that was closed is no error of the run."""


class _Handler(BaseHTTPRequestHandler):
    server: _Server

    def do_GET(self) -> None:
        """Answer with the page, the newest snapshot, or the stream of events."""
        address = urlsplit(self.path)
        parts = address.path.strip("/").split("/")
        host = (self.headers.get("Host") or "").partition(":")[0]
        if host not in (_HOST, "localhost") or not secrets.compare_digest(parts[0], self.server.token):
            self._answer(403, "text/plain", "use the whole link that offtrack printed")
        elif parts[1:] == []:
            self._page()
        elif parts[1:] == ["playback"]:
            self._playback(parse_qs(address.query))
        elif parts[1:] == ["events"]:
            self._events()
        else:
            self._answer(404, "text/plain", "no such page")

    def log_message(self, format: str, *args: Any) -> None:
        """Write nothing on the terminal, where the progress stands."""

    def _answer(self, status: int, kind: str, text: str) -> None:
        body = text.encode()
        self.send_response(status)
        self.send_header("Content-Type", f"{kind}; charset=utf-8")
        self.send_header("Content-Length", str(len(body)))
        self.send_header("Cache-Control", "no-store")
        self.end_headers()
        self.wfile.write(body)

    def _page(self) -> None:
        watcher = self.server.watcher
        watcher.asked()
        for _ in range(int(_FIRST / _BEAT)):
            if watcher.wait(0, _BEAT) or watcher.finished:
                break
            watcher.asked()
        snapshot = watcher.snapshot()
        if snapshot is None:
            self._answer(
                503, "text/plain", watcher.finished or "the run has not begun to drive yet: load this page again"
            )
            return
        page = Page(
            title=watcher.title,
            subtitle="This run goes on. The page shows it as far as it has come.",
            sections=[Section("Playback", content=[Player(snapshot, live=f"/{self.server.token}")])],
        )
        self._answer(200, "text/html", page.html())

    def _playback(self, query: dict[str, list[str]]) -> None:
        watcher = self.server.watcher
        watcher.asked()
        snapshot = watcher.snapshot()
        have = query.get("have", ["0"])[0]
        if snapshot is None or not have.isdecimal():
            self._answer(404, "text/plain", "there is no snapshot yet")
            return
        content = {
            "table": snapshot.table,
            "numbers": snapshot.numbers,
            "pictures": watcher.pictures(int(have)),
        }
        self._answer(200, "application/json", json.dumps(content))

    def _events(self) -> None:
        self.send_response(200)
        self.send_header("Content-Type", "text/event-stream")
        self.send_header("Cache-Control", "no-store")
        self.end_headers()
        watcher, seen = self.server.watcher, 0
        self.server.streams += 1
        try:
            while True:
                watcher.asked()
                number = watcher.wait(seen, _BEAT)
                self._send("snapshot" if number > seen else "beat", str(number))
                if watcher.finished and number == seen:
                    self._send("finished", watcher.finished)
                    return
                seen = number
        finally:
            self.server.streams -= 1

    def _send(self, event: str, data: str) -> None:
        self.wfile.write(f"event: {event}\ndata: {' '.join(data.split())}\n\n".encode())
        self.wfile.flush()


@contextmanager
def watched(watcher: Watcher, port: int = 0) -> Iterator[str]:
    """Serve a watcher's snapshots and yield the link; ``port`` 0 is any free one.

    At the end, pages that are open get the last snapshot before the server stops.

    Raises:
        ValueError: one line, if the port is not free.
    """
    try:
        server = _Server(port, watcher)
    except OSError as error:
        raise ValueError(f"--watch-port {port}: {error.strerror or error}; choose another, or 0 for any") from None
    thread = threading.Thread(target=server.serve_forever, name="watch", daemon=True)
    thread.start()
    try:
        yield f"http://{_HOST}:{server.server_address[1]}/{server.token}/"
    finally:
        if not watcher.finished:
            watcher.finish("ended early")
        for _ in range(int(_LAST / 0.05)):
            if not server.streams:
                break
            threading.Event().wait(0.05)
        server.shutdown()
        server.server_close()
