"""An FMU with a Python process: its description for C and Python, its computation, and the process itself.

The FMU's library starts it as ``python -m offtrack.exchange.fmi_proxy.proxy RESOURCES``. It reads requests from
standard input and answers on standard output, as ``proxy.c`` says; prints go to standard error. It ends with its input,
so that none outlives its host.
"""

import contextlib
import json
import os
import pkgutil
import struct
import sys
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, BinaryIO, Final, NamedTuple
from urllib.parse import unquote

from offtrack.exchange.fmi_export.plant_model import Exported, Variable, common_files, rows, source_text
from offtrack.exchange.fmi_import.mapping import Signal
from scenarios.options.scenario import Scenario, load_scenario
from scenarios.results.run_inputs import run_inputs, write_inputs
from vehicle.foundation.temporary import temporary_folder

FORMAT: Final = 1  # of the description; another one is refused
MODEL_FILE: Final = "model.json"
_COMMON: Final = (
    Signal("start_timeout", "s", "longest time that the Python process may take to start", 120.0, 0.1, 1e5),
    Signal("timeout", "s", "longest time that it may take for a step", 60.0, 0.01, 1e5),
)
_PROCESS: Final = ("process.h", "process.c", "proxy.c")


class Text(NamedTuple):
    """A variable that is a text."""

    name: str
    meaning: str


