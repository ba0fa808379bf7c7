"""Process that computes for an instance of an FMU.

The FMU's library starts it as ``python -m offtrack.exchange.fmi_proxy.server RESOURCES``. It reads requests
from standard input and answers on standard output, as ``proxy.c`` says; prints go to standard error. It ends with its
input, so that none outlives its host.
"""

from __future__ import annotations

import contextlib
import json
import os
import pkgutil
import struct
import sys
from pathlib import Path
from typing import Any, BinaryIO, Final
from urllib.parse import unquote

from offtrack.exchange.fmi_proxy.proxy import FORMAT, MODEL_FILE, Computation, Opening

_SIZE: Final = struct.Struct("=I")
_STEP: Final = struct.Struct("=qq")  # tick of the beginning, length [ticks]
_COMPUTATIONS: Final = {
    "law": "offtrack.exchange.fmi_proxy.law_proxy:LawComputation",
    "sensor": "offtrack.exchange.fmi_proxy.scenario_parts:SensorComputation",
    "driver": "offtrack.exchange.fmi_proxy.scenario_parts:DriverComputation",
    "ground": "offtrack.exchange.fmi_proxy.scenario_parts:GroundComputation",
}  # by the kind of an FMU
_LONGEST: Final = 700  # of a failure's text [bytes]


class Server:
    """A model with the order of its variables, as the FMU has it."""

    def __init__(self, resources: str) -> None:
        """Read the description of the model; it is opened by the first request.

        Raises:
            ValueError: one line, if the FMU was written by another version.
        """
        self._folder = folder_of(resources)
        self._description: dict[str, Any] = json.loads((self._folder / MODEL_FILE).read_text(encoding="utf-8"))
        if self._description["format"] != FORMAT:
            raise ValueError(
                f"the FMU is of format {self._description['format']}, this offtrack reads {FORMAT}: export it again"
            )
        self._computation: Computation | None = None
        self._inputs: list[str] = self._description["inputs"]
        self._outputs: list[str] = self._description["outputs"]
        self._said: list[str] = self._description["said"]

    def open(self, content: bytes) -> bytes:
        """Open the model with its parameters."""
        names: list[str] = self._description["parameters"]
        values = struct.unpack_from(f"={len(names)}d", content)
        texts, at = [], 8 * len(names)
        for _ in self._description["texts"]:
            (size,) = _SIZE.unpack_from(content, at)
            at += _SIZE.size
            texts.append(content[at : at + size].decode())
            at += size
        opening = Opening(
            folder=self._folder,
            settings=self._description["settings"],
            parameters=dict(zip(names, values, strict=True)),
            texts=dict(zip(self._description["texts"], texts, strict=True)),
        )
        self._computation = _opened(self._description["kind"], opening)
        return b""

    def step(self, content: bytes) -> bytes:
        """Outputs of a step."""
        assert self._computation is not None
        tick, ticks = _STEP.unpack_from(content)
        values = struct.unpack_from(f"={len(self._inputs)}d", content, _STEP.size)
        found = self._computation.step(tick, ticks, dict(zip(self._inputs, values, strict=True)))
        return struct.pack(f"={len(self._outputs)}d", *(found[name] for name in self._outputs))

    def text(self, content: bytes) -> bytes:
        """Value of an output that is a text."""
        assert self._computation is not None
        return self._computation.text(self._said[content[0]]).encode()

    def close(self) -> None:
        """Finish the model's files."""
        if self._computation is not None:
            self._computation.close()


def _opened(kind: str, opening: Opening) -> Computation:
    if kind not in _COMPUTATIONS:
        raise ValueError(f"the FMU is of the kind '{kind}', which this offtrack does not know")
    computation: Computation = pkgutil.resolve_name(_COMPUTATIONS[kind])(opening)
    return computation


def folder_of(resources: str) -> Path:
    """Folder of the resources: FMI 2 gives its address, FMI 3 its path.

    Raises:
        ValueError: one line, if it is not a folder of this machine.
    """
    if resources.startswith("file:"):
        path = "/" + resources.removeprefix("file:").removeprefix("//").partition("/")[2]
        resources = unquote(path)
    folder = Path(resources)
    if not resources or not (folder / MODEL_FILE).is_file():
        raise ValueError(
            f"the importer names '{resources}' as the folder of the FMU's resources: no {MODEL_FILE} there"
        )
    return folder


def serve(requests: BinaryIO, answers: BinaryIO, resources: str) -> None:
    """Answer requests until they end or one fails."""
    server: Server | None = None
    while True:
        head = requests.read(1 + _SIZE.size)
        if len(head) < 1 + _SIZE.size:
            break
        content = requests.read(_SIZE.unpack_from(head, 1)[0])
        try:
            server = server or Server(resources)
            call = {b"i": server.open, b"s": server.step, b"t": server.text}[head[:1]]
            answer = b"+", call(content)
        except (Exception, SystemExit) as error:  # a user's own part may raise anything
            answer = b"-", _line(error).encode(errors="replace")[:_LONGEST]
        answers.write(answer[0] + _SIZE.pack(len(answer[1])) + answer[1])
        answers.flush()
    if server is not None:
        server.close()


def _line(error: BaseException) -> str:
    text = " ".join(str(error).split())
    return text if isinstance(error, ValueError) and text else f"{type(error).__name__}: {text}"


def main() -> None:
    """Serve the FMU that started this process; its end needs no clean-up of modules."""
    requests, answers = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    os.dup2(2, 1)
    sys.stdout = sys.stderr
    with contextlib.suppress(OSError):  # the host has gone
        serve(requests, answers, sys.argv[1] if len(sys.argv) > 1 else "")
    sys.stderr.flush()
    os._exit(0)


if __name__ == "__main__":
    main()
