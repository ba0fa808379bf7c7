"""The trace tracker on simulated sand that its templates have not been learned from."""

import math
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import pytest

from estimators.estimates import Health, SlipAngle
from estimators.slip.trace_tracker.tracker import FTracePlus
from sensors.camera.rig import CameraModel
from sensors.messages import RoverView
from sensors.sand.rover_pass import Labelled, RoverPass, labelled_sequence, recorded
from sensors.sand.trace_rig import TraceRig, nominal_rig
from vehicle.rover.description import load_rover
from vehicle.rover.terrain import Terrain
from vehicle.rover.truth import RoverTruth

ROVER = load_rover("el_dorado_ii")
RIG = nominal_rig(ROVER)
LEAD = 45  # moments before the first picture: the trace grows as long as the view


@pytest.fixture(scope="module")
def trace() -> list[Labelled]:
    """Eleven seconds on pebbles, the slip beginning."""
    return list(labelled_sequence("pebbles", seed=71, frames=55, rover=ROVER, profile="fast", bare=0.0))


@pytest.fixture(scope="module")
def estimates(trace: list[Labelled]) -> list[SlipAngle]:
    return run(RIG, [moment.view for moment in trace])


def run(rig: TraceRig, views: list[RoverView]) -> list[SlipAngle]:
    tracker = FTracePlus(rig)
    memory, got = tracker.init(), []
    for view in views:
        memory, estimate = tracker.step(memory, view)
        got.append(estimate)
    return got


@pytest.mark.slow
def test_a_trace_is_found_within_a_second_and_not_lost(estimates: list[SlipAngle]) -> None:
    """All of the view shows the rut from the first picture on; finding it takes two pictures."""
    assert all(estimate.health is Health.OK for estimate in estimates[4:])


def test_slip_is_right_within_the_stated_uncertainty(trace: list[Labelled], estimates: list[SlipAngle]) -> None:
    """Errors of the body's slip angle stay below 1.5 deg RMS (1.0 over long sequences) and within 2.5 sigma."""
    errors = np.array([e.value - t.trace.slip_angle for e, t in zip(estimates[8:], trace[8:], strict=True)])
    sigmas = errors / [e.std for e in estimates[8:]]
    assert np.degrees(np.sqrt((errors**2).mean())) < 1.5
    assert (np.abs(sigmas) < 2.5).mean() > 0.9  # of 47 correlated ones; 95 % over long sequences


def test_slip_two_seconds_ago_is_known_better(trace: list[Labelled], estimates: list[SlipAngle]) -> None:
    """The trace made since then shows where the wheel went: 40 % of the variance is gone."""
    truths = {moment.trace.tick: moment.trace.slip_angle for moment in trace}
    known = [e for e in estimates[25:] if e.lagged_tick in truths]
    assert len(known) > 20
    for estimate in known:
        assert estimate.lagged_tick is not None
        assert estimate.tick - estimate.lagged_tick == pytest.approx(2000, abs=250)
        assert estimate.lagged_std < 0.775 * estimate.std
    errors = [e.lagged_value - truths[e.lagged_tick] for e in known if e.lagged_tick is not None]
    assert np.degrees(np.sqrt(np.mean(np.square(errors)))) < 1.0  # 0.7 over long sequences


def test_slip_may_have_changed_while_no_image_came(trace: list[Labelled]) -> None:
    """After 0.3 m without images the error lies within a sigma that is larger than before."""
    seen = [*trace[:25], *trace[44:]]
    estimates = run(RIG, [moment.view for moment in seen])
    assert estimates[25].std > 1.1 * estimates[24].std
    for estimate, moment in zip(estimates[25:], seen[25:], strict=True):
        assert abs(estimate.value - moment.trace.slip_angle) < 2.5 * estimate.std


@pytest.mark.slow
def test_bare_sand_shows_no_trace() -> None:
    """On a crust the wheels leave nothing: stones, relief and the rover's shadow must not be taken for a rut."""
    bare = [m.view for m in labelled_sequence("shadows", seed=72, frames=25, rover=ROVER, profile="fast", bare=0.99)]
    for estimate in run(RIG, bare):
        assert estimate.health is Health.LOST
        assert estimate.value == 0.0
        assert math.isinf(estimate.std)


def test_stripes_of_shadow_that_move_with_the_rover_are_no_trace() -> None:
    """A mast's shadow as wide as a wheel has walls and is dark inside like a rut; but no lug has left marks in it."""
    rows, columns = np.mgrid[0:480, 0:640]
    stripe = np.abs(columns - 330.0 + 0.30 * rows) < 60.0  # from the wheel on, 0.1 m wide
    moments = list(labelled_sequence("uniform", seed=74, frames=12, rover=ROVER, profile="none", bare=0.99))
    images = [np.where(stripe, 0.5 * m.view.image, m.view.image).astype(np.uint8) for m in moments]
    views = [replace(m.view, image=image) for m, image in zip(moments, images, strict=True)]
    assert all(estimate.health is Health.LOST for estimate in run(RIG, views))


