"""A sensor that sends other messages than the estimator needs is refused before the run."""

from __future__ import annotations

import pytest

from scenarios.loop.runner import run
from scenarios.options.scenario import load_any_scenario
from sensors.messages import BodyPose, CombinationSignals, check_receives


@pytest.mark.parametrize(
    ("scenario", "settings", "says"),
    [
        ("rover-slope", ["slip_estimator=truth", "sensor=trace_camera"], "slip_estimator = truth needs .* SlipReading"),
        ("rover-slope", ["slip_estimator=ftrace", "sensor=slip_reading"], "ftrace needs .* RoverView"),
        ("roundabout", ["off_tracking=truth", "sensor=combination_signals"], "off_tracking = truth needs .* BodyPose"),
        ("roundabout", ["off_tracking=kinematic", "sensor=reference_pose"], "kinematic needs .* CombinationSignals"),
    ],
)
def test_a_sensor_of_other_messages_is_refused(scenario: str, settings: list[str], says: str) -> None:
    with pytest.raises(ValueError, match=says):
        run(load_any_scenario(scenario, settings), 1)


@pytest.mark.parametrize("camera", ["stereo_camera", "ground_cameras"])
def test_cameras_that_an_estimator_can_not_use_are_not_opened(camera: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Their world takes half a minute to build."""
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
