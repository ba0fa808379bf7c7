"""modelDescription.xml and buildDescription.xml, versions 2 and 3 of FMI."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Final
from xml.etree.ElementTree import Element, SubElement, indent, tostring

from scenarios.fmi_export.model import PlantModel
from scenarios.fmi_export.units import DISPLAY, base_unit
from scenarios.fmi_export.variables import Variable
from vehicle.clock import TICK

_STEP: Final = 0.01  # a step that suits most uses [s]
_STOP: Final = 20.0  # [s]
_STATES: Final = {2: "FMUstate", 3: "FMUState"}


def model_description(model: PlantModel, version: int, token: str, sources: Sequence[str]) -> bytes:
    """``modelDescription.xml``; ``sources`` are the C files to compile."""
    variables = model.interface.variables()
    root = Element("fmiModelDescription", fmiVersion=f"{version}.0", modelName=model.name)
    root.set("guid" if version == 2 else "instantiationToken", token)
    root.set("description", model.summary)
    root.set("generationTool", "offtrack")
    root.set("variableNamingConvention", "flat")
    simulation = SubElement(
        root, "CoSimulation", modelIdentifier=model.identifier, canHandleVariableCommunicationStepSize="true"
    )
    simulation.set(f"canGetAndSet{_STATES[version]}", "true")
    simulation.set(f"canSerialize{_STATES[version]}", "true")
    if version == 2:
        simulation.set("canNotUseMemoryManagementFunctions", "true")
        files = SubElement(simulation, "SourceFiles")
        for name in sources:
            SubElement(files, "File", name=name)
    else:
        simulation.set("fixedInternalStepSize", _number(TICK))
    _units(root, variables)
    categories = SubElement(root, "LogCategories")
    SubElement(categories, "Category", name="logStatusError", description="why a call was refused")
    SubElement(categories, "Category", name="logAll", description="all messages")
    SubElement(root, "DefaultExperiment", startTime="0", stopTime=_number(_STOP), stepSize=_number(_STEP))
    _variables(root, variables, version)
    _structure(root, variables, version)
    return _text(root)


def build_description(model: PlantModel, sources: Sequence[str]) -> bytes:
    """``sources/buildDescription.xml`` of FMI 3."""
    root = Element("fmiBuildDescription", fmiVersion="3.0")
    configuration = SubElement(root, "BuildConfiguration", modelIdentifier=model.identifier)
    files = SubElement(configuration, "SourceFileSet", language="C99")
    for name in sources:
        SubElement(files, "SourceFile", name=name)
    return _text(root)


def _units(root: Element, variables: Iterable[Variable]) -> None:
    definitions = SubElement(root, "UnitDefinitions")
    for name in sorted({variable.quantity.unit for variable in variables} - {"-"}):
        unit = SubElement(definitions, "Unit", name=name)
        base = base_unit(name)
        if base is not None:
            exponents = {si: str(exponent) for si, exponent in base.exponents.items()}
            of_unit = SubElement(unit, "BaseUnit", exponents)
            if base.factor != 1.0:
                of_unit.set("factor", _number(base.factor))
        if name in DISPLAY:
            display, factor = DISPLAY[name]
            SubElement(unit, "DisplayUnit", name=display, factor=_number(factor))


def _variables(root: Element, variables: Sequence[Variable], version: int) -> None:
    entries = SubElement(root, "ModelVariables")
    if version == 3:
        SubElement(
            entries,
            "Float64",
            name="time",
            valueReference="0",
            causality="independent",
            variability="continuous",
            description="time",
        )
    for variable in variables:
        quantity, is_parameter = variable.quantity, variable.causality == "parameter"
        entry = SubElement(entries, "ScalarVariable" if version == 2 else "Float64", name=quantity.name)
        entry.set("valueReference", str(variable.reference))
        entry.set("description", quantity.meaning)
        entry.set("causality", variable.causality)
        entry.set("variability", "fixed" if is_parameter else "continuous")
        if variable.causality != "input":
            entry.set("initial", "exact" if is_parameter else "calculated")
        value = SubElement(entry, "Real") if version == 2 else entry
        if quantity.unit != "-":
            value.set("unit", quantity.unit)
        for limit, number in (("min", quantity.low), ("max", quantity.high)):
            if number is not None and math.isfinite(number):
                value.set(limit, _number(number))
        if variable.causality != "output":
            value.set("start", _number(quantity.start))


def _structure(root: Element, variables: Sequence[Variable], version: int) -> None:
    """Outputs with the inputs that they follow at once; of FMI 2 by place, of FMI 3 by reference."""
    place = {variable.reference: str(k) for k, variable in enumerate(variables, start=1)}
    structure = SubElement(root, "ModelStructure")
    outputs = [variable for variable in variables if variable.causality == "output"]
    lists = (
        (SubElement(structure, "Outputs"), SubElement(structure, "InitialUnknowns"))
        if version == 2
        else (structure, structure)
    )
    for parent, kind, is_initial in zip(lists, ("Output", "InitialUnknown"), (False, True), strict=True):
        for output in outputs:
            entry = SubElement(parent, "Unknown" if version == 2 else kind)
            entry.set(
                "index" if version == 2 else "valueReference",
                place[output.reference] if version == 2 else str(output.reference),
            )
            if not is_initial:
                known = [place[r] if version == 2 else str(r) for r in output.feed_through]
                entry.set("dependencies", " ".join(known))


def _number(value: float) -> str:
    return repr(float(value))


def _text(root: Element) -> bytes:
    indent(root)
    content: bytes = tostring(root, encoding="utf-8")
    return b'<?xml version="1.0" encoding="UTF-8"?>\n' + content + b"\n"
