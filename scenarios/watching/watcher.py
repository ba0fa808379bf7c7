"""Snapshots of a run that goes on, for those who watch it.

A snapshot is taken between two steps, only while somebody watches, and so seldom that the run loses little time by it.
It reads the run and changes nothing, so the results are those of a run that nobody watches.
"""

from __future__ import annotations

import dataclasses
import threading
import time
from collections.abc import Callable
from typing import Any, Final

from scenarios.player.encoding import EncodedPlayback, encoded
from scenarios.player.pictures import live_picture
from scenarios.player.playback import Picture, Playback
from scenarios.player.rover import rover_playback
from scenarios.player.trailer import trailer_playback
from scenarios.results.rover import RoverResult
from scenarios.results.run_result import RunResult

Result = RunResult | RoverResult
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
        playback = rover_playback(result) if isinstance(result, RoverResult) else trailer_playback(result)
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
