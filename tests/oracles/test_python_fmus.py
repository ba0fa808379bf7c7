"""Vehicles that PythonFMU (FMI 2) and PythonFMU3 (FMI 3) export, as plants under the cameras of a run.

The exporters (MIT) are needed for nothing else: ``pip install pythonfmu pythonfmu3``.
"""

import importlib
import importlib.util
import math

import numpy as np
import pytest

import offtrack

WHEELBASE, HITCH = 3.8, 0.7744762  # of uk_longer_semitrailer: rear axle to front, to hitch [m]
TRAILER = 9.31  # to the middle of its axles [m]
MODEL = """
from math import cos, sin, tan

from pythonfmu{n} import Fmi{version}Causality, Fmi{version}Slave, Fmi{version}Variability, {real}


class Kinematic(Fmi{version}Slave):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.names = ("x_1", "y_1", "psi_1", "x_2", "y_2", "psi_2")
        for name in ("start_x", "start_y", "start_psi", "start_speed"):
            self.add(name, Fmi{version}Causality.parameter, variability=Fmi{version}Variability.tunable, start=0.0)
        for name in ("steer", "acceleration", "steer_trailer_1", "steer_trailer_2"):
            self.add(name, Fmi{version}Causality.input, start=0.0)
        for name in self.names:
            self.add(name, Fmi{version}Causality.output)

    def add(self, name, causality, **others):
        setattr(self, name, 0.0)
        self.register_variable({real}(name, causality=causality, **others))

    def exit_initialization_mode(self):
        self.speed, self.psi_2 = self.start_speed, self.start_psi
        self.x_1, self.y_1, self.psi_1 = self.start_x, self.start_y, self.start_psi
        self.couple()

    def do_step(self, current_time, step_size):
        self.speed = max(0.0, self.speed + step_size * self.acceleration)
        h = step_size / 10
        for _ in range(10):
            turn = self.speed * tan(self.steer) / {wheelbase}
            angle = self.psi_1 - self.psi_2
            forward = self.speed * cos(angle) - {hitch} * turn * sin(angle)
            left = self.speed * sin(angle) + {hitch} * turn * cos(angle)
            steer = (self.steer_trailer_1 + self.steer_trailer_2) / 3  # of three axles, the first of which is fixed
            self.psi_2 += h * (left - forward * tan(steer)) / {trailer}
            self.x_1 += h * self.speed * cos(self.psi_1 + 0.5 * h * turn)
            self.y_1 += h * self.speed * sin(self.psi_1 + 0.5 * h * turn)
            self.psi_1 += h * turn
        self.couple()
        return True

    def couple(self):
        self.x_2 = self.x_1 + {hitch} * cos(self.psi_1)
        self.y_2 = self.y_1 + {hitch} * sin(self.psi_1)
"""


@pytest.fixture(scope="module", params=[2, 3])
def truck(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> str:
    n, real = ("", "Real") if request.param == 2 else ("3", "Float64")
    if importlib.util.find_spec(f"pythonfmu{n}") is None:
        pytest.skip(f"needs the package pythonfmu{n}")
    folder = tmp_path_factory.mktemp("model")
    numbers = {"wheelbase": WHEELBASE, "hitch": HITCH, "trailer": TRAILER}
    (folder / "kinematic.py").write_text(MODEL.format(n=n, version=request.param, real=real, **numbers))
    builder = importlib.import_module(f"pythonfmu{n}").FmuBuilder
    return str(builder.build_FMU(folder / "kinematic.py", dest=folder))


def settings(truck: str, off_tracking: str, trailer_steering: str) -> dict[str, object]:
    parts = {"off_tracking": off_tracking, "trailer_steering": trailer_steering}
    return {"plant.fmu": truck, "vehicle": "uk_longer_semitrailer", **parts}


def test_an_unsteered_trailer_cuts_the_corner_by_the_closed_form(truck: str) -> None:
    """Without slip, circles of the hitch and of the trailer's axle about one centre: R_axle^2 = R_hitch^2 - L^2."""
    course = {"course.turn_deg": 1080.0, "course.exit": 5.0}
    run = offtrack.run("roundabout", settings=settings(truck, "truth", "none") | course)
    x, y, psi = (np.asarray(run[f"{name}_semitrailer"]) for name in ("x", "y", "psi"))
    circle = slice(-1000, -800)  # of the last turn, 25 m before its end; the first two die away as exp(-s / 24 m)
    axle = np.column_stack([x - TRAILER * np.cos(psi), y - TRAILER * np.sin(psi)])[circle]
    hitch = np.column_stack([x, y])[circle]
    assert radius(axle) == pytest.approx(math.sqrt(radius(hitch) ** 2 - TRAILER**2), abs=0.02)
    assert 8.0 < radius(hitch) < 12.5  # the front axle is guided


def radius(points: np.ndarray) -> float:
    """Of the circle through points (n, 2), by linear least squares."""
    A = np.column_stack([2.0 * points, np.ones(len(points))])
    (x, y, c), *_ = np.linalg.lstsq(A, (points**2).sum(axis=1), rcond=None)
    return math.sqrt(c + x * x + y * y)


def test_cameras_and_a_law_steer_its_trailer(truck: str) -> None:
    """The law is designed for the data sheet's vehicle, and its off-tracking is estimated from rendered images."""
    course = {"course.turn_deg": 90.0, "course.exit": 20.0}
    run = offtrack.run("roundabout", settings=settings(truck, "viso_ot", "path_preview") | course)
    assert run.summary["outcome"] == "completed"
    assert not run.summary["warnings"]
    assert run.summary["off_tracking"]["true_max_m"] < 0.1
    assert run.summary["off_tracking"]["estimate_error_rms_m"] < 0.01
