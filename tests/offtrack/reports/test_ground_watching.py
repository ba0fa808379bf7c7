"""Ground-watching and the reference unit as a scenario asks for them: from the options to the log."""

from collections.abc import Iterator

import numpy as np
import pytest

from scenarios.assembly.trailer_sensors import wheels_near
from scenarios.loop.runner import run
from scenarios.options.scenario import load_scenario
from scenarios.results.run_summary import number_at
from scenarios.results.trailer_result import RunResult, error_of_estimate
from scenarios.results.trailer_signals import ReferenceOffTracking
from tests import trailers
from vehicle.combination.description import load_vehicle
from vehicle.combination.truth import Truth
from vehicle.frames import rotation_zyx, transform

# A trailer dragged along at 2 deg of slip: its rear is 0.49 m beside the hitch's path, in sight of the rear camera.
DRAGGED = ("course.slip_angle_deg=2", "course.length=30", "off_tracking=ground_watching", "world.scenery_density=0")
SMALL = ("ground_rig.width=320", "ground_rig.height=320")


pytestmark = pytest.mark.usefixtures("worlds")


@pytest.fixture(scope="module")
def dragged() -> RunResult:
    return run(load_scenario("constant-slip", (*DRAGGED, *SMALL)), seed=1)


@pytest.mark.slow
def test_ground_watching_measures_a_dragged_trailer_to_20_mm(dragged: RunResult) -> None:
    """The bar for dry tarmac, at 18 km/h with half-size images: 0.5 m between frames that show 1.4 m."""
    error = error_of_estimate(dragged)
    assert np.isfinite(error).sum() > 25
    assert np.nanmax(np.abs(error)) < 0.02
    assert dragged.summary()["off_tracking"]["valid_fraction"] == 1.0  # type: ignore[index, call-overload]  # a table by its key
    assert dragged.signal("off_tracking_true")[-1] == pytest.approx(-14.0 * np.tan(np.radians(2.0)), rel=1e-3)


@pytest.mark.slow
def test_the_reference_unit_stands_beside_the_truth(dragged: RunResult) -> None:
    """Every tenth message of 100 Hz gives a value once the buffer is full; their RMS is roughly that of the unit."""
    reference = dragged.signal("off_tracking_reference")
    late = np.isfinite(reference) & ~np.isfinite(error_of_estimate(dragged))
    assert np.flatnonzero(late).tolist() == [len(reference) - 1]  # the last picture's estimate is still on its way
    for name in ("reference_error_rms_m", "estimate_against_reference_rms_m"):
        assert 0.002 < (number_at(dragged.summary(), f"off_tracking.{name}") or 0.0) < 0.04


def test_without_a_reference_unit_there_is_no_column() -> None:
    settings = ("off_tracking=truth", "course.length=20", "reference_unit=false")
    result = run(load_scenario("constant-slip", settings), seed=1)
    assert "off_tracking_reference" not in result.log
    numbers = result.summary()["off_tracking"]
    assert isinstance(numbers, dict)
    assert numbers["reference_error_rms_m"] is None


def circle() -> Iterator[Truth]:
    """A trailer once and a half round a circle of 20 m at 4 m/s, 10 ms apart; its yaw keeps to the path."""
    for k in range(4700):
        angle = 4.0 * 0.01 * k / 20.0
        x, y = 20.0 * np.sin(angle), 20.0 - 20.0 * np.cos(angle)
        X_WS, poses = transform(rotation_zyx(angle, 0.0, 0.0), np.array([x, y, 0.0])), np.array([[x, y, angle]])
        yield trailers.truth(10 * k, bodies=X_WS[None], poses=poses, velocities=np.array([[4.0, 0.0, 0.2]]))


@pytest.mark.slow
def test_the_reference_units_off_tracking_is_within_30_mm() -> None:
    """The estimate of de Saxe & Cebon 2018, section 4.1, for theirs; the RMS over seeds of 40 s of drifting each."""
    truths = list(circle())
    exact = 20.0 - np.sqrt(20.0**2 - 14.0**2)  # the circle beside the follow point, left of the axis
    rms = []
    for seed in range(4):
        unit = ReferenceOffTracking(unit=0, follow_distance=14.0, path_height=0.0, rng=np.random.default_rng(seed))
        values = unit.values(truths)
        assert np.isfinite(values[400::10]).all()
        assert np.isnan(values[405])
        rms.append(np.sqrt(np.nanmean((values - exact) ** 2)))
    assert 0.008 < np.sqrt(np.mean(np.square(rms))) < 0.030


def test_wheels_that_reform_the_ground_are_the_trailers_and_the_last_ahead_of_it() -> None:
    """Three axles of the trailer and the tractor's drive axle, 0.774 m behind the kingpin; both sides of each."""
    ahead, own = wheels_near(load_vehicle("uk_longer_semitrailer"), 1)
    np.testing.assert_allclose(ahead, [[-0.7744762, 1.02], [-0.7744762, -1.02]])
    np.testing.assert_allclose(own[::2], [[-8.0, 1.02], [-9.31, 1.02], [-10.62, 1.02]])
    np.testing.assert_allclose(own[1::2], own[::2] * [1.0, -1.0])


@pytest.mark.slow
def test_reformed_ground_reaches_the_cameras() -> None:
    """With strips of 2.2 m the rear camera sees other ground behind the axles, and doubts are raised throughout."""
    result = run(load_scenario("constant-slip", (*DRAGGED, *SMALL, "surface.reformed_width=2.2")), seed=1)
    health = result.signal("health")
    known = health[np.isfinite(result.signal("off_tracking_estimate"))]
    assert len(known) > 25
    assert (known == 1.0).all()  # degraded
