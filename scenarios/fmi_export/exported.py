"""Content of an FMU, whatever it simulates: variables, sources and what the importer is told."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from scenarios.fmi_export.c_files import c_files, plant_header
from scenarios.fmi_export.model import PlantModel
from scenarios.fmi_export.variables import Variable


@dataclass(frozen=True, slots=True, kw_only=True)
class Exported:
    """An FMU before it is compiled."""

    name: str
    identifier: str  # a C name, and the name of the library
    summary: str
    variables: Sequence[Variable]
    sources: Mapping[str, str]  # C files and headers by name, without ``token.h``
    notes: Sequence[str]  # paragraphs of its page
    fixed: Sequence[tuple[str, str]] = ()  # what is fixed at export: path and value
    resources: Mapping[str, bytes] = field(default_factory=dict)
    keeps_state: bool = True  # its state can be taken, serialised and set
    tool_only: bool = False  # it needs another program on the machine
    internal_step: float | None = None  # [s]; None: it is not declared
    step: float = 0.01  # a step that suits most uses [s]
    stop: float = 20.0  # an end that suits most uses [s]


def exported_plant(model: PlantModel, version: int) -> Exported:
    """The FMU of a plant."""
    sources = c_files(model.identifier, model.kind, version, model.programs, model.defined)
    return Exported(
        name=model.name,
        identifier=model.identifier,
        summary=model.summary,
        variables=model.interface.variables(),
        sources={**sources, "plant.h": plant_header(model.interface, model.programs, model.gear)},
        notes=(f"{model.stepping} Communication steps are whole numbers of milliseconds; inputs hold during one.",),
        fixed=model.fixed,
        internal_step=model.internal_step,
    )
