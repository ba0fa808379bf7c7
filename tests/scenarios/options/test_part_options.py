"""Options of parts: a sensor that suits the estimator, brake systems, and the buffer of VISO-OT."""

import pytest

from estimators.off_tracking.viso_ot import VisoOt
from scenarios.assembly.adapters import plant_vehicle, vehicle_of
from scenarios.assembly.trailer_run import assemble
from scenarios.loop.runner import run
from scenarios.options.scenario import Scenario, load_any_scenario, load_scenario
from sensors.messages import BodyPose, CombinationSignals, check_receives


@pytest.mark.parametrize("camera", ["stereo_camera", "ground_cameras"])
def test_cameras_that_an_estimator_can_not_use_are_not_opened(camera: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("scenarios.assembly.trailer_run.built_world", None)
    scenario = load_any_scenario("roundabout", ["off_tracking=truth", f"sensor={camera}"])
    with pytest.raises(ValueError, match=r"off_tracking = truth needs .* BodyPose; the sensor sends StereoFrame"):
        run(scenario, 1)


class _Poses:
    def sample(self, truth: object, /) -> BodyPose | None:
        return None


class _Plain:
    def step(self, memory, message):  # type: ignore[no-untyped-def]
        return memory, message


class _Either(_Plain):
    def step(self, memory: None, message: BodyPose | CombinationSignals) -> None: ...


def test_what_has_no_annotations_or_takes_several_messages_is_accepted() -> None:
    check_receives("x", _Plain(), _Poses())
    check_receives("x", _Either(), _Poses())


# Brake systems


def loaded(vehicle: str, *settings: str) -> Scenario:
    return load_scenario("roundabout", [f"vehicle={vehicle}", *settings])


def test_brake_systems_are_switched_off_in_the_simulated_vehicle() -> None:
    without_abs = plant_vehicle(loaded("eu_tractor_semitrailer", "brakes.abs=false"))
    assert without_abs.brakes is not None
    assert not without_abs.brakes.abs
    without_control = plant_vehicle(loaded("eu_tractor_semitrailer", "brakes.traction_control=false"))
    assert without_control.powertrain is not None
    assert not without_control.powertrain.traction_control
    unchanged = loaded("eu_tractor_semitrailer")
    assert plant_vehicle(unchanged) == vehicle_of(unchanged)


def test_a_vehicle_without_brake_data_has_no_abs() -> None:
    bare = loaded("mobile_crane_5_axle", "brakes.abs=false")
    assert plant_vehicle(bare) == vehicle_of(bare)
    with pytest.raises(ValueError, match=r"brakes.abs = true: the file of vehicle mobile_crane_5_axle has no table"):
        plant_vehicle(loaded("mobile_crane_5_axle", "brakes.abs=true"))


# The options of VISO-OT's buffer: where they go, and where they are refused


def test_parameters_have_one_key() -> None:
    """A scenario hands them on as they are; the key of other estimators' parameters names theirs."""
    given = load_scenario("roundabout", ["viso_ot.smoothing=true", "viso_ot.reversing_distance=35"]).viso_ot
    assert given == VisoOt.Parameters(smoothing=True, reversing_distance=35.0)
    with pytest.raises(ValueError, match=r"estimator\.smoothing: the key is viso_ot\.smoothing"):
        load_scenario("roundabout", ["estimator.smoothing=true"])


def test_resolved_scenario_runs_again_with_any_estimator() -> None:
    scenario = load_scenario("roundabout", ["off_tracking=truth"])
    assert "[viso_ot]" in scenario.to_toml()
    assemble(scenario, 1)
