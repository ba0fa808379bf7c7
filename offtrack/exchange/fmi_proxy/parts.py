"""Trailer steering law, driver, ground and camera loop of a scenario as FMUs.

Readings, motion and poses go in; demands come out, friction, heights and wind, or off-tracking.
"""

from collections.abc import Mapping
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Any, Final

import numpy as np

from controllers.driver import PERIOD as CONTROL_PERIOD
from controllers.driver import DriverCommand
from controllers.trailer import Combination
from controllers.trailer_steering.safeguarded import Degradation
from offtrack.exchange.fmi_import import numbered_signals
from offtrack.exchange.fmi_import.fmu_parts import steered_unit
from offtrack.exchange.fmi_import.fmu_plant import pose_of_all
from offtrack.exchange.fmi_import.mapping import Signal
from offtrack.exchange.fmi_proxy import proxy
from offtrack.exchange.recordings.writers import RecordingWriter
from scenarios.assembly import adapters
from scenarios.assembly.drivers_and_laws import (
    bare_law,
    law_uses_off_tracking,
    opened_driver,
    steering_parameters,
    trailer_law,
)
from scenarios.assembly.trailer_run import LOG_PERIOD, Assembly, WatchedTrailer, assemble, opened_ground
from scenarios.catalogue import TRAILER_STEERING, resolve
from scenarios.courses import Course
from scenarios.loop.channel import CONTROL, Stopwatch, estimator_thread
from scenarios.loop.image_observers import StereoPictures
from scenarios.loop.trailer_session import SteeredTrailer
from scenarios.options.scenario import Scenario
from scenarios.options.tables import DriverOptions
from sensors.messages import EgoState
from vehicle.clock import TICK, Schedule, to_ticks
from vehicle.combination.description import Vehicle
from vehicle.foundation.own_parts import close_part
from vehicle.frames import FloatArray
from vehicle.option import Option, Parameter, declared_options

GUARDED: Final = "guarded"  # parameter: 1 with the guard against bad estimates, 0 without
_DEGRADATION: Final = "degradation."
_FIRST: Final = "first_step"


def law_of_scenario(scenario: Scenario, first_step: float = 0.0, unit: int | None = None) -> proxy.Proxy:
    """The scenario's law as an FMU, with its first step at a time [s], for a unit or the last steered trailer.

    Raises:
        ValueError: one line, if it can't be constructed for the vehicle.
    """
    given = steering_parameters(scenario)
    return law_proxy(
        scenario.trailer_steering, adapters.vehicle_of(scenario), given, scenario.degradation, first_step, unit
    )


def law_proxy(
    name: str,
    vehicle: Vehicle,
    given: Mapping[str, Parameter],
    degradation: Degradation | None = None,
    first_step: float = 0.0,
    unit: int | None = None,
) -> proxy.Proxy:
    """A law for a trailer of a vehicle.

    Its parameters are the numbers among the law's options, and the limits of its guard.

    Args:
        name: in the catalogue, or ``package.module:Name``.
        vehicle: the data sheet that it goes by.
        given: values of its options; texts are fixed, and files that they name go into the FMU.
        degradation: limits of the guard.
        first_step: time of the law's first step [s].
        unit: index of the trailer; None: the last steered one.

    Raises:
        ValueError: one line, if there is no such law or it can't be constructed.
    """
    if name.endswith(".fmu"):
        raise ValueError(f"{name}: is an FMU already")
    unit = steered_unit(vehicle) if unit is None else unit
    trailer, combination = adapters.trailer_geometry(vehicle, unit), Combination(vehicle, unit)
    limits = degradation or Degradation()
    close_part(trailer_law(name, trailer, combination, given, limits))  # checks everything
    options = declared_options(resolve("trailer_steering", name, TRAILER_STEERING), or_keywords=True)
    numbers = [_parameter(option, given) for option in options if _is_number(option, given)]
    fixed = {key: value for key, value in given.items() if key not in {one.name for one in numbers}}
    files = {Path(str(value)).name: Path(str(value)).read_bytes() for value in fixed.values() if _is_file(value)}
    guard = _guard_parameters(limits) if law_uses_off_tracking(name) else []
    n_units, axles = len(vehicle.units), range(1, len(trailer.steered_distances) + 1)
    inputs = (*numbered_signals.estimate_signals(coarse=False), *numbered_signals.reading_signals(len(axles), n_units))
    return proxy.Proxy(
        kind="law",
        name=f"{name.rpartition(':')[2]}_{vehicle.name}",
        summary=f"trailer steering law {name} of offtrack for {vehicle.name}",
        inputs=inputs,
        outputs=[
            Signal(f"steer_demand_{k}", "rad", f"of steered axle {k} of the trailer, + left") for k in axles
        ],
        parameters=[
            *numbers,
            *guard,
            Signal(_FIRST, "s", "time of the law's first step, a whole number of milliseconds", first_step, 0.0, 1.0),
        ],
        settings={
            "law": name,
            "vehicle": vehicle.model_dump(mode="json"),
            "unit": unit,
            "fixed": {key: {"file": Path(str(value)).name} if _is_file(value) else value
                      for key, value in fixed.items()},
            "fallback": limits.fallback,
        },
        files=files,
        notes=(
            f"The law acts every {1e3 * CONTROL_PERIOD:g} ms; its demands are there at the end of the step in which it "
            "does. Communication steps are whole numbers of milliseconds; inputs hold during one.",
        ),
        step=CONTROL_PERIOD,
    )  # fmt: skip


