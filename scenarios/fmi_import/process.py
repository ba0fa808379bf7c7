"""The parent's side of an FMU's process: steps with a time limit, states, and errors of one line."""

from __future__ import annotations

import json
import os
import select
import shutil
import signal
import struct
import subprocess
import sys
import tempfile
import time
import weakref
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import IO, Final

from scenarios.fmi_import import wire
from scenarios.fmi_import.archive import FmuFile, Variable
from vehicle.plant_like import EndedError
from vehicle.user_file import shown

_START: Final = 30.0  # a large library may take long to load [s]
_OWN_START: Final = 120.0  # an FMU of offtrack may open cameras [s]
_END: Final = 2.0  # for an orderly end [s]
_PIECE: Final = 65_536  # of an answer: mostly all of it [bytes]
_TAIL: Final = 2_000  # of what an FMU printed that is searched for its last line [bytes]


class FmuError(EndedError):
    """Failure of an FMU: one line with its file, the time, and its own last words."""


class FmuProcess:
    """An instance of an FMU in a process of its own."""

    def __init__(
        self,
        fmu: FmuFile,
        inputs: Sequence[Variable],
        outputs: Sequence[Variable],
        parameters: Mapping[str, float | str],
        timeout: float,
    ) -> None:
        """Create the instance.

        Args:
            fmu: the file.
            inputs: variables that every step sets.
            outputs: variables that every step reads.
            parameters: start values by name.
            timeout: longest time of a step [s].

        Raises:
            FmuError: one line, if it fails, stalls or crashes already here.
        """
        self.fmu, self._inputs, self._outputs, self._parameters = fmu, tuple(inputs), tuple(outputs), dict(parameters)
        self._timeout = timeout
        self._step = struct.Struct(f"=c{2 + len(inputs)}d")
        self._values = struct.Struct(f"={len(outputs)}d")
        self._folder = fmu.unpacked()
        self._log: IO[bytes] = tempfile.TemporaryFile()  # noqa: SIM115 -- closed with the process
        self._process = subprocess.Popen(
            [sys.executable, "-m", "scenarios.fmi_import.host"],
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
        self._end = weakref.finalize(self, _ended, self._process, self._folder, self._log)
        self._ask(
            json.dumps(self._start()).encode() + b"\n",
            "cannot be started",
            _OWN_START if fmu.tool == "offtrack" else _START,
        )

    def _start(self) -> dict[str, object]:
        variables = self.fmu.variables
        return {
            "version": self.fmu.version,
            "token": self.fmu.token,
            "identifier": self.fmu.identifier,
            "folder": str(self._folder),
            "inputs": [(self._kind(variable), variable.reference) for variable in self._inputs],
            "outputs": [(self._kind(variable), variable.reference) for variable in self._outputs],
            "parameters": [
                (self._kind(variables[name]), variables[name].reference, value)
                for name, value in self._parameters.items()
            ],
        }

    def _kind(self, variable: Variable) -> str:
        """Kind of the functions that set and get it; an enumeration is an integer, in FMI 3 of 64 bits."""
        whole = "Integer" if self.fmu.version == 2 else "Int64"
        return whole if variable.kind == "Enumeration" else variable.kind

    def step(self, time: float, length: float, inputs: Sequence[float]) -> tuple[float, ...]:
        """Outputs at the end of a step from ``time`` over ``length`` [s], which begins with these inputs.

        Raises:
            FmuError: if it fails, stalls or crashes.
        """
        content = self._ask(self._step.pack(wire.STEP, time, length, *inputs), f"at {time:g} s", self._timeout)
        values: tuple[float, ...] = self._values.unpack(content)
        return values

    def state(self) -> bytes:
        """State of the instance.

        Raises:
            ValueError: one line, if the FMU can't give it.
        """
        if not self.fmu.keeps_state:
            raise ValueError(
                f"{self.fmu.path}: cannot be copied: it does not declare canGetAndSetFMUstate and "
                "canSerializeFMUstate; it works in runs, but not in snapshots"
            )
        return self._ask(wire.STATE, "state", self._timeout)

    def copy(self) -> FmuProcess:
        """Another instance in the same state.

        Raises:
            ValueError: one line, if the FMU's state can't be taken.
        """
        state = self.state()
        other = FmuProcess(self.fmu, self._inputs, self._outputs, self._parameters, self._timeout)
        other._ask(wire.SET_STATE + wire.SIZE.pack(len(state)) + state, "state", self._timeout)
        return other

    def close(self) -> None:
        """End the process and remove its folder."""
        self._end()

    def _ask(self, request: bytes, when: str, limit: float) -> bytes:
        deadline = time.monotonic() + limit
        try:
            self._write(request)
            answer = self._read(b"", wire.HEAD, deadline)
            (size,) = wire.SIZE.unpack_from(answer, 1)
            answer = self._read(answer, wire.HEAD + size, deadline)
        except TimeoutError:
            raise self._failure(f"{when}: does not return within {limit:g} s") from None
        except (OSError, EOFError, ValueError):
            raise self._failure(f"{when}: {self._death()}") from None
        content = answer[wire.HEAD :]
        if answer[:1] != wire.DONE:
            raise self._failure(f"{when}: {content.decode(errors='replace')}")
        return content

    def _write(self, request: bytes) -> None:
        sent = 0
        while sent < len(request):
            sent += os.write(self._requests.fileno(), request[sent:])

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

    def _death(self) -> str:
        try:
            code = self._process.wait(_END)
        except subprocess.TimeoutExpired:
            return "its process closed the connection"
        return f"its process was ended by {signal.Signals(-code).name}" if code < 0 else f"its process exited ({code})"

    def _failure(self, event: str) -> FmuError:
        said = self._last_words()
        self._process.kill()
        self.close()
        event = " ".join(event.replace(f"{self._folder}/", "").split())
        return FmuError(f"{self.fmu.path}: {shown(event, 300)}{said}")

    def _last_words(self) -> str:
        """The last line that the FMU printed or logged."""
        try:
            size = self._log.seek(0, os.SEEK_END)
            self._log.seek(max(0, size - _TAIL))
            lines = [line.strip() for line in self._log.read().decode(errors="replace").splitlines() if line.strip()]
        except (OSError, ValueError):
            return ""
        return f' (it said: "{shown(lines[-1], 200)}")' if lines else ""


def _ended(process: subprocess.Popen[bytes], folder: Path, log: IO[bytes]) -> None:
    """End a process, at first politely."""
    try:
        if process.stdin is not None:
            process.stdin.close()
        process.wait(_END)
    except (OSError, subprocess.TimeoutExpired):
        process.kill()
        process.wait()
    if process.stdout is not None:
        process.stdout.close()
    log.close()
    shutil.rmtree(folder, ignore_errors=True)
