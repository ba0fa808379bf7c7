"""Exported plants of several topologies in FMPy against the plants of this process, and compiled by other means.

Libraries of other platforms need the extra ``zig``.
"""

import importlib.util
import math
import shutil
import zipfile
from pathlib import Path
from typing import Final

import numpy as np
import pytest
from fmpy.validation import validate_fmu

from offtrack.exchange.fmi_export.fmu_writer import PLATFORMS, library_path, write_fmu
from offtrack.exchange.fmi_export.plant_kinds import plant_model
from offtrack.exchange.fmi_export.plant_model import model_identifier
from tests.fmus.hosts import compiled_by_fmpy
from tests.fmus.plants import START, STEP, Slave, deviations, driven_here, driven_there, weave
from vehicle.combination.chain import smooth_ground_sizes
from vehicle.combination.description import Vehicle, load_vehicle, vehicle_names
from vehicle.combination.layout import GroundInputs, ground_input_sizes, slices
from vehicle.combination.plant import Plant, SurfaceLookup, VehicleCommand
from vehicle.frames import FloatArray, Pose2, rotation_zyx
from vehicle.rover.command import RoverCommand
from vehicle.rover.description import load_rover, load_soil, rover_names
from vehicle.rover.plant import RoverPlant
from vehicle.rover.terrain import Terrain
from vehicle.rover.truth import RoverTruth
from vehicle.surface import Roughness, RoughProfile, Surface

MAGIC: Final = {".so": b"\x7fELF", ".dll": b"MZ", ".dylib": b"\xcf\xfa\xed\xfe"}
ROVERS: Final = (("el_dorado_ii", "beach_sand"), ("el_dorado_ii_skid", None), ("six_wheel_rover", "toyoura_sand"))


def check_weave(fmu: Path, vehicle: Vehicle, seconds: float) -> None:
    slave, drive = Slave(fmu, fmu.with_suffix(""), START), weave(seconds)
    found = deviations(driven_here(vehicle, drive), driven_there(slave, vehicle, drive))
    slave.close()
    assert found.pop("wheel_load") < 1e-5  # N, of some 1e5
    assert max(found.values()) < 1e-9


@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize("name", ["eu_tractor_semitrailer", "a_double", "b_double_steered", "rigid_truck"])
def test_a_truck_weaves_as_the_plant_here(name: str, version: int, tmp_path: Path) -> None:
    fmu = tmp_path / "truck.fmu"
    write_fmu(fmu, plant_model(name, None, wind=False), version, ("linux64",), optimisation=1)
    assert validate_fmu(str(fmu)) == []
    check_weave(fmu, load_vehicle(name), 20.0)


@pytest.mark.parametrize("name", [*vehicle_names(), *rover_names()])
def test_every_export_of_the_catalogue_is_valid(name: str, tmp_path: Path) -> None:
    """FMPy's validation, in both versions; and with the inputs of the wind where the vehicle has its data."""
    is_truck = name in vehicle_names()
    winds = (False, True) if is_truck and any(unit.side_wind for unit in load_vehicle(name).units) else (False,)
    for wind in winds:
        model = plant_model(name, None if is_truck else "beach_sand", wind=wind)
        for version in (2, 3):
            fmu = tmp_path / f"{version}{wind}.fmu"
            write_fmu(fmu, model, version, ())
            assert validate_fmu(str(fmu)) == []


def ground_under(lookup: SurfaceLookup, plant: Plant, vehicle: Vehicle, state: FloatArray) -> dict[str, float]:
    kinematics = plant._kinematics_of(state)
    values = lookup.ground_inputs(kinematics)
    ground = GroundInputs(*(values[at] for at in slices(ground_input_sizes(vehicle))))
    heights = lookup.smooth_ground(kinematics)[: smooth_ground_sizes(vehicle).height]
    named = {
        "friction_wheel": ground.friction,
        "ground_slope_x": ground.slope_x,
        "ground_slope_y": ground.slope_y,
        "road_height": ground.road,
        "ground_height": heights,
    }
    return {f"{name}_{k}": float(one) for name, values in named.items() for k, one in enumerate(values, start=1)}