def _is_number(option: Option, given: Mapping[str, Parameter]) -> bool:
    value = given.get(option.name, option.default)
    return isinstance(value, int | float) and not isinstance(value, bool) and option.kind is float


def _parameter(option: Option, given: Mapping[str, Parameter], prefix: str = "") -> Signal:
    value = given.get(option.name, option.default)
    assert isinstance(value, int | float)
    return Signal(prefix + option.name, option.unit, option.meaning, float(value), option.low, option.high)


def _is_file(value: Parameter) -> bool:
    return isinstance(value, str) and Path(value).is_file()


def _guard_parameters(degradation: Degradation) -> list[Signal]:
    given = degradation.model_dump()
    numbers = [option for option in declared_options(Degradation) if _is_number(option, given)]
    limits = [_parameter(option, given, _DEGRADATION) for option in numbers]
    return [Signal(GUARDED, "-", "1 with the guard against bad estimates, 0 without", 1.0, 0.0, 1.0), *limits]


class LawComputation(proxy.Computation):
    """A law in the process of its FMU."""

    def __init__(self, opening: proxy.Opening) -> None:
        """Construct the law.

        Raises:
            ValueError: one line, for a parameter outside its limits.
        """
        settings, parameters = opening.settings, dict(opening.parameters)
        vehicle, unit, name = Vehicle.model_validate(settings["vehicle"]), int(settings["unit"]), settings["law"]
        law = resolve("trailer_steering", name, TRAILER_STEERING)
        options = {option.name for option in declared_options(law, or_keywords=True)}
        given: dict[str, Parameter] = {key: value for key, value in parameters.items() if key in options}
        given |= {key: _value(value, opening.folder) for key, value in settings["fixed"].items()}
        trailer, combination = adapters.trailer_geometry(vehicle, unit), Combination(vehicle, unit)
        if parameters.get(GUARDED, 1.0) >= 0.5:
            of_guard = [key for key in parameters if key.startswith(_DEGRADATION)]
            limits = {key.removeprefix(_DEGRADATION): parameters[key] for key in of_guard}
            degradation = Degradation.of({"fallback": settings["fallback"], **limits}, "degradation")
            self._law = trailer_law(name, trailer, combination, given, degradation)
        else:
            self._law = bare_law(name, trailer, combination, given)
        self._n_steered, self._n_units = len(trailer.steered_distances), len(vehicle.units)
        self._memory = self._law.init()
        first = to_ticks(parameters[_FIRST], _FIRST)
        self._control = Schedule(period=CONTROL.period, offset=first)
        self._demands = {f"steer_demand_{k}": 0.0 for k in range(1, self._n_steered + 1)}

    def step(self, tick: int, ticks: int, values: Mapping[str, float]) -> Mapping[str, float]:
        """Demands [rad] at the end of a step; inputs hold during it."""
        estimate = numbered_signals.estimate_of(tick, values)
        for now in range(tick, tick + ticks):
            if self._control.due(now):
                reading = numbered_signals.reading_of(now, values, self._n_steered, self._n_units)
                self._memory, command = self._law.step(self._memory, now, estimate, reading)
                self._demands = {f"steer_demand_{k}": float(x) for k, x in enumerate(command.angles, start=1)}
        return self._demands

    def close(self) -> None:
        """Close the law."""
        close_part(self._law)


