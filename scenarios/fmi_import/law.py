"""FMUs as trailer steering laws."""

from __future__ import annotations

from pathlib import Path
from typing import Any, ClassVar, Final

import numpy as np

from controllers.trailer import Combination, SteerCommand, SteeringLaw, TrailerGeometry
from estimators.estimates import Health, OffTracking
from scenarios.fmi_import.archive import FmuFile, open_fmu
from scenarios.fmi_import.instance import FmuInstance
from scenarios.fmi_import.mapping import PartSignals, Signal, read_map
from scenarios.fmi_import.parameters import options_of
from sensors.messages import CombinationSignals
from vehicle.clock import TICK
from vehicle.frames import FloatArray
from vehicle.option import Parameter, check_options

_POINTS: Final = 30  # of the hitch's path that an FMU can take, a metre apart
_HEALTH: Final = {Health.OK: 0.0, Health.DEGRADED: 1.0, Health.LOST: 2.0}


def law_signals(n_steered: int, n_units: int) -> PartSignals:
    """Signals of a law for a trailer with ``n_steered`` steered axles in a combination of ``n_units``."""
    points, hitches, axles = range(1, _POINTS + 1), range(1, n_units), range(1, n_steered + 1)
    return PartSignals(
        kind="trailer_steering",
        inputs=(
            Signal("time", "s", "since the start"),
            Signal("off_tracking", "m", "estimated off-tracking, + when the path of the hitch lies left"),
            Signal("off_tracking_std", "m", "its stated standard deviation; 1e3 if there is none"),
            Signal("off_tracking_valid", "-", "1 while there is an estimate that is not lost"),
            Signal("off_tracking_health", "-", "0 ok, 1 degraded, 2 lost"),
            Signal("off_tracking_age", "s", "since the image was taken"),
            Signal("path_tangent", "rad", "direction of the hitch's path at the follow point, in the trailer's frame"),
            Signal("hitch_direction", "rad", "direction of the hitch's travel in the trailer's frame, + left"),
            Signal("hitch_direction_rate", "rad/s", "its rate of change"),
            Signal("hitch_speed", "m/s", "estimated velocity of the hitch along the trailer's x axis"),
            Signal("hitch_lateral_speed", "m/s", "along its y axis"),
            *(Signal(f"path_x_{k}", "m", f"hitch's path {k} m back, in the trailer's frame") for k in points),
            *(Signal(f"path_y_{k}", "m", f"hitch's path {k} m back, in the trailer's frame") for k in points),
            Signal("speed", "m/s", "of the tractor, by its wheels"),
            Signal("steer", "rad", "of the tractor's foremost steered axle, + left"),
            *(Signal(f"articulation_{k}", "rad", f"at hitch {k}: unit ahead minus unit behind") for k in hitches),
            *(Signal(f"yaw_rate_{k}", "rad/s", f"gyro of unit {k}, the tractor is 1") for k in range(1, n_units + 1)),
            Signal("lateral_acceleration", "m/s2", "of the trailer's body above its axles, + left"),
            *(Signal(f"steer_trailer_{k}", "rad", f"encoder of steered axle {k}") for k in axles),
        ),
        outputs=tuple(
            Signal(f"steer_demand_{k}", "rad", f"of steered axle {k} of the trailer, + left", required=True)
            for k in axles
        ),
    )  # fmt: skip


class FmuLaw(SteeringLaw[int]):
    """A trailer steering law that is an FMU; its memory is the tick of its last step.

    At every period of its map it is stepped once over that period, with the signals of that moment. Its outputs of the
    end of the step are the command until the next one: a law that computes its outputs in the step acts without delay.
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
        if memory < 0 or tick - memory >= instance.period:
            given = _given(tick, off_tracking, signals, instance.used)
            found = instance.step(instance.period, given)
            self._command = np.array([found[f"steer_demand_{k}"] for k in range(1, self._n + 1)])
            memory = tick
        return memory, SteerCommand(angles=self._command)


def _given(
    tick: int, off_tracking: OffTracking | None, signals: CombinationSignals, used: frozenset[str]
) -> dict[str, float]:
    """Inputs [SI] of the FMU."""
    valid = off_tracking is not None and off_tracking.health is not Health.LOST
    values = {
        "time": tick * TICK,
        "speed": signals.speed,
        "steer": signals.steer,
        "lateral_acceleration": signals.lateral_acceleration,
        "off_tracking_valid": float(valid),
        **_numbered("articulation", signals.articulation),
        **_numbered("yaw_rate", signals.yaw_rates),
        **_numbered("steer_trailer", signals.angles),
    }
    if off_tracking is None:
        return {**dict.fromkeys(used, 0.0), **values, "off_tracking_std": 1e3, "off_tracking_health": 2.0}
    values |= {
        "off_tracking": off_tracking.value,
        "off_tracking_std": min(off_tracking.std, 1e3),
        "off_tracking_health": _HEALTH[off_tracking.health],
        "off_tracking_age": off_tracking.age(tick),
        "path_tangent": off_tracking.path_tangent,
        "hitch_direction": off_tracking.hitch_direction,
        "hitch_direction_rate": off_tracking.hitch_direction_rate,
        "hitch_speed": off_tracking.v_x,
        "hitch_lateral_speed": off_tracking.v_y,
    }
    if any(name.startswith("path_") for name in used):
        values |= _path(off_tracking.path)
    return values


def _numbered(name: str, values: FloatArray) -> dict[str, float]:
    return {f"{name}_{k}": float(value) for k, value in enumerate(values, start=1)}


def _path(path: FloatArray) -> dict[str, float]:
    """Points of the hitch's path, a metre apart; past its end the last one."""
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(path, axis=0).T))])
    back = np.arange(1.0, _POINTS + 1.0)
    return {
        **_numbered("path_x", np.interp(back, along, path[:, 0])),
        **_numbered("path_y", np.interp(back, along, path[:, 1])),
    }


def law_of(file: str) -> type[FmuLaw]:
    """Class of the law of an FMU.

    Raises:
        ValueError: one line, if it is no FMU that runs here.
    """
    fmu = open_fmu(Path(file))
    names: dict[str, Any] = {"fmu": fmu, "options": options_of(fmu)}
    return type("FmuLaw", (FmuLaw,), names)
