"""A whole run as a system of FMUs: plant, driver, sensor and law with their connections, in the SSP format 1.0.

SSP: "System Structure and Parameterization", Modelica Association, version 1.0.
"""

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from typing import Final, NamedTuple
from xml.etree.ElementTree import Element, SubElement, register_namespace

from offtrack.exchange.fmi_export.fmu_writer import fmu_bytes, unit_element, xml_text, zipped
from offtrack.exchange.fmi_export.plant_kinds import combination_model
from offtrack.exchange.fmi_export.plant_model import Exported, Variable, exported_plant
from offtrack.exchange.fmi_import.mapping import Signal
from offtrack.exchange.fmi_import.numbered_signals import (
    estimate_signals,
    ground_signals,
    reading_signals,
    truth_signals,
)
from offtrack.exchange.fmi_proxy import parts
from scenarios.assembly.adapters import course_of, plant_kind, vehicle_of, watched_units
from scenarios.assembly.applied_faults import refuse_loop_faults
from scenarios.assembly.drivers_and_laws import opened_driver
from scenarios.loop.channel import CONTROL
from scenarios.options.scenario import Scenario
from vehicle.clock import TICK, to_ticks
from vehicle.combination.description import Vehicle
from vehicle.foundation.own_parts import close_part
from vehicle.surface import Surface

_VERSION: Final = 2  # of FMI: runners of SSP 1.0 take no later one
_SSD: Final = "http://ssp-standard.org/SSP1/SystemStructureDescription"
_SSC: Final = "http://ssp-standard.org/SSP1/SystemStructureCommon"
_FMU: Final = "application/x-fmu-sharedlibrary"
_ENDS: Final = ("startElement", "startConnector", "endElement", "endConnector")  # of a `Connection`


class Connection(NamedTuple):
    """An output of a component that goes to an input of another."""

    source: str  # component
    output: str
    target: str  # component
    input: str


@dataclasses.dataclass(frozen=True, slots=True, kw_only=True)
class FmuSystem:
    """FMUs by the names of their components, with their connections."""

    name: str
    summary: str
    components: Mapping[str, Exported]
    connections: Sequence[Connection]
    stop: float  # planned end [s]

    def content(self, platforms: Sequence[str]) -> bytes:
        """The SSP file.

        Raises:
            ValueError: one line, if a library cannot be compiled.
        """
        fmus = {f"resources/{name}.fmu": fmu_bytes(of, _VERSION, platforms) for name, of in self.components.items()}
        return zipped({"SystemStructure.ssd": self.description(), **fmus})

    def description(self) -> bytes:
        """``SystemStructure.ssd``."""
        register_namespace("ssd", _SSD)
        register_namespace("ssc", _SSC)
        root = Element(_ssd("SystemStructureDescription"), version="1.0", name=self.name)
        root.set("description", self.summary)
        root.set("generationTool", "offtrack")
        system = SubElement(root, _ssd("System"), name=self.name)
        elements = SubElement(system, _ssd("Elements"))
        for name, exported in self.components.items():
            component = SubElement(elements, _ssd("Component"), name=name, type=_FMU, source=f"resources/{name}.fmu")
            component.set("description", exported.summary)
            _connectors(component, self._connected(name, exported.variables))
        connections = SubElement(system, _ssd("Connections"))
        for one in self.connections:
            SubElement(connections, _ssd("Connection"), dict(zip(_ENDS, one, strict=True)))
        _units(root, [one for exported in self.components.values() for one in exported.variables])
        SubElement(root, _ssd("DefaultExperiment"), startTime="0", stopTime=repr(self.stop))
        return xml_text(root)

    def _connected(self, name: str, variables: Iterable[Variable]) -> list[Variable]:
        """Inputs that something is connected to, and all outputs that are numbers; other inputs keep their starts."""
        inputs = {one.input for one in self.connections if one.target == name}
        return [
            one
            for one in variables
            if one.text is None
            and (one.causality == "output" or (one.causality == "input" and one.signal.name in inputs))
        ]