def test_a_truck_on_a_rough_slope_is_the_plant_here(tmp_path: Path) -> None:
    """Grade, cross-fall and a road of class D: the FMU gets them as inputs, the plant looks them up by itself.

    Below 10 m/s the plant looks the ground up once in 10 ms, as the inputs of the FMU hold for 10 ms.
    """
    vehicle, fmu, drive = load_vehicle("eu_tractor_semitrailer"), tmp_path / "truck.fmu", weave(10.0)
    write_fmu(fmu, plant_model(vehicle.name, None, wind=False), 3, ("linux64",), optimisation=1)
    rough = Roughness(profile=RoughProfile(np.random.default_rng(3), "D"))
    surface = Surface(friction=0.7, grade=0.03, cross_fall=0.04, roughness=rough)
    plant, lookup = Plant(vehicle, surface), SurfaceLookup(surface, vehicle)
    state = plant.initial_state(Pose2(1.0, 2.0, 0.3), 6.0)
    at_start = ground_under(lookup, plant, vehicle, state)
    slave = Slave(fmu, tmp_path / "unpacked", {**START, "start_speed": 6.0, **at_start})
    names, truths, rows = slave.outputs, [plant.observe(state, 0)], []
    rows.append(slave.get(names))
    for steer, acceleration, _ in zip(*drive, strict=True):
        slave.set(ground_under(lookup, plant, vehicle, state))
        slave.set({"steer": steer, "acceleration": acceleration})
        slave.step()
        state = plant.step(state, VehicleCommand(float(steer), float(acceleration), ()), 10)
        slave.set(ground_under(lookup, plant, vehicle, state))  # loads and poses follow it at once
        rows.append(slave.get(names))
        truths.append(plant.observe(state, 0))
    slave.close()
    loads = np.array([truth.wheel_loads for truth in truths])
    assert np.abs(np.diff(loads, axis=0)).max() > 100.0  # N within 10 ms: the road is rough
    assert max(abs(truth.velocities[0, 0]) for truth in truths) < 10.0
    found = deviations(truths, dict(zip(names, np.array(rows).T, strict=True)))
    assert found.pop("wheel_load") < 1e-4  # N, of some 1e5
    assert max(found.values()) < 1e-9


@pytest.mark.parametrize(("name", "along"), [("ground_slope_x", 1.0), ("ground_slope_y", 0.0)])
def test_a_slope_pulls_by_gravity_alone(name: str, along: float, tmp_path: Path) -> None:
    """A freely rolling truck that heads along x slows down by g sin(slope) uphill, besides its rolling resistance.

    Across, the downhill wheels carry more: by the height of the centre of gravity.
    """
    fmu, slope = tmp_path / "truck.fmu", 0.05
    write_fmu(fmu, plant_model("eu_tractor_semitrailer", None, wind=False), 2, ("linux64",), optimisation=1)
    speeds, transfers = [], []
    for given in (0.0, slope):
        inputs = {f"{name}_{unit}": given for unit in (1, 2)}
        slave = Slave(fmu, tmp_path / "unpacked", {"start_speed": 5.0, **inputs})
        for _ in range(100):
            slave.step()
        speeds.append(slave.get(["v_x_1"])[0])
        transfers.append(slave.get(["load_transfer_2"])[0])
        slave.close()
    down = 9.81 * math.sin(math.atan(slope))
    assert speeds[0] - speeds[1] == pytest.approx(along * down, abs=0.03)  # the wheels' inertia: 2 % of the mass
    if not along:
        # + when the right wheels carry more; y is to the left, so they stand lower. A rigid body: 2 h/b sin(slope); it
        # also leans on its springs and tyres, which adds a third.
        trailer = load_vehicle("eu_tractor_semitrailer").units[1]
        rigid = 2.0 * trailer.cg_height / trailer.axles[0].track * math.sin(math.atan(slope))
        assert rigid < transfers[1] - transfers[0] < 1.6 * rigid


