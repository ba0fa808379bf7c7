"""Systems of FMUs, run by FMPy or component after component, and their off-tracking."""

import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from fmpy.ssp.ssd import Connection, read_ssd

from scenarios.results.metrics import true_off_tracking
from tests.fmus.plants import Slave
from vehicle.combination.truth import plan_pose
from vehicle.frames import FloatArray, rotation_zyx, transform

ORDER = ("ground", "sensor", "law", "driver", "plant")  # as in the loop of a run


class System:
    """The components of a system with the values of their outputs, each stepped with what the others have given."""

    def __init__(self, ssp: Path, folder: Path, python: str) -> None:
        with zipfile.ZipFile(ssp) as archive:
            archive.extractall(folder)
        self._connections: Sequence[Connection] = read_ssd(str(ssp)).system.connections
        names = sorted((file.stem for file in (folder / "resources").glob("*.fmu")), key=_place)
        self.slaves = {
            name: Slave(
                folder / "resources" / f"{name}.fmu",
                folder / name,
                {"first_step": 0.0} if name.startswith("law") else {},  # it need not wait for the sensor
                {} if name == "plant" else {"python": python},
            )
            for name in names
        }
        self._numbers = {
            name: [one.name for one in slave.description.modelVariables
                   if one.causality == "output" and one.type == "Real"]
            for name, slave in self.slaves.items()
        }  # fmt: skip
        self._said: dict[str, dict[str, float]] = {}
        for name in names:
            self._listen(name)

    def _listen(self, name: str) -> None:
        numbers = self._numbers[name]
        self._said[name] = dict(zip(numbers, self.slaves[name].get(numbers), strict=True))

    def _tell(self, name: str) -> None:
        self.slaves[name].set(
            {one.endConnector: self._said[one.startElement][one.startConnector]
             for one in self._connections if one.endElement == name}
        )  # fmt: skip

    def step(self) -> dict[str, float]:
        """A step of 10 ms of all components; outputs of the plant at its beginning, on the ground that is below it."""
        at_beginning = self._said["plant"]
        for name, slave in self.slaves.items():
            self._tell(name)
            slave.step()
            self._listen(name)
            if name == "ground":
                self._tell("plant")
                self._listen("plant")
                at_beginning = self._said["plant"]
        return at_beginning

    def close(self) -> None:
        for slave in self.slaves.values():
            slave.close()


def _place(name: str) -> int:
    return ORDER.index(name.partition("_")[0])


def run_in_order(ssp: Path, folder: Path, seconds: float, python: str) -> tuple[dict[str, FloatArray], str]:
    """Outputs of the plant every 10 ms, as the sensors see them, and the hash of all images of the last trailer."""
    system = System(ssp, folder, python)
    rows = [system.step() for _ in range(round(seconds / 0.01) + 1)]
    sensor = system.slaves["sensor"]
    (sha,) = sensor.fmu.getString([sensor.reference["frames_sha256"]])
    system.close()
    columns = {name: np.array([row[name] for row in rows]) for name in rows[0]}
    return columns, sha.decode() if isinstance(sha, bytes) else sha


def off_tracking(outputs: Mapping[str, Any], unit: int, follow_distance: float, path_height: float) -> FloatArray:
    """True off-tracking [m] of a unit, counted from 1, by the poses of its body among a plant's outputs."""
    axes = ("x", "y", "z", "yaw", "pitch", "roll")
    six = np.column_stack([outputs[f"body_{axis}_{unit}"] for axis in axes])
    bodies = np.array([transform(rotation_zyx(*row[3:]), row[:3]) for row in six])
    x, y, psi = plan_pose(bodies, path_height).T
    return true_off_tracking(x, y, np.unwrap(psi), follow_distance)
