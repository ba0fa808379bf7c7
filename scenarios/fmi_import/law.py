"""FMUs as trailer steering laws."""

from __future__ import annotations

from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from controllers.trailer import Combination, SteerCommand, SteeringLaw, TrailerGeometry
from estimators.estimates import OffTracking
from scenarios.fmi_import.archive import FmuFile, open_fmu
from scenarios.fmi_import.estimate_signals import estimate_signals, estimate_values, reading_signals, reading_values
from scenarios.fmi_import.instance import FmuInstance
from scenarios.fmi_import.mapping import PartSignals, Signal, read_map
from scenarios.fmi_import.parameters import options_of
from sensors.messages import CombinationSignals
from vehicle.clock import TICK
from vehicle.option import Parameter, check_options


def law_signals(n_steered: int, n_units: int) -> PartSignals:
    """Signals of a law for a trailer with ``n_steered`` steered axles in a combination of ``n_units``."""
    return PartSignals(
        kind="trailer_steering",
        inputs=(
            Signal("time", "s", "since the start"),
            *estimate_signals(coarse=True),
            *reading_signals(n_steered, n_units),
        ),
        outputs=tuple(
            Signal(f"steer_demand_{k}", "rad", f"of steered axle {k} of the trailer, + left", required=True)
            for k in range(1, n_steered + 1)
        ),
    )


class FmuLaw(SteeringLaw[int]):
    """A trailer steering law that is an FMU; its memory is the tick at which the FMU's time began.

    It is stepped, by the period of its map, past the moment of every call, with the signals of that moment. Its outputs
    of the end of the step are the command until the next one: a law that computes its outputs in the step acts without
    delay.
    """

    fmu: ClassVar[FmuFile]

    def __init__(self, trailer: TrailerGeometry, *, combination: Combination, **parameters: Parameter) -> None:
        """For the trailer of a combination, with parameters of the FMU.

        Raises:
            ValueError: one line, if the map does not fit.
            FmuError: one line, if the FMU can't be started.
        """
        check_options(self.options, parameters, "steering")
        self._n = len(trailer.steered_distances)
        links = read_map(self.fmu, law_signals(self._n, len(combination.vehicle.units)))
        given = {name: float(value) for name, value in parameters.items()}
        if self.fmu.tool == "offtrack" and "guarded" in self.fmu.variables:
            given.setdefault("guarded", 0.0)  # the run guards it itself, as ``degradation`` says
        self._instance = FmuInstance(self.fmu, links, given)
        self._command = np.zeros(self._n)

    def init(self) -> int:
        """Memory before the first step."""
        return -1

    def step(
        self, memory: int, tick: int, off_tracking: OffTracking | None, signals: CombinationSignals
    ) -> tuple[int, SteerCommand]:
        """Command at ``tick``.

        Raises:
            FmuError: if the FMU fails, stalls, crashes or gives no finite number.
        """
        instance = self._instance
        if memory < 0 and instance.ticks > 0:
            instance.restart()
        memory = tick if memory < 0 else memory
        while instance.ticks <= tick - memory:
            given = _given(tick, off_tracking, signals, instance.used)
            found = instance.step(instance.period, given)
            self._command = np.array([found[f"steer_demand_{k}"] for k in range(1, self._n + 1)])
        return memory, SteerCommand(angles=self._command)

    def close(self) -> None:
        """End the FMU's process."""
        self._instance.close()


def _given(
    tick: int, off_tracking: OffTracking | None, signals: CombinationSignals, used: frozenset[str]
) -> dict[str, float]:
    """Inputs [SI] of the FMU."""
    return {"time": tick * TICK, **reading_values(signals), **estimate_values(tick, off_tracking, used)}


def law_of(file: str) -> type[FmuLaw]:
    """Class of the law of an FMU.

    Raises:
        ValueError: one line, if it is no FMU that runs here.
    """
    fmu = open_fmu(Path(file))
    names: dict[str, Any] = {"fmu": fmu, "options": options_of(fmu)}
    return type("FmuLaw", (FmuLaw,), names)