_PYTHON: Final = Text(
    "python", "Python of an environment with offtrack; empty: OFFTRACK_PYTHON, or python3 by the search path"
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Proxy:
    """An FMU in front of a Python process."""

    kind: str  # by which its process knows what to open
    name: str
    summary: str
    inputs: Sequence[Signal]
    outputs: Sequence[Signal]  # with their values before the first step
    parameters: Sequence[Signal] = ()
    texts: Sequence[Text] = ()  # parameters
    said: Sequence[Text] = ()  # outputs
    settings: Mapping[str, Any] = field(default_factory=dict)  # for the process
    files: Mapping[str, bytes] = field(default_factory=dict)  # the same, below the resources
    notes: Sequence[str] = ()
    step: float  # [s]
    stop: float = 20.0  # [s]

    def exported(self, version: int) -> Exported:
        """The FMU before it is compiled."""
        return Exported(
            name=self.name,
            summary=self.summary,
            variables=self._variables(),
            sources={
                **common_files(version),
                **{name: source_text(name) for name in _PROCESS},
                "proxy.h": self._header(),
            },
            notes=(
                "A Python process computes, of an environment with offtrack: the parameter python or the environment "
                "variable OFFTRACK_PYTHON names its interpreter. It begins and ends with the instance.",
                *self.notes,
            ),
            resources={MODEL_FILE: self._description(), **self.files},
            keeps_state=False,
            tool_only=True,
            step=self.step,
            stop=self.stop,
        )

    @property
    def _all_parameters(self) -> list[Signal]:
        return [*_COMMON, *self.parameters]

    @property
    def _all_texts(self) -> list[Text]:
        return [_PYTHON, *self.texts]

    def _variables(self) -> tuple[Variable, ...]:
        """All variables with their references, as the C source counts them."""
        texts, said = map(_signal, self._all_texts), map(_signal, self.said)
        variables = [
            *(Variable(signal=one, causality="parameter", reference=0) for one in self._all_parameters),
            *(Variable(signal=one, causality="input", reference=0) for one in self.inputs),
            *(Variable(signal=one, causality="output", reference=0, held=True) for one in self.outputs),
            *(Variable(signal=one, causality="parameter", reference=0, text="") for one in texts),
            *(Variable(signal=one, causality="output", reference=0, text="", held=True) for one in said),
        ]
        return tuple(replace(one, reference=k) for k, one in enumerate(variables, start=1))

    def _header(self) -> str:
        lines = [
            f"#define N_PARAMETERS {len(self._all_parameters)}",
            f"#define N_INPUTS {len(self.inputs)}",
            f"#define N_OUTPUTS {len(self.outputs)}",
            f"#define N_TEXTS {len(self._all_texts)}",
            f"#define N_SAID {len(self.said)}",
            *(f"#define {name} \\\n  {rows(repr(float(one.start)) for one in of)}"
              for name, of in (("PARAMETER_STARTS", self._all_parameters), ("INPUT_STARTS", self.inputs),
                               ("OUTPUT_STARTS", self.outputs))),
        ]  # fmt: skip
        return "/* Sizes and start values of this model. */\n\n" + "\n".join(lines) + "\n"

    def _description(self) -> bytes:
        content = {
            "format": FORMAT,
            "kind": self.kind,
            "parameters": [one.name for one in self._all_parameters],
            "texts": [one.name for one in self._all_texts],
            "inputs": [one.name for one in self.inputs],
            "outputs": [one.name for one in self.outputs],
            "said": [one.name for one in self.said],
            "settings": self.settings,
        }
        return json.dumps(content, indent=1).encode()


def _signal(text: Text) -> Signal:
    return Signal(text.name, "-", text.meaning)


@dataclass(frozen=True, slots=True, kw_only=True)
class Opening:
    """Everything that an FMU's process gets at its start."""

    folder: Path  # the FMU's resources
    settings: Mapping[str, Any]  # as the exporter wrote them
    parameters: Mapping[str, float]  # start values, as the importer has set them
    texts: Mapping[str, str]


class Computation(ABC):
    """A model behind an FMU, stepped from communication point to communication point."""

    @abstractmethod
    def step(self, tick: int, ticks: int, values: Mapping[str, float]) -> Mapping[str, float]:
        """Outputs [SI] at the end of a step over ``ticks`` that begins at ``tick`` with these inputs [SI]."""

    def text(self, name: str) -> str:
        """Value of an output that is a text."""
        raise ValueError(f"there is no output {name}")

    def close(self) -> None:  # noqa: B027 -- most have nothing to finish
        """Finish files and free what it holds."""


def moments(tick: int, ticks: int, period: int) -> range:
    """Multiples of a period from ``tick`` on, inside a step over ``ticks``."""
    return range(-(-tick // period) * period, tick + ticks, period)


_FILE: Final = "scenario.toml"


def scenario_files(scenario: Scenario, changes: Mapping[str, Any]) -> dict[str, bytes]:
    """Resources of an FMU: the scenario with other values, and its files.

    Raises:
        ValueError: one line, if the scenario is not consistent.
    """
    changed = scenario.model_copy(update=dict(changes))
    inputs = run_inputs(changed.model_dump(exclude_none=True))
    with temporary_folder() as folder:
        (folder / _FILE).write_text(write_inputs(changed.to_toml(), inputs, folder), encoding="utf-8")
        return {
            str(file.relative_to(folder).as_posix()): file.read_bytes()
            for file in sorted(folder.rglob("*"))
            if file.is_file()
        }


def scenario_in(folder: Path) -> Scenario:
    """The scenario among the resources of an FMU.

    Raises:
        ValueError: one line, if this offtrack does not understand it.
    """
    return load_scenario(str(folder / _FILE))


_SIZE: Final = struct.Struct("=I")
_STEP: Final = struct.Struct("=qq")  # tick of the beginning, length [ticks]
_COMPUTATIONS: Final = {
    "law": "offtrack.exchange.fmi_proxy.parts:LawComputation",
    "sensor": "offtrack.exchange.fmi_proxy.parts:SensorComputation",
    "driver": "offtrack.exchange.fmi_proxy.parts:DriverComputation",
    "ground": "offtrack.exchange.fmi_proxy.parts:GroundComputation",
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
        kind = self._description["kind"]
        if kind not in _COMPUTATIONS:
            raise ValueError(f"the FMU is of the kind '{kind}', which this offtrack does not know")
        self._computation = pkgutil.resolve_name(_COMPUTATIONS[kind])(opening)
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
