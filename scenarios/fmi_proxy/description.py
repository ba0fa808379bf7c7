"""Description of an FMU with a Python process: its variables, and how they are told to C and to Python."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final, NamedTuple

from scenarios.fmi_export.c_files import common_files, rows, source_text
from scenarios.fmi_export.exported import Exported
from scenarios.fmi_export.variables import Quantity, Variable
from scenarios.fmi_import.mapping import Signal

FORMAT: Final = 1  # of the description; another one is refused
MODEL_FILE: Final = "model.json"
_COMMON: Final = (
    Quantity("start_timeout", "s", "longest time that the Python process may take to start", 120.0, 0.1, 1e5),
    Quantity("timeout", "s", "longest time that it may take for a step", 60.0, 0.01, 1e5),
)
_PROCESS: Final = ("process_common.h", "process.h", "process_posix.c", "process_windows.c", "proxy.c")
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