@dataclass(frozen=True, slots=True, kw_only=True)
class Crab(RoverPass):
    """All wheels turn by 5 deg within 3 s while their slip stays the same."""

    SLIP: ClassVar = math.radians(4.0)

    def steer(self) -> np.ndarray:
        """Of all wheels at every moment [rad]."""
        return np.interp(np.arange(self.frames), (LEAD + 35, LEAD + 50), (0.0, math.radians(-5.0)))

    def slip_angles(self, rng: np.random.Generator) -> np.ndarray:
        """The body goes where the wheels are steered to, and aside of that by their slip."""
        return self.steer() + self.SLIP

    def steered(self) -> list[RoverTruth]:
        """The truth with the steering in it."""
        truths = self.truths(ROVER, Terrain(), np.random.default_rng(5))
        return [
            replace(
                truth,
                steer=np.full(4, angle),
                wheel_headings=truth.wheel_headings + angle,
                slip_angles=truth.slip_angles - angle,
            )
            for truth, angle in zip(truths, self.steer(), strict=True)
        ]


@pytest.mark.slow
def test_steering_is_not_taken_for_slip() -> None:
    """Wheels that are turned by 5 deg lead the trace elsewhere; encoders know, and slip stays what it was.

    The body's own slip angle changes by all of the 5 deg, which would be an RMS of more than 3 deg if it were missed.
    """
    crab = Crab(frames=LEAD + 75, profile="none")
    rng = np.random.default_rng(73)
    moments = list(recorded(crab.steered(), "uniform", rng=rng, rover=ROVER, terrain=Terrain(), lead=LEAD))
    estimates = run(RIG, [moment.view for moment in moments])
    body = [e.value - m.trace.slip_angle for e, m in zip(estimates, moments, strict=True)]
    wheel = [e.wheel_slip - m.trace.wheel_slip for e, m in zip(estimates, moments, strict=True)]
    for errors in (body, wheel):
        settled = np.array(errors[25:])
        change = settled - settled[:10].mean()
        assert np.degrees(np.sqrt((change**2).mean())) < 0.8  # two independent estimates of 0.5 make 0.7
    assert moments[-1].trace.slip_angle - moments[0].trace.slip_angle == pytest.approx(math.radians(-5.0), abs=1e-3)


def test_mirrored_world_has_mirrored_slip(trace: list[Labelled], estimates: list[SlipAngle]) -> None:
    """Swapping left and right flips every lateral quantity; 1/32 px and bytes move peaks by 0.4 mm in 0.14 m."""
    lens, flip = RIG.camera, np.diag([1.0, -1.0, 1.0, 1.0])
    k1, k2, p1, p2, k3 = lens.distortion
    camera = CameraModel(
        width=lens.width,
        height=lens.height,
        fx=lens.fx,
        fy=lens.fy,
        cx=lens.width - 1 - lens.cx,
        cy=lens.cy,
        distortion=(k1, k2, p1, -p2, k3),
    )
    X_RC = flip @ RIG.X_RC @ np.diag([-1.0, 1.0, 1.0, 1.0])
    rig = replace(RIG, camera=camera, X_RC=X_RC, wheel=(RIG.wheel[0], -RIG.wheel[1]))
    for estimate, other in zip(run(rig, [mirrored(m.view) for m in trace[:12]]), estimates, strict=False):
        assert estimate.health is other.health
        assert estimate.value == pytest.approx(-other.value, abs=math.radians(0.2))
        assert estimate.trace_offset == pytest.approx(-other.trace_offset, abs=4e-4)


def mirrored(view: RoverView) -> RoverView:
    """The view of a rover in a mirror: its left wheels are the right ones."""
    return replace(
        view,
        image=np.ascontiguousarray(view.image[:, ::-1]),
        heading=-view.heading,
        wheel_speeds=view.wheel_speeds[[1, 0, 3, 2]],
        steer=-view.steer,
    )


def test_a_rover_that_stands_keeps_its_estimate(trace: list[Labelled]) -> None:
    """A picture of the same sand says nothing new: its errors are the same, the uncertainty must not shrink."""
    tracker = FTracePlus(RIG)
    memory = tracker.init()
    for moment in trace[:10]:
        memory, estimate = tracker.step(memory, moment.view)
    last = trace[9].view
    for k in range(1, 4):
        standing = replace(last, tick=last.tick + 200 * k, wheel_speeds=np.zeros(4))
        memory, again = tracker.step(memory, standing)
        assert again is estimate
