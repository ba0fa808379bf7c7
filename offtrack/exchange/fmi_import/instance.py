"""An FMU in a run, in a process of its own: steps with a time limit, states, and errors of one line."""

import copy
import json
import math
import os
import select
import signal
import struct
import subprocess
import sys
import tempfile
import time
import weakref
from collections.abc import Mapping
from contextlib import ExitStack, suppress
from typing import IO, Any, Final

from offtrack.exchange.fmi_import import host
from offtrack.exchange.fmi_import.fmu_file import FmuFile, Variable
from offtrack.exchange.fmi_import.mapping import FmuMap
from vehicle.clock import TICK
from vehicle.foundation.plant_like import EndedError, KilledError
from vehicle.foundation.temporary import temporary_folder
from vehicle.foundation.user_file import shown

_START: Final = 30.0  # a large library may take long to load [s]
_OWN_START: Final = 120.0  # an FMU of offtrack may open cameras [s]
_END: Final = 2.0  # for an orderly end [s]
_PIECE: Final = 65_536  # of an answer: mostly all of it [bytes]
_TAIL: Final = 2_000  # of what an FMU printed that is searched for its last line [bytes]


class FmuError(EndedError):
    """Failure of an FMU: one line with its file, the time, and its own last words."""


class FmuKilledError(FmuError, KilledError):
    """The process of an FMU has died, or does not return."""


class _SigkillError(FmuKilledError):
    """The process was ended by SIGKILL, as by the system for lack of memory."""


