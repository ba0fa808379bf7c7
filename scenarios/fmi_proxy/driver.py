"""The driver of a scenario as an FMU: motion of the tractor in, demands out."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from controllers.driver import PERIOD as CONTROL_PERIOD
from controllers.driver import DriverCommand
from scenarios.assembly.adapters import course_of, vehicle_of
from scenarios.assembly.drivers import opened_driver
from scenarios.assembly.plants import plant_kind
from scenarios.fmi_export.variables import Quantity
from scenarios.fmi_import.mapping import Signal
from scenarios.fmi_proxy.computation import Opening, moments
from scenarios.fmi_proxy.description import Proxy, quantity
from scenarios.fmi_proxy.scenario_files import scenario_files, scenario_in
from scenarios.loop.control import CONTROL
from scenarios.options.scenario import Scenario
from sensors.messages import EgoState
from vehicle.closing import close_part

_MOTION: Final = (
    Signal("x", "m", "position of the tractor's rear axle"),
    Signal("y", "m", "position of the tractor's rear axle"),
    Signal("psi", "rad", "heading of the tractor, + left"),
    Signal("v_x", "m/s", "velocity of its rear axle along its x axis"),
    Signal("v_y", "m/s", "along its y axis"),
    Signal("yaw_rate", "rad/s", "of the tractor, + left"),
)


def driver_proxy(scenario: Scenario) -> Proxy:
    """The driver of a scenario on its course.

    Raises:
        ValueError: one line, if the scenario is not consistent.
    """
    kind = scenario.driver.kind or ""
    if kind.endswith(".fmu"):
        raise ValueError(f"driver = {kind}: is an FMU already")
    if plant_kind(scenario) == "constant_slip":
        raise ValueError(f"scenario {scenario.name}: nobody drives, its motion is prescribed")
    vehicle = vehicle_of(scenario)
    opened = opened_driver(scenario, vehicle, course_of(scenario, vehicle))
    close_part(opened.driver)
    hitches = range(1, len(vehicle.units))
    articulation = [Signal(f"articulation_{k}", "rad", f"at hitch {k}: unit ahead minus behind") for k in hitches]
    changes = {"trailer_steering": "none", "steering": {}, "off_tracking": "truth", "estimator": {}}
    return Proxy(
        kind="driver",
        name=f"{scenario.name}_driver",
        summary=f"driver of offtrack on the course of {scenario.name}",
        inputs=[quantity(signal) for signal in (*_MOTION, *articulation)],
        outputs=[
            Quantity("steer", "rad", "road-wheel angle of the tractor's foremost steered axle, + left"),
            Quantity("acceleration", "m/s2", "above 0 drives, below 0 brakes"),
            Quantity("gear", "-", "1 forward, -1 backward", 1.0),
        ],
        files=scenario_files(scenario, changes),
        notes=(
            f"The driver acts every {1e3 * CONTROL_PERIOD:g} ms; the demands are there at the end of the step in which "
            "that is. Communication steps are whole numbers of milliseconds. In a first step with all "
            "inputs 0 nothing is done: some importers begin so.",
        ),
        step=CONTROL_PERIOD,
        stop=opened.duration,
    )


class DriverComputation:
    """A driver in the process of its FMU."""

    def __init__(self, opening: Opening) -> None:
        """Open the driver.

        Raises:
            ValueError: one line, if the scenario is not consistent.
        """
        scenario = scenario_in(opening.folder)
        vehicle = vehicle_of(scenario)
        self._driver = opened_driver(scenario, vehicle, course_of(scenario, vehicle)).driver
        self._memory = self._driver.init()
        self._demand = DriverCommand(steer=0.0, acceleration=0.0)

    def step(self, tick: int, ticks: int, values: Mapping[str, float]) -> Mapping[str, float]:
        """Demands at the end of a step; inputs hold during it."""
        is_there = tick > 0 or any(values.values())
        motion = {signal.name: values[signal.name] for signal in _MOTION}
        articulation = tuple(value for name, value in values.items() if name.startswith("articulation_"))
        for now in moments(tick, ticks, CONTROL.period) if is_there else ():
            ego = EgoState(tick=now, articulation=articulation, **motion)
            self._memory, self._demand = self._driver.step(self._memory, now, ego)
        return {name: float(value) for name, value in self._demand._asdict().items()}

    def text(self, name: str) -> str:
        """It has no text."""
        raise ValueError(f"there is no output {name}")

    def close(self) -> None:
        """Close the driver."""
        close_part(self._driver)