def _value(value: Any, folder: Path) -> Parameter:
    if isinstance(value, dict):
        return str(folder / value["file"])
    checked: Parameter = value
    return checked


def driver_proxy(scenario: Scenario) -> proxy.Proxy:
    """The driver of a scenario on its course.

    Raises:
        ValueError: one line, if the scenario is not consistent.
    """
    kind = scenario.driver.kind or ""
    if kind.endswith(".fmu"):
        raise ValueError(f"driver = {kind}: is an FMU already")
    if adapters.plant_kind(scenario) == "constant_slip":
        raise ValueError(f"scenario {scenario.name}: nobody drives, its motion is prescribed")
    vehicle = adapters.vehicle_of(scenario)
    opened = opened_driver(scenario, vehicle, adapters.course_of(scenario, vehicle))
    close_part(opened.driver)
    changes = {"trailer_steering": "none", "steering": {}, "off_tracking": "truth", "estimator": {}}
    return proxy.Proxy(
        kind="driver",
        name=f"{scenario.name}_driver",
        summary=f"driver of offtrack on the course of {scenario.name}",
        inputs=[*numbered_signals.MOTION, *numbered_signals.articulation_signals(len(vehicle.units))],
        outputs=[
            Signal("steer", "rad", "road-wheel angle of the tractor's foremost steered axle, + left"),
            Signal("acceleration", "m/s2", "above 0 drives, below 0 brakes"),
            Signal("gear", "-", "1 forward, -1 backward", 1.0),
        ],
        files=proxy.scenario_files(scenario, changes),
        notes=(
            f"The driver acts every {1e3 * CONTROL_PERIOD:g} ms; the demands are there at the end of the step in which "
            "that is. Communication steps are whole numbers of milliseconds. In a first step with all "
            "inputs 0 nothing is done: some importers begin so.",
        ),
        step=CONTROL_PERIOD,
        stop=opened.duration,
    )


class DriverComputation(proxy.Computation):
    """A driver in the process of its FMU."""

    def __init__(self, opening: proxy.Opening) -> None:
        """Open the driver.

        Raises:
            ValueError: one line, if the scenario is not consistent.
        """
        scenario = proxy.scenario_in(opening.folder)
        vehicle = adapters.vehicle_of(scenario)
        self._driver = opened_driver(scenario, vehicle, adapters.course_of(scenario, vehicle)).driver
        self._memory = self._driver.init()
        self._demand = DriverCommand(steer=0.0, acceleration=0.0)

    def step(self, tick: int, ticks: int, values: Mapping[str, float]) -> Mapping[str, float]:
        """Demands at the end of a step; inputs hold during it."""
        is_there = tick > 0 or any(values.values())
        motion = {signal.name: values[signal.name] for signal in numbered_signals.MOTION}
        articulation = tuple(value for name, value in values.items() if name.startswith("articulation_"))
        for now in proxy.moments(tick, ticks, CONTROL.period) if is_there else ():
            ego = EgoState(tick=now, articulation=articulation, **motion)
            self._memory, self._demand = self._driver.step(self._memory, now, ego)
        return {name: float(value) for name, value in self._demand._asdict().items()}

    def close(self) -> None:
        """Close the driver."""
        close_part(self._driver)


_SEED: Final = "seed"
_AXES: Final = ("x", "y", "psi")


class LaidGround:
    """The ground of a scenario under its simulated vehicle."""

    def __init__(self, scenario: Scenario, seed: int) -> None:
        """Lay the surface along the course.

        Raises:
            ValueError: one line, if the scenario is not consistent.
        """
        nominal = adapters.vehicle_of(scenario)
        course: Course = adapters.course_of(scenario, nominal)
        self.surface, _ = opened_ground(scenario, course, seed)
        vehicle = adapters.plant_vehicle(scenario)
        self.vehicle = vehicle if self.surface.gust is None else vehicle.in_wind()
        self.under = numbered_signals.GroundUnder(self.surface, self.vehicle)
        self.at_start = self.under.values(pose_of_all(self.vehicle, course.start))


