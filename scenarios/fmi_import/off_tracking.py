"""FMUs as sources of off-tracking: sensor and estimator in one, of another tool or from `offtrack fmu sensor`.

Such an FMU gets the motion of the combination, as a sensor does, and gives estimates.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Self

from estimators.context import TrailerContext
from estimators.estimates import OffTracking
from scenarios.fmi_import.archive import FmuFile, open_fmu
from scenarios.fmi_import.estimate_signals import estimate_of, estimate_signals
from scenarios.fmi_import.instance import FmuInstance
from scenarios.fmi_import.mapping import PartSignals, Signal, read_map
from scenarios.fmi_import.parameters import options_of
from scenarios.fmi_import.truth_signals import truth_signals, truth_values
from vehicle.clock import TICK, Schedule
from vehicle.combination.description import Vehicle
from vehicle.combination.truth import Truth
from vehicle.option import Option, check_options

if TYPE_CHECKING:
    from scenarios.assembly.mount import MountContext, OpenedSensor

_PERIOD = 10  # of the loop [ticks]
_REQUIRED = ("off_tracking", "off_tracking_known")


def off_tracking_signals(vehicle: Vehicle) -> PartSignals:
    """Signals of a source of off-tracking on a vehicle."""
    given = (*estimate_signals(coarse=False), Signal("off_tracking_count", "-", "estimates so far"))
    return PartSignals(
        kind="off_tracking",
        inputs=(Signal("time", "s", "since the start"), *truth_signals(vehicle)),
        outputs=tuple(one._replace(required=one.name in _REQUIRED) for one in given),
    )


class WholeMotion:
    """Sensor that passes on the motion of the combination at every step of the loop."""

    sends: ClassVar = Truth

    @classmethod
    def of(cls, context: MountContext) -> OpenedSensor:
        """The sensor, without latency: that of the estimates is the FMU's own."""
        from scenarios.assembly.mount import OpenedSensor

        return OpenedSensor(sensor=cls(), schedule=Schedule(period=_PERIOD))

    def sample(self, truth: Truth) -> Truth:
        """The truth itself."""
        return truth


class FmuOffTracking:
    """A source of off-tracking that is an FMU; its memory is the number of estimates so far."""

    sensor: ClassVar[str] = "scenarios.fmi_import.off_tracking:WholeMotion"
    options: ClassVar[tuple[Option, ...]] = ()
    fmu: ClassVar[FmuFile]

    @classmethod
    def of(cls, context: TrailerContext) -> Self:
        """Source for the context's trailer.

        Raises:
            ValueError: one line, if the map does not fit or the FMU can't be started.
        """
        return cls(context)

    def __init__(self, context: TrailerContext) -> None:
        check_options(self.options, context.options, "estimator")
        links = read_map(self.fmu, off_tracking_signals(context.vehicle))
        given = {name: float(value) for name, value in context.options.items()}
        self._instance = FmuInstance(self.fmu, links, given)
        self._unknown = dict.fromkeys((one.name for one in estimate_signals(coarse=False)), 0.0)
        self._unknown["off_tracking_time"] = -1.0

    def init(self) -> float:
        """Memory before the first step."""
        return 0.0

    def step(self, memory: float, message: Truth) -> tuple[float, OffTracking | None]:
        """Number of estimates so far, and the newest one if it is new.

        Raises:
            FmuError: if the FMU fails, stalls, crashes or gives no finite number.
        """
        found: dict[str, float] = {}
        given = {"time": message.tick * TICK, **truth_values(message)}
        while self._instance.ticks <= message.tick:
            found = self._instance.step(self._instance.period, given)
        if not found:
            return memory, None
        estimate = estimate_of(message.tick, {**self._unknown, **found})
        count = found.get("off_tracking_count", memory + 1.0)  # without it every step gives a new one
        return count, estimate if count > memory else None

    def close(self) -> None:
        """End the FMU's process."""
        self._instance.close()


def off_tracking_of(file: str) -> type[FmuOffTracking]:
    """Class of the source of off-tracking of an FMU.

    Raises:
        ValueError: one line, if it is no FMU that runs here.
    """
    fmu = open_fmu(Path(file))
    names: dict[str, Any] = {"fmu": fmu, "options": options_of(fmu)}
    return type("FmuOffTracking", (FmuOffTracking,), names)
