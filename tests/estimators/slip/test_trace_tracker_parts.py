"""Parts of the trace tracker beside closed forms."""

import math
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from numpy.typing import NDArray

from estimators.slip.trace_tracker import path_state, tracker
from estimators.slip.trace_tracker.path_state import OFFSET, PIECES, QUICK, PathState
from estimators.slip.trace_tracker.templates import (
    AZIMUTHS,
    CHANNELS,
    SEARCH,
    SHADOWS,
    STEP,
    WIDTH,
    Curve,
    GroundPatch,
    Profiles,
    at_slips,
    channels,
    correlation,
    likely,
    place,
    rut_score,
    shipped_templates,
    unit,
    unknown_sun,
    weighed,
    windows,
)
from estimators.slip.trace_tracker.tracker import Find, Grip, Pursuit, begun
from estimators.slip.trace_tracker.tracker import judged as pursuit_after
from sensors.sand.trace_rig import nominal_rig
from tools.trace_templates import Lesson, learned
from vehicle.frames import FloatArray, inverse
from vehicle.rover.description import load_rover

RIG = nominal_rig(load_rover("el_dorado_ii"))
BEHIND = np.linspace(0.12, 0.6, 13)


PIECE = 0.016  # [m]


def moved(state: PathState, yaw: float, steer: float, k: int) -> PathState:
    """One piece on, after which the compass reads what the heading is."""
    state = path_state.moved(state, PIECE, yaw, 0.2, steer, 200 * k)
    return path_state.with_fronts(state, RIG)


def with_straight_piece(k: int, state: PathState) -> PathState:
    return path_state.with_compass(moved(state, 0.0, 0.0, k), 0.0)


def driven(slip: float, yaw: float, pieces: int = 60) -> PathState:
    """After pieces of 16 mm with a slip and a yaw on each [rad], as encoders tell of them."""
    state = path_state.with_slip(path_state.begun(0.3, 0.0, 0, len(BEHIND), QUICK), slip, 0.05)
    for k in range(1, pieces + 1):
        state = moved(state, yaw, 0.0, k)
    return state


def test_straight_drive_with_slip_leaves_a_straight_slanting_trace() -> None:
    """A wheel that slips to the left by alpha leaves its trace to the right behind it, at tan(alpha) of the way."""
    slip = math.radians(8.0)
    assert path_state.trace(driven(slip, 0.0), RIG, BEHIND) == pytest.approx(-math.tan(slip) * BEHIND, abs=1e-9)


def test_turning_without_slip_leaves_the_arc_of_the_rear_wheel() -> None:
    """About a centre beside the rover's middle the rear wheel goes round on its own circle, which is known."""
    yaw = math.radians(0.4)
    centre = PIECE / yaw  # to the left of R's origin
    x, y = RIG.wheel
    radius = math.hypot(x, centre - y)
    circle = centre - np.sqrt(radius**2 - (x - BEHIND) ** 2) - y
    assert path_state.trace(driven(0.0, yaw), RIG, BEHIND) == pytest.approx(circle, abs=1e-4)  # pieces are chords


def test_crab_steering_turns_the_trace_and_not_the_slip() -> None:
    """Wheels at 5 deg that do not slip lead straight along 5 deg: the trace slants, the slip stays 0."""
    steer = math.radians(5.0)
    state = path_state.with_slip(path_state.begun(0.3, steer, 0, len(BEHIND), QUICK), 0.0, 0.05)
    for k in range(1, 61):
        state = moved(state, 0.0, steer, k)
    assert path_state.trace(state, RIG, BEHIND) == pytest.approx(-math.tan(steer) * BEHIND, abs=1e-9)
    assert path_state.slip_at(state, 0)[0] == 0.0


def test_every_piece_keeps_the_steering_under_which_it_was_driven() -> None:
    """After a change from 0 to 5 deg the new part of the trace slants and the old one lies parallel to the body."""
    state = driven(0.0, 0.0)
    for k in range(61, 77):
        state = moved(state, 0.0, math.radians(5.0), k)
    lies = path_state.trace(state, RIG, BEHIND)
    far = BEHIND > 0.3
    bent = -math.sin(math.radians(5.0)) * 15.5 * PIECE  # the piece of the change is driven at half of it
    assert lies[far] == pytest.approx(np.full(far.sum(), bent), abs=2e-4)


