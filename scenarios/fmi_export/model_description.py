"""modelDescription.xml and buildDescription.xml, versions 2 and 3 of FMI."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Final
from xml.etree.ElementTree import Element, SubElement, indent, tostring

from scenarios.fmi_export.exported import Exported
from scenarios.fmi_export.units import DISPLAY, base_unit
from scenarios.fmi_export.variables import Variable

_STATES: Final = {2: "FMUstate", 3: "FMUState"}


def model_description(model: Exported, version: int, token: str, sources: Sequence[str]) -> bytes:
    """``modelDescription.xml``; ``sources`` are the C files to compile."""
    variables = model.variables
    root = Element("fmiModelDescription", fmiVersion=f"{version}.0", modelName=model.name)
    root.set("guid" if version == 2 else "instantiationToken", token)
    root.set("description", model.summary)
    root.set("generationTool", "offtrack")
    root.set("variableNamingConvention", "flat")
    simulation = SubElement(
        root, "CoSimulation", modelIdentifier=model.identifier, canHandleVariableCommunicationStepSize="true"
    )
    keeps = str(model.keeps_state).lower()
    simulation.set(f"canGetAndSet{_STATES[version]}", keeps)
    simulation.set(f"canSerialize{_STATES[version]}", keeps)
    if model.tool_only:
        simulation.set("needsExecutionTool", "true")
    if version == 2:
        simulation.set("canNotUseMemoryManagementFunctions", "true")
        files = SubElement(simulation, "SourceFiles")
        for name in sources:
            SubElement(files, "File", name=name)
    elif model.internal_step is not None:
        simulation.set("fixedInternalStepSize", _number(model.internal_step))
    _units(root, variables)
    categories = SubElement(root, "LogCategories")
    SubElement(categories, "Category", name="logStatusError", description="why a call was refused")
    SubElement(categories, "Category", name="logAll", description="all messages")
    SubElement(root, "DefaultExperiment", startTime="0", stopTime=_number(model.stop), stepSize=_number(model.step))
    _variables(root, variables, version)
    _structure(root, variables, version)
    return _text(root)


def build_description(identifier: str, sources: Sequence[str]) -> bytes:
    """``sources/buildDescription.xml`` of FMI 3."""
    root = Element("fmiBuildDescription", fmiVersion="3.0")
    configuration = SubElement(root, "BuildConfiguration", modelIdentifier=identifier)
    files = SubElement(configuration, "SourceFileSet", language="C99")
    for name in sources:
        SubElement(files, "SourceFile", name=name)
    return _text(root)


def _units(root: Element, variables: Iterable[Variable]) -> None:
    definitions = SubElement(root, "UnitDefinitions")
    for name in sorted({variable.quantity.unit for variable in variables if variable.text is None} - {"-"}):
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
        quantity, is_parameter, is_text = (
            variable.quantity,
            variable.causality == "parameter",
            variable.text is not None,
        )
        kind = ("String" if is_text else "Float64") if version == 3 else "ScalarVariable"
        entry = SubElement(entries, kind, name=quantity.name)
        entry.set("valueReference", str(variable.reference))
        entry.set("description", quantity.meaning)
        entry.set("causality", variable.causality)
        continuous = not (variable.held or is_text)
        entry.set("variability", "fixed" if is_parameter else "continuous" if continuous else "discrete")
        if variable.causality != "input":
            entry.set("initial", "exact" if is_parameter or variable.held else "calculated")
        if is_text:
            _start_text(entry, variable, version)
            continue
        value = SubElement(entry, "Real") if version == 2 else entry
        if quantity.unit != "-":
            value.set("unit", quantity.unit)
        for limit, number in (("min", quantity.low), ("max", quantity.high)):
            if number is not None and math.isfinite(number):
                value.set(limit, _number(number))
        if variable.causality != "output" or variable.held:
            value.set("start", _number(quantity.start))


def _start_text(entry: Element, variable: Variable, version: int) -> None:
    has_start = variable.causality != "output" or variable.held
    if version == 2:
        SubElement(entry, "String", {"start": variable.text or ""} if has_start else {})
    elif has_start:
        SubElement(entry, "Start", value=variable.text or "")


def _structure(root: Element, variables: Sequence[Variable], version: int) -> None:
    """Outputs with the inputs that they follow at once; of FMI 2 by place, of FMI 3 by reference."""
    place = {variable.reference: str(k) for k, variable in enumerate(variables, start=1)}
    structure = SubElement(root, "ModelStructure")
    outputs = [variable for variable in variables if variable.causality == "output"]
    initial = [output for output in outputs if not output.held]
    for group, kind, of in (("Outputs", "Output", outputs), ("InitialUnknowns", "InitialUnknown", initial)):
        parent = SubElement(structure, group) if version == 2 and of else structure
        for output in of:
            entry = SubElement(parent, "Unknown" if version == 2 else kind)
            entry.set(
                "index" if version == 2 else "valueReference",
                place[output.reference] if version == 2 else str(output.reference),
            )
            if of is outputs:
                known = [place[r] if version == 2 else str(r) for r in output.feed_through]
                entry.set("dependencies", " ".join(known))


def _number(value: float) -> str:
    return repr(float(value))


def _text(root: Element) -> bytes:
    indent(root)
    content: bytes = tostring(root, encoding="utf-8")
    return b'<?xml version="1.0" encoding="UTF-8"?>\n' + content + b"\n"