def ground_proxy(scenario: Scenario, seed: int) -> proxy.Proxy:
    """The ground of a scenario.

    Raises:
        ValueError: one line, if the scenario is not consistent.
    """
    ground = LaidGround(scenario, seed)
    units = range(1, len(ground.vehicle.units) + 1)
    plant = scenario.plant.model_copy(update={"fmu": None})
    changes = {"trailer_steering": "none", "steering": {}, "driver": DriverOptions(), "plant": plant,
               "off_tracking": "truth", "estimator": {}}  # fmt: skip
    return proxy.Proxy(
        kind="ground",
        name=f"{scenario.name}_ground",
        summary=f"ground of offtrack below a combination, on the course of {scenario.name}",
        inputs=[
            Signal(f"{axis}_{k}", "rad" if axis == "psi" else "m", f"of the frame of unit {k} in the world")
            for axis in _AXES
            for k in units
        ],
        outputs=[
            one._replace(start=ground.at_start[one.name]) for one in numbered_signals.ground_signals(ground.vehicle)
        ],
        parameters=[Signal(_SEED, "-", "decides the roughness, a whole number", float(seed), 0.0, 2.0**53)],
        files=proxy.scenario_files(scenario, changes),
        notes=(
            "At the end of a step it gives the ground under the poses of the step's beginning. Communication steps are "
            "whole numbers of milliseconds. While all positions are 0 it is the ground at the start of the course: "
            "some importers begin so.",
        ),
        step=CONTROL.period * TICK / 2,
    )


class GroundComputation(proxy.Computation):
    """A ground in the process of its FMU."""

    def __init__(self, opening: proxy.Opening) -> None:
        """Lay the ground.

        Raises:
            ValueError: one line, if the scenario is not consistent.
        """
        self._ground = LaidGround(proxy.scenario_in(opening.folder), round(opening.parameters[_SEED]))
        self._values = self._ground.at_start

    def step(self, tick: int, ticks: int, values: Mapping[str, float]) -> Mapping[str, float]:
        """Ground under the poses of the step's beginning."""
        units = range(1, len(self._ground.vehicle.units) + 1)
        poses = np.array([[values[f"{axis}_{k}"] for axis in _AXES] for k in units])
        if poses[:, :2].any():
            self._values = self._ground.under.values(poses)
        return self._values


MEASURED: Final = "measured_"  # before the names of readings
HASH: Final = "frames_sha256"
_HASH_FILE: Final = "frames_sha256.txt"  # in the folder of the images
_FRAMES: Final = "frames"
_UNIT: Final = "unit"  # setting: index of the trailer
_USED: Final = frozenset(one.name for one in numbered_signals.estimate_signals(coarse=False))


def sensor_proxy(scenario: Scenario, seed: int, unit: int | None = None) -> proxy.Proxy:
    """The sensor of a trailer of a scenario, with its estimator.

    Args:
        scenario: the scenario.
        seed: decides world and noise.
        unit: index of the trailer among the vehicle's units; None: the last one.

    Raises:
        ValueError: one line, if the scenario is not consistent.
    """
    if scenario.off_tracking.endswith(".fmu"):
        raise ValueError(f"off_tracking = {scenario.off_tracking}: is an FMU already")
    nominal = adapters.vehicle_of(scenario)
    adapters.course_of(scenario, nominal)  # a course that can't be is refused here, and not in another tool
    vehicle, unit = adapters.plant_vehicle(scenario), adapters.watched_units(nominal)[-1] if unit is None else unit
    schedule = adapters.rig_schedule(scenario.rig, LOG_PERIOD)
    plant = scenario.plant.model_copy(update={"fmu": None})
    changes = {"trailer_steering": "none", "steering": {}, "driver": DriverOptions(), "plant": plant}
    readings = [  # by other names than those of the motion that goes in
        one._replace(name=MEASURED + one.name)
        for one in numbered_signals.reading_signals(len(vehicle.units[unit].steered_axles), len(vehicle.units))
    ]
    return proxy.Proxy(
        kind="sensor",
        name=f"{scenario.name}_sensor",
        summary=f"off-tracking by {scenario.off_tracking} of offtrack, in the world of {scenario.name}",
        inputs=list(numbered_signals.truth_signals(vehicle)),
        outputs=[
            *numbered_signals.estimate_signals(coarse=False),
            *readings,
            Signal("off_tracking_count", "-", "estimates so far"),
        ],
        parameters=[Signal(_SEED, "-", "decides world and noise, a whole number", float(seed), 0.0, 2.0**53)],
        texts=[
            proxy.Text(_FRAMES, "folder for a recording of the stereo images, which must not exist yet; empty: none")
        ],
        said=[proxy.Text(HASH, "SHA-256 of all images so far, as in the manifest of a run")],
        settings={_UNIT: unit},
        files=proxy.scenario_files(scenario, changes),
        notes=(
            f"Cameras take images every {1e3 * schedule.period * TICK:g} ms, estimates appear "
            f"{1e3 * schedule.latency * TICK:g} ms later. Communication steps are whole numbers of milliseconds; "
            "inputs hold during one. While all positions are 0 it samples nothing: some importers begin so.",
        ),
        step=LOG_PERIOD * TICK,
    )