class FmuInstance:
    """An FMU with its map, in a process of its own; copied with its state where it allows that.

    Time is its own, from 0 at the first call. A step takes the inputs of its beginning and gives the outputs of its
    end.
    """

    def __init__(self, fmu: FmuFile, links: FmuMap, parameters: Mapping[str, float | str]) -> None:
        """Create the instance.

        Args:
            fmu: the file.
            links: its map.
            parameters: start values that stand above those of the map, by name.

        Raises:
            ValueError: one line, if it can't be started.
        """
        self.fmu, self._map, self._given = fmu, links, {**links.parameters, **parameters}
        self._step = struct.Struct(f"=c{2 + len(links.inputs)}d")
        self._values = struct.Struct(f"={len(links.outputs)}d")
        self.ticks = 0  # its own time
        try:
            try:
                self._open()
            except _SigkillError:  # once, perhaps; a crash or a stall is the FMU's own
                self._open()
        except FmuError as error:
            raise ValueError(str(error)) from None

    def _open(self) -> None:
        """Start the process."""
        with ExitStack() as cleanup:
            self._folder = cleanup.enter_context(temporary_folder())
            self.fmu.unpack(self._folder)
            kept = cleanup.pop_all()
        self._log: IO[bytes] = tempfile.TemporaryFile()  # noqa: SIM115 -- closed with the process
        self._process = subprocess.Popen(
            [sys.executable, "-m", "offtrack.exchange.fmi_import.host"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._log,
            bufsize=0,
            start_new_session=True,  # Ctrl-C is for offtrack, which ends the process itself
            env={
                "OFFTRACK_PYTHON": sys.executable,
                **os.environ,
                "PYTHONPATH": os.pathsep.join(dict.fromkeys(filter(None, sys.path))),
            },
        )
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._requests, self._answers = self._process.stdin, self._process.stdout
        self._poll = select.poll()
        self._poll.register(self._answers, select.POLLIN | select.POLLHUP)
        self._end = weakref.finalize(self, _ended, self._process, kept, self._log)
        limit = _OWN_START if self.fmu.tool == "offtrack" else _START
        self._ask(json.dumps(self._start()).encode() + b"\n", "cannot be started", limit)

    def _start(self) -> dict[str, object]:
        variables = self.fmu.variables
        return {
            "version": self.fmu.version,
            "token": self.fmu.token,
            "identifier": self.fmu.identifier,
            "folder": str(self._folder),
            "inputs": [self._place(link.variable) for link in self._map.inputs],
            "outputs": [self._place(link.variable) for link in self._map.outputs],
            "parameters": [(*self._place(variables[name]), value) for name, value in self._given.items()],
        }

    def _place(self, variable: Variable) -> tuple[str, int]:
        """Kind of the functions that set and get it, and its reference; an enumeration is an integer."""
        whole = "Integer" if self.fmu.version == 2 else "Int64"
        return whole if variable.kind == "Enumeration" else variable.kind, variable.reference

    @property
    def period(self) -> int:
        """Period of its steps [ticks]."""
        return self._map.period

    @property
    def used(self) -> frozenset[str]:
        """Signals that its inputs take."""
        return frozenset(link.signal for link in self._map.inputs)

    def outputs(self, signals: Mapping[str, float]) -> dict[str, float]:
        """Signals of its outputs now, with these inputs, without a step.

        Raises:
            FmuError: if it fails, stalls, crashes or gives no finite number.
        """
        return self._called(0, signals)

    def step(self, ticks: int, signals: Mapping[str, float]) -> dict[str, float]:
        """Signals of its outputs after a step over ``ticks`` that begins with these inputs.

        Raises:
            FmuError: if it fails, stalls, crashes or gives no finite number.
        """
        found = self._called(ticks, signals)
        self.ticks += ticks
        return found

    def until(self, tick: int, signals: Mapping[str, float]) -> dict[str, float]:
        """Signals of its outputs after steps of its period with these inputs until its time is past ``tick``.

        Empty if it is already.

        Raises:
            FmuError: if it fails, stalls, crashes or gives no finite number.
        """
        found: dict[str, float] = {}
        while self.ticks <= tick:
            found = self.step(self.period, signals)
        return found

    def _called(self, ticks: int, signals: Mapping[str, float]) -> dict[str, float]:
        time, length = self.ticks * TICK, ticks * TICK
        request = self._step.pack(host.STEP, time, length, *self._map.values(signals))
        values = self._values.unpack(self._ask(request, f"at {time:g} s", self._map.timeout))
        for link, value in zip(self._map.outputs, values, strict=True):
            if not math.isfinite(value):
                raise FmuError(f"{self.fmu.path}: at {time:g} s its output {link.variable.name} is {value}")
        return self._map.signals(values)

    def restart(self) -> None:
        """Begin anew."""
        self.close()
        self._open()
        self.ticks = 0

    def close(self) -> None:
        """End the process and remove its folder."""
        self._end()

    def __deepcopy__(self, memo: dict[int, Any]) -> "FmuInstance":
        """Another instance in the same state.

        Raises:
            ValueError: one line, if the FMU's state can't be taken.
        """
        if not self.fmu.keeps_state:
            raise ValueError(
                f"{self.fmu.path}: cannot be copied: it does not declare canGetAndSetFMUstate and "
                "canSerializeFMUstate; it works in runs, but not in snapshots"
            )
        state, other = self._ask(host.STATE, "state", self._map.timeout), copy.copy(self)
        other._open()
        other._ask(host.SET_STATE + host.SIZE.pack(len(state)) + state, "state", self._map.timeout)
        return other

    def _ask(self, request: bytes, when: str, limit: float) -> bytes:
        deadline = time.monotonic() + limit
        try:
            sent = 0
            while sent < len(request):
                sent += os.write(self._requests.fileno(), request[sent:])
            answer = self._read(b"", host.HEAD, deadline)
            (size,) = host.SIZE.unpack_from(answer, 1)
            answer = self._read(answer, host.HEAD + size, deadline)
        except TimeoutError:
            raise self._failure(f"{when}: does not return within {limit:g} s", FmuKilledError) from None
        except (OSError, EOFError, ValueError):
            event, kind = self._death()
            raise self._failure(f"{when}: {event}", kind) from None
        content = answer[host.HEAD :]
        if answer[:1] != host.DONE:
            raise self._failure(f"{when}: {content.decode(errors='replace')}")
        return content

    def _read(self, answer: bytes, size: int, deadline: float) -> bytes:
        """The answer so far, with more, until it has that size."""
        while len(answer) < size:
            if not self._poll.poll(max(0.0, deadline - time.monotonic()) * 1e3):
                raise TimeoutError
            piece = os.read(self._answers.fileno(), _PIECE)
            if not piece:
                raise EOFError
            answer += piece
        return answer

    def _death(self) -> tuple[str, type[FmuKilledError]]:
        try:
            code = self._process.wait(_END)
        except subprocess.TimeoutExpired:
            return "its process closed the connection", FmuKilledError
        if code >= 0:
            return f"its process exited ({code})", FmuKilledError
        kind = _SigkillError if -code == signal.SIGKILL else FmuKilledError
        return f"its process was ended by {signal.Signals(-code).name}", kind

    def _failure(self, event: str, kind: type[FmuError] = FmuError) -> FmuError:
        said = self._last_words()
        if self.fmu.tool == "offtrack" and "ended by signal" in said:  # the Python process behind it
            kind = _SigkillError if f"signal {signal.SIGKILL:d} " in said else FmuKilledError
        self._process.kill()
        self.close()
        event = " ".join(event.replace(f"{self._folder}/", "").split())
        return kind(f"{self.fmu.path}: {shown(event, 300)}{said}")

    def _last_words(self) -> str:
        """The last line that the FMU printed or logged."""
        try:
            size = self._log.seek(0, os.SEEK_END)
            self._log.seek(max(0, size - _TAIL))
            lines = [line.strip() for line in self._log.read().decode(errors="replace").splitlines() if line.strip()]
        except (OSError, ValueError):
            return ""
        return f' (it said: "{shown(lines[-1], 200)}")' if lines else ""


def _ended(process: subprocess.Popen[bytes], cleanup: ExitStack, log: IO[bytes]) -> None:
    """End a process, at first politely, and what it has started."""
    with suppress(OSError, subprocess.TimeoutExpired):
        if process.stdin is not None:
            process.stdin.close()
        process.wait(_END)
    with suppress(OSError):  # all have ended
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    if process.stdout is not None:
        process.stdout.close()
    log.close()
    cleanup.close()