def test_gradient_of_the_trace_is_its_derivative() -> None:
    """At any slip history, against central differences; neglected: the shift along the way, sin(angle) of 10 deg."""
    state = driven(math.radians(5.0), math.radians(0.1))
    _, gradient = path_state.predicted(state, RIG, BEHIND)
    for part in (0, 7, 20, PIECES, PIECES + 4, 2 * PIECES + 9, 3 * PIECES + 1, len(state.mean) + OFFSET):
        step = np.zeros(len(state.mean))
        step[part] = 1e-6
        up, _ = path_state.predicted(state._replace(mean=state.mean + step), RIG, BEHIND)
        down, _ = path_state.predicted(state._replace(mean=state.mean - step), RIG, BEHIND)
        near = 0.035 * max(1.0, abs(gradient[:, part]).max())
        assert gradient[:, part] == pytest.approx((up - down) / 2e-6, abs=near)


def test_filter_finds_slip_from_where_the_trace_lies() -> None:
    """Exact places of a straight trace of 6 deg, believed to be one of 2 deg, draw the slip there in a metre."""
    state, slip = driven(math.radians(2.0), 0.0), math.radians(6.0)
    for k in range(61, 125):
        state = path_state.with_compass(moved(state, 0.0, 0.0, k), 0.3)
        expected, gradient = path_state.predicted(state, RIG, BEHIND)
        there = -math.tan(slip) * BEHIND - expected
        state, _ = path_state.with_innovation(state, gradient, there, 9e-6 * np.eye(len(BEHIND)))
    found, variance = path_state.slip_at(state, 0)
    assert found == pytest.approx(slip, abs=math.radians(0.3))
    assert math.radians(0.3) < math.sqrt(variance) < math.radians(2.0)