@pytest.fixture(scope="module")
def semitrailer(tmp_path_factory: pytest.TempPathFactory) -> Path:
    fmu = tmp_path_factory.mktemp("torques") / "truck.fmu"
    write_fmu(fmu, plant_model("eu_tractor_semitrailer", None, wind=False), 3, ("linux64",), optimisation=1)
    return fmu


def rolled(fmu: Path, speed: float, seconds: float, **inputs: float) -> tuple[float, float]:
    """Mean acceleration in the second half of a drive straight ahead [m/s2], and the speed at its end [m/s]."""
    slave = Slave(fmu, fmu.parent / "unpacked", {"start_speed": speed, **inputs})
    speeds = [speed]
    for _ in range(round(seconds / STEP)):
        slave.step()
        speeds.append(slave.get(["v_x_1"])[0])
    slave.close()
    middle = len(speeds) // 2
    return (speeds[-1] - speeds[middle]) / ((len(speeds) - 1 - middle) * STEP), speeds[-1]


def test_torques_of_axles_act_as_forces_at_their_treads(semitrailer: Path) -> None:
    """Force is torque over radius, and wheels add their inertia: J/r2 of 12 wheels, 2 % of the mass.

    A further drive on the driven axle does what the same torque of the driveline does. Brakes act on any axle.
    """
    vehicle = load_vehicle("eu_tractor_semitrailer")
    axles = [axle for unit in vehicle.units for axle in unit.axles]
    mass = vehicle.mass + sum(2.0 * axle.wheel_inertia / axle.wheel_radius**2 for axle in axles)
    driven = next(k for k, axle in enumerate(axles, start=1) if axle.driven)
    radius = axles[driven - 1].wheel_radius
    coasting, _ = rolled(semitrailer, 8.0, 3.0)
    demanded, _ = rolled(semitrailer, 8.0, 3.0, acceleration=0.3)
    driving, _ = rolled(semitrailer, 8.0, 3.0, **{f"drive_torque_{driven}": 0.3 * vehicle.mass * radius})
    assert driving == pytest.approx(demanded, abs=0.01)  # the lag of the driveline has not quite passed
    assert driving - coasting == pytest.approx(0.3 * vehicle.mass / mass, rel=0.02)
    for k, axle in enumerate(axles, start=1):
        braking, _ = rolled(semitrailer, 8.0, 2.0, **{f"brake_torque_{k}": 6000.0})
        assert braking - coasting == pytest.approx(-6000.0 / axle.wheel_radius / mass, rel=0.03), k
    pushed_back, _ = rolled(semitrailer, 8.0, 2.0, **{f"drive_torque_{driven}": -6000.0})
    assert pushed_back - coasting == pytest.approx(-6000.0 / radius / mass, rel=0.03)


def test_brake_torques_hold_a_truck_on_a_slope_and_push_nowhere(semitrailer: Path) -> None:
    """6 % pull 23 kN of 40 t; brakes that could hold 60 kN hold it after 2 cm, in which tyres and brakes wind up."""
    axles = [axle for unit in load_vehicle("eu_tractor_semitrailer").units for axle in unit.axles]
    brakes = {f"brake_torque_{k}": 12_000.0 * axle.wheel_radius for k, axle in enumerate(axles, start=1)}
    slope = {f"ground_slope_x_{unit}": 0.06 for unit in (1, 2)}
    _, held = rolled(semitrailer, 0.0, 12.0, **brakes, **slope)
    _, released = rolled(semitrailer, 0.0, 4.0, **slope)
    _, level = rolled(semitrailer, 0.0, 4.0, **brakes)
    assert abs(held) < 1e-3
    assert released < -1.0
    assert abs(level) < 1e-6


