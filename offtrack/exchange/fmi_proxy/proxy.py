"""An FMU with a Python process: its description for C and Python, its computation, and the scenario inside."""

from __future__ import annotations

import json
import re
import tempfile
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final, NamedTuple

from offtrack.exchange.fmi_export.c_files import common_files, rows, source_text
from offtrack.exchange.fmi_export.plant_model import Exported
from offtrack.exchange.fmi_export.variables import Quantity, Variable
from offtrack.exchange.fmi_import.mapping import Signal
from scenarios.options.scenario import Scenario, load_scenario
from scenarios.results.run_inputs import run_inputs, write_inputs

FORMAT: Final = 1  # of the description; another one is refused
MODEL_FILE: Final = "model.json"
_COMMON: Final = (
    Quantity("start_timeout", "s", "longest time that the Python process may take to start", 120.0, 0.1, 1e5),
    Quantity("timeout", "s", "longest time that it may take for a step", 60.0, 0.01, 1e5),
)
_PROCESS: Final = ("process.h", "process.c", "proxy.c")
_LONGEST_NAME: Final = 60


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
    inputs: Sequence[Quantity]
    outputs: Sequence[Quantity]  # with their values before the first step
    parameters: Sequence[Quantity] = ()
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
            identifier="offtrack_" + re.sub(r"\W", "_", self.name, flags=re.ASCII)[:_LONGEST_NAME],
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
    def _all_parameters(self) -> list[Quantity]:
        return [*_COMMON, *self.parameters]

    @property
    def _all_texts(self) -> list[Text]:
        return [_PYTHON, *self.texts]

    def _variables(self) -> tuple[Variable, ...]:
        """All variables with their references, as the C source counts them."""
        texts, said = map(_quantity, self._all_texts), map(_quantity, self.said)
        variables = [
            *(Variable(quantity=one, causality="parameter", reference=0) for one in self._all_parameters),
            *(Variable(quantity=one, causality="input", reference=0) for one in self.inputs),
            *(Variable(quantity=one, causality="output", reference=0, held=True) for one in self.outputs),
            *(Variable(quantity=one, causality="parameter", reference=0, text="") for one in texts),
            *(Variable(quantity=one, causality="output", reference=0, text="", held=True) for one in said),
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


def quantity(signal: Signal, start: float = 0.0) -> Quantity:
    """A signal as a variable of the FMU."""
    return Quantity(signal.name, signal.unit, signal.meaning, start)


def _quantity(text: Text) -> Quantity:
    return Quantity(text.name, "-", text.meaning)


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
    with tempfile.TemporaryDirectory(prefix="offtrack-fmu-") as name:
        folder = Path(name)
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