@pytest.mark.parametrize(("slips", "quick"), [((0.0, 0.0), False), ((6.0, -6.0), True)])
def test_pace_that_fits_what_slip_does_gets_the_larger_share(slips: tuple[float, float], quick: bool) -> None:
    """Exact places of a trace whose slip is steady, or swings by 12 deg every 16 cm, which a steady one would not."""
    both = path_state.with_new_trace(path_state.begun_histories(0.0, 0.0, 0, len(BEHIND)), 0.0, 0.05)
    true = path_state.with_slip(path_state.begun(0.0, 0.0, 0, len(BEHIND), QUICK), 0.0, 0.05)
    every = np.ones(len(BEHIND), dtype=bool)
    for k in range(1, 120):
        true = moved(true, 0.0, 0.0, k)
        true.mean[0] = math.radians(slips[k // 10 % 2])
        both = both.each(partial(with_straight_piece, k))
        lies = path_state.trace(true, RIG, BEHIND)
        predictions = [path_state.predicted(path, RIG, BEHIND) for path in both.paths]
        both = path_state.with_trace(both, predictions, lies, every, 9e-6 * np.eye(len(BEHIND)))
    assert both.paths[0].pace is QUICK
    assert bool(both.shares[0] > 0.5) is quick


def test_front_rut_lies_aside_by_the_slip_of_a_straight_drive() -> None:
    """Straight on with slip alpha the front rut lies a wheelbase times sin(alpha) beside the rear one, by geometry."""
    slip = math.radians(9.0)
    fronts = path_state.fronts_at(driven(slip, 0.0, 120), RIG, BEHIND)
    assert fronts == pytest.approx(np.full(len(BEHIND), math.atan(math.sin(slip))), abs=1e-6)


def test_wheel_goes_where_a_rigid_body_takes_it() -> None:
    """Turning about a centre on the rear axle, the rear wheel goes straight ahead and the middle aside (eq. 2)."""
    radius = 2.0  # from the centre to the middle of the rear axle
    slip, rate = math.atan2(-RIG.wheel[0], radius), 1.0 / math.hypot(radius, RIG.wheel[0])
    assert tracker.wheel_direction(RIG, slip, rate) == pytest.approx(0.0, abs=1e-12)
    assert tracker.wheel_direction(RIG, 0.1, 0.0) == pytest.approx(0.1, abs=1e-12)


def test_places_on_the_ground_keep_their_place_in_the_patch() -> None:
    """A dot drawn where the lens shows a place on the ground appears in that row and column, to half a cell."""
    patch = GroundPatch(rig=RIG)
    for row, column in ((20, 160), (100, 60), (200, 230)):
        x, y = RIG.wheel[0] - patch.behind[row], RIG.wheel[1] + STEP * (column - patch.columns // 2)
        seen = inverse(RIG.X_RC) @ [x, y, 0.0, 1.0]
        u, v = RIG.camera.project(seen[None, :3])[0]
        vv, uu = np.mgrid[0:480, 0:640]
        image = np.rint(255.0 * np.exp(-0.5 * ((uu - u) ** 2 + (vv - v) ** 2) / 3.0**2)).astype(np.uint8)
        got = patch.rectified(image).astype(float)
        rows, columns = np.indices(got.shape)
        assert (got * rows).sum() / got.sum() == pytest.approx(row, abs=0.5)
        assert (got * columns).sum() / got.sum() == pytest.approx(column, abs=0.5)


def test_rows_begin_behind_the_wheel() -> None:
    """Ground hidden by the wheel is not part of the patch."""
    patch = GroundPatch(rig=RIG)
    assert patch.behind[0] > RIG.wheel_radius
    assert 0.55 < patch.behind[-1] < 0.66  # the camera sees to 0.63 m


def test_camera_that_looks_elsewhere_is_refused() -> None:
    """A camera a metre ahead of the wheel sees nothing of its trace."""
    X_RC = RIG.X_RC.copy()
    X_RC[0, 3] += 1.0
    with pytest.raises(ValueError, match="behind the wheel"):
        GroundPatch(rig=replace(RIG, X_RC=X_RC))


def test_a_circle_on_the_ground_is_straight_in_the_image_along_it() -> None:
    """And its rows lie square to it, as far apart as on the ground: spokes of the circle are rows of the image."""
    patch, radius = GroundPatch(rig=RIG), 1.5
    (x, y), at = RIG.wheel, -radius  # the centre lies to the right of the wheel
    vv, uu = np.mgrid[0:480, 0:640]
    rays = RIG.camera.rays(np.stack([uu, vv], axis=-1).astype(float))
    seen = np.concatenate([rays, np.ones((480, 640, 1))], axis=-1) @ RIG.X_RC[:3, :3].T
    ground = RIG.X_RC[:3, 3] + seen * (-RIG.X_RC[2, 3] / seen[..., 2:])
    behind, lateral = x - ground[..., 0], ground[..., 1] - y
    around, off = radius * np.arctan2(behind, lateral - at), np.hypot(behind, lateral - at) - radius
    image = np.where(np.abs(off) < 0.01, 220, np.where(around % 0.1 < 0.05, 60, 120)).astype(np.uint8)
    curve = Curve.through(patch.behind, np.sqrt(radius**2 - patch.behind**2) + at)
    got = patch.along(curve, image, 40).astype(float)
    middle = np.where(got > 180.0, np.arange(81.0), np.nan)
    assert np.nanmean(middle, axis=1) == pytest.approx(np.full(len(got), 40.0), abs=0.6)
    edges = np.flatnonzero(np.diff((got[:, [10, 70]] > 90.0).astype(int), axis=0).any(axis=1))
    turns = np.diff(edges)[np.diff(edges) > 5] * STEP
    assert turns == pytest.approx(np.full(len(turns), 0.05), abs=0.005)


def test_matching_finds_a_shift_to_a_tenth_of_a_cell() -> None:
    """Smooth profiles shifted by 3.4 cells; a parabola through three correlations is good to some hundredths."""
    rng = np.random.default_rng(3)
    t = np.arange(WIDTH + 2.0 * SEARCH) - SEARCH - WIDTH // 2
    phases = rng.uniform(0, 6, (2, CHANNELS, 4))

    def profiles(at: FloatArray) -> Profiles:
        waves = [np.sin(at / (4.0 + 2 * k) + phases[..., k, None]) for k in range(4)]
        return np.asarray(np.sum(waves, axis=0), dtype=np.float32)

    template = profiles(t)[..., SEARCH : SEARCH + WIDTH]
    off, score = place(correlation(windows(profiles(t - 3.4)), unit(template)), np.full(2, 0.1))
    assert off == pytest.approx(3.4 * STEP, abs=0.1 * STEP)
    assert (score > 0.95).all()


@pytest.mark.parametrize("sun", [(3, 0), (17, 2)])
def test_sun_is_found_from_ruts_in_several_directions(sun: tuple[int, int]) -> None:
    """Ruts as that sun shows them, in bends and straights: it becomes the likeliest, and its profiles are expected."""
    templates, told = shipped_templates(), unknown_sun()
    only = np.full_like(told, -50.0)
    only[sun] = 0.0
    slips = np.radians([-4.0, 0.0, 5.0])
    under = at_slips(templates.profiles, slips)
    for direction in np.radians([0.0, 40.0, 100.0, 220.0]):
        directions = direction + np.radians([0.0, 6.0, 12.0])
        told = weighed(told, under, unit(likely(under, only, directions)), directions)
    assert told[sun] == told.max()
    assert likely(under, only, np.zeros(3)) == pytest.approx(under[sun], abs=1e-6)  # the same azimuth as in the world


def test_the_ground_shows_how_far_it_moved() -> None:
    """A texture moved on by 7.3 rows; that of other ground tells nothing."""
    rng = np.random.default_rng(4)
    rows, spread = np.arange(240.0), rng.uniform(0.1, 0.9, (8, 25))
    phase = rng.uniform(0.0, 6.0, (8, 25))

    def rut(moved: float) -> NDArray[np.float32]:
        waves = np.sin(spread * (rows[:, None, None] - moved) + phase)
        return np.asarray(waves.sum(axis=1), dtype=np.float32)

    assert tracker.shift(rut(0.0), rut(7.3), 8.0 * STEP) == pytest.approx(7.3 * STEP, abs=0.1 * STEP)
    other = rng.normal(size=(240, 25)).astype(np.float32)
    assert tracker.shift(rut(0.0), other, 8.0 * STEP) is None


@pytest.mark.parametrize("radius", [2.0, -1.5])
def test_way_of_the_centre_follows_from_that_of_a_wheel(radius: float) -> None:
    """Both go round one centre of rotation, which a slip angle moves forward or back."""
    slip, yaw = 0.06, 0.008 * math.copysign(1.0, radius)
    centre = radius * np.array([-math.sin(slip), math.cos(slip)])
    way = abs(yaw) * math.dist(centre, RIG.wheel)
    assert tracker.way_of_centre(RIG, way, yaw, slip) == pytest.approx(abs(yaw * radius), rel=1e-9)


def test_slip_ratio_is_drawn_to_what_the_ground_shows() -> None:
    """Readings of 0.0 +- 0.02 win within some images, an impossible one does not; unseen it is forgotten.

    On the way the ratio has changed, as on uneven ground. A turn on a slope explains that as well.
    """
    straight = turning = Grip(0.0, 0.07**2, 0.0, 0.0).measured(0.1, 0.02)
    for _ in range(20):
        straight = straight.rolled(0.016, 0.0).measured(0.0, 0.02)
        turning = turning.rolled(0.016, 0.05).measured(0.0, 0.02)
    assert straight.ratio == turning.ratio == pytest.approx(0.0, abs=0.01)
    assert straight.measured(0.4, 0.02) == straight
    assert straight.rolled(20.0, 0.0).variance == pytest.approx(0.07**2, rel=0.01)
    assert straight.uneven > 0.01**2
    assert turning.uneven == 0.0


def test_templates_are_the_same_in_a_mirror() -> None:
    """Slip and sun from the other side make the mirrored profile: what learns both can not prefer one."""
    rng = np.random.default_rng(5)
    n = 40
    one = Lesson(
        profiles=rng.normal(size=(n, CHANNELS, WIDTH)).astype(np.float32),
        slips=rng.uniform(-0.25, 0.25, n),
        azimuths=rng.uniform(0, 6.3, n),
        shadow=float(SHADOWS[0]),
        shaded=rng.random(n) < 0.3,
    )
    for templates in (learned([one]), shipped_templates()):
        level = templates.profiles[:, 0]
        near = 0.02 * float(np.abs(level).max())
        turned = level[np.arange(AZIMUTHS) * -1 % AZIMUTHS][:, ::-1, :, ::-1]
        assert level == pytest.approx(turned, abs=near)  # a byte's rounding in the shipped ones
        assert templates.shaded == pytest.approx(templates.shaded[::-1, :, ::-1], abs=near)


def test_a_lesson_teaches_the_sun_that_it_has_seen() -> None:
    """The mirrored sun of the other side gets the mirrored profile."""
    seen = np.random.default_rng(6).normal(size=(1, CHANNELS, WIDTH)).astype(np.float32)
    quarter = np.array([0.5 * math.pi])
    one = Lesson(profiles=seen, slips=np.zeros(1), azimuths=quarter, shadow=float(SHADOWS[0]), shaded=np.zeros(1, bool))
    level = learned([one]).profiles[:, 0].sum(axis=1)
    assert np.vdot(level[AZIMUTHS // 4], seen) > 2.0 * abs(np.vdot(level[-AZIMUTHS // 4], seen))


@pytest.mark.parametrize("level", [0, 128, 255])  # a black edge, dirt, glare
@pytest.mark.parametrize("turned", [0, 1, 2, 3])
def test_an_area_of_one_grey_level_beside_sand_has_no_contrast(level: int, turned: int) -> None:
    """Its variance is zero: the running sums of a mean over float numbers end a rounding error below it."""
    patch = np.rot90(np.random.default_rng(1).integers(60, 200, (300, 300)).astype(np.uint8), turned).copy()
    flat = np.rot90(np.arange(300) >= 150 + np.zeros((300, 1)), turned)
    patch[flat] = level
    seen = channels(patch)
    assert np.isfinite(seen).all()
    inner = np.rot90(np.arange(300) >= 240 + np.zeros((300, 1)), turned)  # no window reaches the sand
    assert np.abs(seen[inner]).max() < 0.01


def test_lug_marks_tell_a_rut_from_a_shadow() -> None:
    """Of two lines with the same mean correlation the one with marks is more like a rut; without, it is 3/4 of it."""
    shadow, rut = rut_score(np.array([0.4, 0.4]), np.array([0.0, 0.4]))
    assert (shadow, rut) == pytest.approx((0.3, 0.4), abs=1e-12)


def judged(pictures: list[tuple[float, float]], marks: float = 0.4) -> Pursuit:
    """Of a trace found with such marks, after images with a rut score and marks."""
    pursuit = begun(Find(0.0, 0.5, marks))
    for picture in pictures:
        pursuit = pursuit_after(pursuit, *picture)
    return pursuit


def test_a_trace_is_believed_after_three_pictures_with_clear_marks() -> None:
    """Chance marks are gone in the next picture; what was never sure is given up the first time it is not seen."""
    assert not judged([(0.5, 0.5)] * 2).visible
    assert judged([(0.5, 0.5)] * 3).visible
    faint = judged([(0.5, 0.0)] * 3)
    assert not faint.visible
    assert faint.lost


def test_a_trace_that_is_known_may_be_unseen_for_a_second() -> None:
    """Four pictures without it may be a shadow; five running are the end of it, and one with it begins anew.

    So is a line that leads into a shadow's edge: as like a rut as ever on the whole, but no lug was there.
    """
    known = [(0.5, 0.7)] * 5
    assert not judged([*known, (0.2, 0.5)]).visible
    assert not judged(known + [(0.2, 0.5)] * 4).lost
    assert judged(known + [(0.2, 0.5)] * 5).lost
    assert judged(known + [(0.2, 0.5)] * 4 + known[:1]).visible
    assert judged(known + [(0.5, 0.1)] * 15).lost