def fmu_system(scenario: Scenario, seed: int, step: float = 0.01) -> FmuSystem:
    """The system of a scenario, for communication steps of this length [s].

    Every watched trailer has a sensor, and a law if it is steered. Uneven ground and wind are a component of their own.
    The laws act a step after driver and sensors: a runner that passes values on at the end of steps then gives them the
    readings of the same 20 ms.

    Raises:
        ValueError: one line, if the step is none of whole milliseconds up to 20 ms, or if the scenario is not
            consistent, or has a plant that is none of offtrack's equations of motion, or faults of the loop.
    """
    if not 1 <= to_ticks(step, "--step") <= CONTROL.period:
        raise ValueError(f"--step {step:g} s: must be 0.001 to {CONTROL.period * TICK:g} s")
    if plant_kind(scenario) != "multibody":
        raise ValueError(f"plant = {plant_kind(scenario)}: a system has the plant multibody")
    refuse_loop_faults(scenario.faults, "a system of FMUs")
    nominal, ground = vehicle_of(scenario), parts.LaidGround(scenario, seed)
    course = course_of(scenario, nominal)
    opened = opened_driver(scenario, nominal, course)
    close_part(opened.driver)
    starts = dict(zip(("start_x", "start_y", "start_psi"), course.start, strict=True))
    starts |= {"start_speed": opened.start_speed, **ground.at_start}
    components = {"driver": parts.driver_proxy(scenario).exported(_VERSION)}
    connections = _to_driver(ground.vehicle, reverses=bool(scenario.driver.stops))
    if not is_level(ground.surface):
        components["ground"] = parts.ground_proxy(scenario, seed).exported(_VERSION)
        poses = [f"{axis}_{k}" for axis in ("x", "y", "psi") for k in range(1, len(ground.vehicle.units) + 1)]
        connections += [Connection("plant", name, "ground", name) for name in poses]
        connections += [Connection("ground", one.name, "plant", one.name) for one in ground_signals(ground.vehicle)]
    last = len(nominal.units) - 1
    for unit in watched_units(nominal):
        own = "" if unit == last else f"_{unit + 1}"
        components[f"sensor{own}"] = parts.sensor_proxy(scenario, seed, unit).exported(_VERSION)
        connections += [Connection("plant", one.name, f"sensor{own}", one.name) for one in truth_signals(nominal)]
        if nominal.units[unit].steered_axles:
            components[f"law{own}"] = parts.law_of_scenario(scenario, first_step=step, unit=unit).exported(_VERSION)
            connections += _of_law(nominal, unit, own)
    components["plant"] = _plant(ground.vehicle, starts)
    return FmuSystem(
        name=scenario.name,
        summary=f"closed loop of offtrack: {scenario.name}",
        components=components,
        connections=connections,
        stop=opened.duration,
    )


def is_level(surface: Surface) -> bool:
    """True for level, smooth ground of one friction without wind, which stays as it is at the start."""
    level = not surface.reliefs and surface.cross_fall == 0.0 and surface.grade == 0.0 and surface.is_smooth
    return level and surface.is_uniform and surface.gust is None


def _plant(vehicle: Vehicle, starts: Mapping[str, float]) -> Exported:
    """The plant, whose start values are those of the scenario."""
    model = combination_model(vehicle)
    interface = model.interface

    def started(one: Signal) -> Signal:
        return one._replace(start=starts.get(one.name, one.start))

    changed = dataclasses.replace(
        interface,
        parameters=[started(one) for one in interface.parameters],
        inputs=[started(one) for one in interface.inputs],
    )
    return exported_plant(dataclasses.replace(model, interface=changed), _VERSION)


def _to_driver(vehicle: Vehicle, *, reverses: bool) -> list[Connection]:
    motion = ("x", "y", "psi", "v_x", "v_y", "yaw_rate")
    hitches = [f"articulation_{k}" for k in range(1, len(vehicle.units))]
    demands = ("steer", "acceleration", *(("gear",) if reverses else ()))
    return [
        *(Connection("plant", f"{name}_1", "driver", name) for name in motion),
        *(Connection("plant", name, "driver", name) for name in hitches),
        *(Connection("driver", name, "plant", name) for name in demands),
    ]


def _of_law(vehicle: Vehicle, unit: int, own: str) -> list[Connection]:
    """Connections of the law of a unit; ``own`` ends the names of its sensor and law."""
    sensor, law = f"sensor{own}", f"law{own}"
    n_steered = len(vehicle.units[unit].steered_axles)
    ahead = sum(len(one.steered_axles) for one in vehicle.units[1:unit])
    axles = range(1, n_steered + 1)
    return [
        *(Connection(sensor, one.name, law, one.name) for one in estimate_signals(coarse=False)),
        *(Connection(sensor, parts.MEASURED + one.name, law, one.name)
          for one in reading_signals(n_steered, len(vehicle.units))),
        *(Connection(law, f"steer_demand_{k}", "plant", f"steer_trailer_{ahead + k}") for k in axles),
    ]  # fmt: skip


def _connectors(component: Element, variables: Iterable[Variable]) -> None:
    connectors = SubElement(component, _ssd("Connectors"))
    for one in variables:
        connector = SubElement(connectors, _ssd("Connector"), name=one.signal.name, kind=one.causality)
        unit = one.signal.unit
        SubElement(connector, f"{{{_SSC}}}Real", {} if unit == "-" else {"unit": unit})


def _units(root: Element, variables: Iterable[Variable]) -> None:
    units = SubElement(root, _ssd("Units"))
    for name in sorted({one.signal.unit for one in variables} - {"-"}):
        unit_element(units, name, f"{{{_SSC}}}")


def _ssd(name: str) -> str:
    return f"{{{_SSD}}}{name}"
