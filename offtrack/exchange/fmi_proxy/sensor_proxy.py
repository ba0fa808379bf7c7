"""The camera loop as an FMU: world, cameras, odometry and buffer of a scenario; motion in, off-tracking out."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Final

from offtrack.exchange.fmi_export.variables import Quantity
from offtrack.exchange.fmi_import.mapping import Signal
from offtrack.exchange.fmi_import.numbered_signals import (
    NO_ESTIMATE,
    estimate_signals,
    estimate_values,
    reading_signals,
    reading_values,
    truth_of,
    truth_signals,
)
from offtrack.exchange.fmi_proxy.proxy import (
    Computation,
    Opening,
    Proxy,
    Text,
    moments,
    quantity,
    scenario_files,
    scenario_in,
)
from offtrack.exchange.recordings.writers import RecordingWriter
from scenarios.assembly.adapters import course_of, plant_vehicle, rig_schedule, vehicle_of, watched_units
from scenarios.assembly.trailer_run import LOG_PERIOD, Assembly, WatchedTrailer, assemble
from scenarios.loop.channel import CONTROL, Stopwatch, estimator_thread
from scenarios.loop.image_observers import StereoPictures
from scenarios.loop.trailer_session import SteeredTrailer
from scenarios.options.scenario import Scenario
from scenarios.options.vehicle_and_driver import DriverOptions
from vehicle.clock import TICK
from vehicle.frames import FloatArray

MEASURED: Final = "measured_"  # before the names of readings
HASH: Final = "frames_sha256"
_HASH_FILE: Final = "frames_sha256.txt"  # in the folder of the images
_SEED: Final = "seed"
_FRAMES: Final = "frames"
_UNIT: Final = "unit"  # setting: index of the trailer
_USED: Final = frozenset(one.name for one in estimate_signals(coarse=False))


def sensor_proxy(scenario: Scenario, seed: int, unit: int | None = None) -> Proxy:
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
    nominal = vehicle_of(scenario)
    course_of(scenario, nominal)  # a course that can't be is refused here, and not in another tool
    vehicle, unit = plant_vehicle(scenario), watched_units(nominal)[-1] if unit is None else unit
    schedule = rig_schedule(scenario.rig, LOG_PERIOD)
    plant = scenario.plant.model_copy(update={"fmu": None})
    changes = {"trailer_steering": "none", "steering": {}, "driver": DriverOptions(), "plant": plant}
    readings = _measured(reading_signals(len(vehicle.units[unit].steered_axles), len(vehicle.units)))
    return Proxy(
        kind="sensor",
        name=f"{scenario.name}_sensor",
        summary=f"off-tracking by {scenario.off_tracking} of offtrack, in the world of {scenario.name}",
        inputs=[quantity(signal) for signal in truth_signals(vehicle)],
        outputs=[
            *(quantity(signal, NO_ESTIMATE.get(signal.name, 0.0)) for signal in estimate_signals(coarse=False)),
            *map(quantity, readings),
            Quantity("off_tracking_count", "-", "estimates so far"),
        ],
        parameters=[Quantity(_SEED, "-", "decides world and noise, a whole number", float(seed), 0.0, 2.0**53)],
        texts=[Text(_FRAMES, "folder for a recording of the stereo images, which must not exist yet; empty: none")],
        said=[Text(HASH, "SHA-256 of all images so far, as in the manifest of a run")],
        settings={_UNIT: unit},
        files=scenario_files(scenario, changes),
        notes=(
            f"Cameras take images every {1e3 * schedule.period * TICK:g} ms, estimates appear "
            f"{1e3 * schedule.latency * TICK:g} ms later. Communication steps are whole numbers of milliseconds; "
            "inputs hold during one. While all positions are 0 it samples nothing: some importers begin so.",
        ),
        step=LOG_PERIOD * TICK,
    )


def _measured(signals: Iterable[Signal]) -> list[Signal]:
    """Readings by other names than those of the motion that goes in."""
    return [signal._replace(name=MEASURED + signal.name) for signal in signals]


class SensorComputation(Computation):
    """World, cameras and estimator in the process of an FMU."""

    def __init__(self, opening: Opening) -> None:
        """Build the world and open the cameras.

        Raises:
            ValueError: one line, if the scenario is not consistent, or the folder for the images exists.
            RendererUnavailableError: one line, if cameras are needed and OpenGL does not work here.
        """
        scenario, seed = scenario_in(opening.folder), round(opening.parameters[_SEED])
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
        readings = reading_signals(own.n_steered, len(self._parts.vehicle.units))
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
        for now in moments(tick, ticks, LOG_PERIOD):
            if is_there:
                truth = truth_of(now, values, vehicle, self._on_ground)
                self._pictures.follow(truth)
                message = channel.sample(truth, now)
                if message is not None:
                    self._pictures.see(0, message, truth)
                if CONTROL.due(now):
                    reading = reading_values(self._trailer.trailer.signals.sample(truth))
                    self._readings = {MEASURED + name: value for name, value in reading.items()}
            channel.deliver(now)
        newest = self._trailer.newest
        estimate = None if newest is None else newest.off_tracking
        return {
            **estimate_values(tick + ticks, estimate, _USED),
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
