"""Small processes in place of the Python behind an FMU, for what can go wrong with it."""

import sys
from pathlib import Path
from typing import ClassVar, Final

import numpy as np

from controllers.trailer import SteerCommand, SteeringLaw, TrailerGeometry
from estimators.estimates import OffTracking
from offtrack.exchange.fmi_import.numbered_signals import estimate_signals
from sensors.messages import CombinationSignals
from tests import trailers

USED: Final = frozenset(one.name for one in estimate_signals(coarse=False))
_SCRIPT: Final = """
import os, struct, sys, time
requests, answers = os.fdopen(0, "rb", 0), os.fdopen(1, "wb", 0)
def read(n):
    got = b""
    while len(got) < n:
        piece = requests.read(n - len(got))
        if not piece:
            sys.exit()
        got += piece
    return got
def answer(content, kind=b"+"):
    answers.write(kind + struct.pack("=I", len(content)) + content)
while True:
    kind, size = struct.unpack("=cI", read(5))
    content = read(size)
    if kind == b"i":
        answer(b"")
        continue
    tick, ticks = struct.unpack_from("=qq", content)
    {mishap}
    answer(struct.pack("=2d", tick + ticks, os.getpid()))
"""


def stand_in(folder: Path, mishap: str = "") -> str:
    """A program that takes Python's place and answers steps with its time and its process number.

    ``mishap`` is a statement that every step runs before it answers.
    """
    script = folder / "stand_in.py"
    script.write_text(_SCRIPT.format(mishap=mishap), encoding="utf-8")
    program = folder / "python"
    program.write_text(f"#!/bin/sh\nexec {sys.executable} -S -E {script}\n", encoding="utf-8")
    program.chmod(0o755)
    return str(program)


def alive(process: int) -> bool:
    """True while a process runs, and while nobody has waited for it."""
    return Path(f"/proc/{process}").exists()


class Straightener(SteeringLaw[None]):
    """A law of one's own: all axles turn by the articulation."""

    uses_off_tracking: ClassVar[bool] = False

    def __init__(self, trailer: TrailerGeometry) -> None:
        """For any trailer."""

    def init(self) -> None:
        """Nothing to remember."""

    def step(
        self, memory: None, tick: int, off_tracking: OffTracking | None, signals: CombinationSignals
    ) -> tuple[None, SteerCommand]:
        return memory, SteerCommand(angles=np.full(len(signals.angles), float(signals.articulation[0])))


def estimate(tick: int, value: float = 0.3, v_x: float = 2.8, points: int = 60) -> OffTracking:
    """An estimate on a circle of 14 m radius at a speed [m/s], with a path of some points."""
    s = np.linspace(0.0, 16.0, points)
    directions = {"hitch_direction": 0.5, "hitch_direction_rate": 0.01, "path_tangent": -0.5}
    motion = {"v_x": v_x, "v_y": 0.5 * v_x, "yaw_rate": 0.07 * v_x}
    return trailers.estimate(
        tick, value=value, std=0.02, path=np.column_stack([-s, -0.035 * s**2]), **directions, **motion
    )


def reading(tick: int, speed: float = 2.8, axles: int = 2) -> CombinationSignals:
    """What the sensors of a tractor with a trailer of some steered axles say on that circle."""
    turning = {"articulation": np.array([0.58]), "yaw_rates": np.array([0.2, 0.2]), "lateral_acceleration": 0.56}
    return trailers.signals(tick, angles=np.linspace(0.1, 0.05, axles), speed=speed, steer=0.27, **turning)