@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize(("name", "soil_name"), ROVERS)
def test_a_rover_winds_as_the_plant_here(name: str, soil_name: str | None, version: int, tmp_path: Path) -> None:
    rover, fmu = load_rover(name), tmp_path / "rover.fmu"
    soil, n = None if soil_name is None else load_soil(soil_name), len(rover.wheels)
    write_fmu(fmu, plant_model(name, soil_name, wind=False), version, ("linux64",), optimisation=1)
    assert validate_fmu(str(fmu)) == []
    plant = RoverPlant(rover, Terrain(), soil)
    state = plant.initial_state(Pose2(1.0, 2.0, 0.3), 0.2)
    start = {**START, "start_speed": 0.2}
    slave = Slave(fmu, tmp_path / "unpacked", start)
    names, sides = slave.outputs, np.sign([wheel.y for wheel in rover.wheels])
    steered = np.array([float(wheel.steered) for wheel in rover.wheels])
    worst = 0.0
    for k in range(2000):
        t = k * STEP
        spin, steer = 0.2 / rover.radius * (1.0 + 0.3 * np.sin(0.5 * t) * sides), steered * 0.2 * np.sin(0.7 * t)
        state = plant.step(state, RoverCommand(tuple(spin), tuple(steer)), 10)
        slave.set({f"wheel_speed_demand_{w + 1}": spin[w] for w in range(n)})
        slave.set({f"steer_demand_{w + 1}": steer[w] for w in range(n)})
        slave.step()
        values = dict(zip(names, slave.get(names), strict=True))
        expected = rover_values(plant.observe(state, 0))
        worst = max(worst, max(abs(values[key] - value) for key, value in expected.items()))
        R = rotation_zyx(values["body_yaw"], values["body_pitch"], values["body_roll"])
        worst = max(worst, float(np.max(np.abs(R - plant.observe(state, 0).X_WB[:3, :3]))))
    slave.close()
    assert worst < 1e-9


def rover_values(truth: RoverTruth) -> dict[str, float]:
    """Outputs that the truth says, by name."""
    names = ("x", "y", "psi", "v_x", "v_y", "yaw_rate", "body_x", "body_y", "body_z")
    single = dict(zip(names, (*truth.pose, *truth.velocity, *truth.X_WB[:3, 3]), strict=True))
    by_wheel: dict[str, FloatArray] = {
        **{f"wheel_{axis}": truth.wheel_positions[:, k] for k, axis in enumerate("xyz")},
        **{f"wheel_v_{way}": truth.wheel_velocities[:, k] for k, way in enumerate(("along", "across"))},
        "wheel_heading": truth.wheel_headings,
        "wheel_speed": truth.wheel_speeds,
        "wheel_turn": truth.wheel_turns,
        "steer_angle": truth.steer,
        "slip_ratio": truth.slip_ratios,
        "slip_angle": truth.slip_angles,
        "sinkage": truth.sinkages,
        "wheel_load": truth.loads,
    }
    numbered = {f"{name}_{w}": v for name, of in by_wheel.items() for w, v in enumerate(of, start=1)}
    return {name: float(value) for name, value in (single | numbered).items()}


@pytest.mark.skipif(shutil.which("cmake") is None, reason="no cmake")
@pytest.mark.parametrize("version", [2, 3])
def test_fmpy_compiles_it_from_its_own_sources(version: int, tmp_path: Path) -> None:
    fmu, vehicle = tmp_path / "truck.fmu", load_vehicle("rigid_truck")
    write_fmu(fmu, plant_model("rigid_truck", None, wind=False), version, (), optimisation=1)
    compiled_by_fmpy(fmu)
    check_weave(fmu, vehicle, 2.0)


@pytest.mark.skipif(importlib.util.find_spec("ziglang") is None, reason="needs the extra zig")
@pytest.mark.parametrize("version", [2, 3])
def test_libraries_of_all_platforms_are_what_they_say(version: int, tmp_path: Path) -> None:
    fmu, model = tmp_path / "truck.fmu", plant_model("rigid_truck", None, wind=False)
    platforms = [name for name, of in PLATFORMS.items() if version == 3 or of.folder_2]
    write_fmu(fmu, model, version, platforms, optimisation=1)
    assert validate_fmu(str(fmu)) == []
    with zipfile.ZipFile(fmu) as archive:
        for name in platforms:
            content = archive.read(library_path(name, version, model_identifier(model.name)))
            assert content.startswith(MAGIC[PLATFORMS[name].suffix])
            assert f"fmi{version}DoStep".encode() in content
