"""A controller on a bench: offtrack's own steering laws, fed by the signals of a run alone.

As a program it is one by UDP: ``python tests/bench_controller.py LAW PORT [SKIP]`` listens at a port of loopback and
answers where the signals come from, but for the steps ``k % SKIP == 0``.
"""

import json
import socket
import sys
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

from controllers.trailer import Combination
from estimators.estimates import OffTracking
from offtrack.exchange.fmi_import.numbered_signals import estimate_of, reading_of
from scenarios.assembly.adapters import trailer_geometry, vehicle_of
from scenarios.assembly.drivers_and_laws import trailer_law
from scenarios.loop.channel import Stateful
from scenarios.options.scenario import load_scenario


class Controller:
    """A law of the last trailer of the roundabout's vehicle."""

    def __init__(self, name: str) -> None:
        vehicle = vehicle_of(load_scenario("roundabout"))
        unit = len(vehicle.units) - 1
        geometry = trailer_geometry(vehicle, unit)
        law: Any = trailer_law(name, geometry, Combination(vehicle, unit), {})
        self._step = Stateful(law.init(), law.step)
        self._n_units, self._n_steered = len(vehicle.units), len(geometry.steered_distances)

    def demands(self, tick: int, signals: Mapping[str, float]) -> dict[str, float]:
        """Demands at a tick from signals by name [SI]."""
        sensed = reading_of(tick, signals, self._n_steered, self._n_units)
        command = self._step(tick, off_tracking(tick, signals), sensed)
        return {f"steer_demand_{k}": float(angle) for k, angle in enumerate(command.angles, start=1)}


def off_tracking(tick: int, signals: Mapping[str, float]) -> OffTracking | None:
    """The estimate; None before the first, or if the bus does not carry it."""
    if not signals.get("off_tracking_known") or "path_x_1" not in signals:
        return None
    missing = {"path_points": 0.0, "off_tracking_time": -1.0, "off_tracking_bridged": 0.0}
    found = estimate_of(tick, {**missing, **signals, "path_points": 0.0})
    return found and replace(found, path=hitch_path(signals))


def hitch_path(signals: Mapping[str, float]) -> Any:
    """The hitch's path: a smooth curve through the points, which are a metre apart; chords would be 1 cm off."""
    points = [(0.0, 0.0)] + [(signals[f"path_x_{k}"], signals[f"path_y_{k}"]) for k in range(1, 31)]
    path = np.array([point for k, point in enumerate(points) if k == 0 or point != points[k - 1]])
    if len(path) < 4:
        return path
    s = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(path, axis=0).T))])
    return CubicSpline(s, path)(np.linspace(0.0, s[-1], 1 + round(10.0 * s[-1])))


def main(law: str, port: int, skip: int = 0) -> None:
    """Answer until nothing has come for 20 s."""
    controller = Controller(law)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as bench:
        bench.bind(("127.0.0.1", port))
        bench.settimeout(20.0)
        sys.stdout.write(f"{bench.getsockname()[1]}\n")
        sys.stdout.flush()
        k = 0
        while True:
            try:
                content, sender = bench.recvfrom(65_536)
            except TimeoutError:
                return
            signals = json.loads(content)
            demands = controller.demands(signals["tick"], signals)
            k += 1
            if not skip or k % skip:
                bench.sendto(json.dumps({"tick": signals["tick"], **demands}).encode(), sender)


if __name__ == "__main__":
    main(sys.argv[1], *map(int, sys.argv[2:]))
