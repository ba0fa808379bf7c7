"""Systems of FMUs, run by FMPy or component after component, and their off-tracking."""

from __future__ import annotations

import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from fmpy.ssp.ssd import Connection, read_ssd

from scenarios.results.metrics import true_off_tracking
from tests.fmu_plants import Slave
from vehicle.combination.path_point import plan_pose
from vehicle.frames import FloatArray, rotation_zyx, transform

ORDER = ("sensor", "law", "driver", "plant")


def run_in_order(ssp: Path, folder: Path, seconds: float, python: str) -> tuple[dict[str, FloatArray], str]:
    """Outputs of the plant after every step of 10 ms, and the hash of all images.

    Every component gets what those before it gave in this step.
    """
    with zipfile.ZipFile(ssp) as archive:
        archive.extractall(folder)
    connections: Sequence[Connection] = read_ssd(str(ssp)).system.connections
    slaves = {
        name: Slave(
            folder / "resources" / f"{name}.fmu",
            folder / name,
            {"first_step": 0.0} if name == "law" else {},  # it need not wait for the sensor
            {} if name == "plant" else {"python": python},
        )
        for name in ORDER
    }
    names = slaves["plant"].outputs
    rows = [slaves["plant"].get(names)]
    numbers = {
        name: [one.name for one in slave.description.modelVariables
               if one.causality == "output" and one.type == "Real"]
        for name, slave in slaves.items()
    }  # fmt: skip
    said = {name: dict(zip(numbers[name], slave.get(numbers[name]), strict=True)) for name, slave in slaves.items()}
    for _ in range(round(seconds / 0.01)):
        for name, slave in slaves.items():
            given = {one.endConnector: said[one.startElement][one.startConnector]
                     for one in connections if one.endElement == name}  # fmt: skip
            slave.set(given)
            slave.step()
            said[name] = dict(zip(numbers[name], slave.get(numbers[name]), strict=True))
        rows.append(slaves["plant"].get(names))
    sensor = slaves["sensor"]
    (sha,) = sensor.fmu.getString([sensor.reference["frames_sha256"]])
    for slave in slaves.values():
        slave.close()
    return dict(zip(names, np.array(rows).T, strict=True)), sha.decode() if isinstance(sha, bytes) else sha


def off_tracking(outputs: Mapping[str, Any], unit: int, follow_distance: float, path_height: float) -> FloatArray:
    """True off-tracking [m] of a unit, counted from 1, by the poses of its body among a plant's outputs."""
    axes = ("x", "y", "z", "yaw", "pitch", "roll")
    six = np.column_stack([outputs[f"body_{axis}_{unit}"] for axis in axes])
    bodies = np.array([transform(rotation_zyx(*row[3:]), row[:3]) for row in six])
    x, y, psi = plan_pose(bodies, path_height).T
    return true_off_tracking(x, y, np.unwrap(psi), follow_distance)