class SensorComputation(proxy.Computation):
    """World, cameras and estimator in the process of an FMU."""

    def __init__(self, opening: proxy.Opening) -> None:
        """Build the world and open the cameras.

        Raises:
            ValueError: one line, if the scenario is not consistent, or the folder for the images exists.
            RendererUnavailableError: one line, if cameras are needed and OpenGL does not work here.
        """
        scenario, seed = proxy.scenario_in(opening.folder), round(opening.parameters[_SEED])
        with ExitStack() as cleanup:
            self._parts: Assembly = cleanup.enter_context(closing(assemble(scenario, seed)))
            unit = opening.settings.get(_UNIT, self._parts.trailers[-1].unit)
            own = next(one for one in self._parts.trailers if one.unit == unit)
            worker = estimator_thread()
            cleanup.callback(worker.shutdown, cancel_futures=True)
            recorder = None
            if opening.texts[_FRAMES]:
                recorder = cleanup.enter_context(self._recorder(own, Path(opening.texts[_FRAMES])))
                cleanup.callback(lambda: recorder.note(_HASH_FILE, self.text(HASH)))
            self._cleanup = cleanup.pop_all()
        self._trailer = SteeredTrailer(own, worker, Stopwatch())
        self._pictures = StereoPictures(0, own.unit, own.sensing.cameras, worker, keep=False, recorder=recorder)
        readings = numbered_signals.reading_signals(own.n_steered, len(self._parts.vehicle.units))
        self._readings = {MEASURED + signal.name: 0.0 for signal in readings}

    def _recorder(self, own: WatchedTrailer, folder: Path) -> RecordingWriter:
        cameras = own.sensing.cameras
        if cameras is None:
            raise ValueError(f"{_FRAMES} = {folder}: this sensor has no stereo cameras")
        return RecordingWriter(folder, cameras.calibrated, own.geometry.follow_distance, own.path_height)

    def step(self, tick: int, ticks: int, values: Mapping[str, float]) -> Mapping[str, float]:
        """Estimate and readings at the end of a step; inputs hold during it."""
        channel, vehicle = self._trailer.channel, self._parts.vehicle
        is_there = any(values[f"{axis}_{k}"] for axis in ("x", "y") for k in range(1, len(vehicle.units) + 1))
        for now in proxy.moments(tick, ticks, LOG_PERIOD):
            if is_there:
                truth = numbered_signals.truth_of(now, values, vehicle, self._on_ground)
                self._pictures.follow(truth)
                message = channel.sample(truth, now)
                if message is not None:
                    self._pictures.see(0, message, truth)
                if CONTROL.due(now):
                    reading = numbered_signals.reading_values(self._trailer.trailer.signals.sample(truth))
                    self._readings = {MEASURED + name: value for name, value in reading.items()}
            channel.deliver(now)
        return {
            **numbered_signals.estimate_values(tick + ticks, self._trailer.newest, _USED),
            **self._readings,
            "off_tracking_count": float(len(channel.delivered)),
        }

    def _on_ground(self, unit: int, x: float, y: float, psi: float) -> FloatArray:
        return self._parts.surface.pose_on(x, y, psi, self._parts.vehicle.supports(unit))

    def text(self, name: str) -> str:
        """Hash of all images so far."""
        return self._pictures.sha256 if self._trailer.trailer.sensing.cameras else "none"

    def close(self) -> None:
        """Finish the recording and close the cameras."""
        self._cleanup.close()
