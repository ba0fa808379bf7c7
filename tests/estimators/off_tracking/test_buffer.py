"""The off-tracking buffer on exact and on uncertain motions."""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import brentq

from estimators.estimates import Health, OffTracking
from estimators.off_tracking.buffer import BodyMotion, BufferMemory, OffTrackingBuffer
from tests.estimators.body_drive import anchored_motions, body, disturbed, followed, motion, winding
from vehicle.frames import FloatArray, Pose2, inverse, rotation_zyx, transform

LENGTH = 14.0  # hitch to follow point [m]
STEP = 0.1  # [m]


def motions(bodies: Iterable[FloatArray], health: Health = Health.OK) -> list[BodyMotion]:
    """Exact motions between bodies that are one frame apart."""
    return [motion(k, k + 1, inverse(a) @ b, health) for k, (a, b) in enumerate(pairwise(bodies))]


def run(sequence: Iterable[BodyMotion], length: float = LENGTH) -> tuple[BufferMemory, list[OffTracking]]:
    return followed(OffTrackingBuffer(length), sequence)


def straight(slip: float, steps: int = 200) -> list[Pose2]:
    """A trailer dragged along the x axis, yawed by -slip, so that its hitch travels to its left."""
    return [Pose2(STEP * k, 0.0, -slip) for k in range(steps)]


def circle(radius: float, axle: float, steps: int = 300) -> list[Pose2]:
    """Left circle of the hitch, the axle rolling without slip."""
    yaw = math.asin(axle / radius)
    turned = [STEP * k / radius for k in range(steps)]
    return [Pose2(radius * math.sin(a), radius * (1.0 - math.cos(a)), a - yaw) for a in turned]


def winding_truth(now: float) -> float:
    """Off-tracking from the analytic path: where it crosses the follow point's line, by root finding."""
    to_trailer = winding(now).inverse()

    def seen(t: float) -> FloatArray:
        return np.asarray(to_trailer.apply(np.array([[winding(t).x, winding(t).y]]))[0], dtype=np.float64)

    then = brentq(lambda t: seen(t)[0] + LENGTH, now - 1.6 * LENGTH, now, xtol=1e-13)
    return float(seen(then)[1])


def mirrored(pose: Pose2) -> Pose2:
    return Pose2(pose.x, -pose.y, -pose.psi)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_constant_slip_has_the_closed_form_off_tracking(side: float) -> None:
    """A trailer at 14 deg of slip: the hitch travels to its left, so the past path lies right, 14 m tan 14 deg away."""
    slip = side * math.radians(14.0)
    result = run(motions(map(body, straight(slip))))[1][-1]
    assert result.value == pytest.approx(-side * 3.490592, abs=1e-6)  # the digits given
    assert result.hitch_direction == pytest.approx(slip, abs=1e-9)  # rounding
    assert result.path_tangent == pytest.approx(slip, abs=1e-9)
    assert (result.v_x, result.v_y) == pytest.approx((math.cos(slip), math.sin(slip)), abs=1e-9)  # 1 m/s
    assert result.std == 0.0
    assert result.health is Health.OK


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_steady_circle_has_the_closed_form_off_tracking(side: float) -> None:
    """In a steady left turn the trailer cuts in, so the hitch path lies to the right of the follow point."""
    radius, axle = 15.0, 9.0
    poses = circle(radius, axle) if side > 0.0 else list(map(mirrored, circle(radius, axle)))
    result = run(motions(map(body, poses)))[1][-1]
    closed_form = math.sqrt(radius**2 - (LENGTH - axle) ** 2) - math.sqrt(radius**2 - axle**2)
    assert closed_form == pytest.approx(2.14214, abs=1e-5)  # domain reference, digits given
    assert result.value == pytest.approx(-side * closed_form, abs=1e-8)  # cubic at 0.1 m: h^4 / (128 R^3) = 1e-9
    assert result.hitch_direction == pytest.approx(side * math.asin(axle / radius), abs=1e-4)  # parabola over 1.5 m
    assert result.hitch_direction_rate == pytest.approx(0.0, abs=1e-3)  # steady; the same parabola's curvature
    assert result.yaw_rate == pytest.approx(side * 1.0 / radius, abs=1e-9)  # 1 m/s
    velocity = (math.cos(math.asin(axle / radius)), side * axle / radius)
    assert (result.v_x, result.v_y) == pytest.approx(velocity, abs=1e-5)  # chord for arc: angle^2 / 24


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_winding_path_agrees_with_root_finding_on_the_analytic_path(side: float) -> None:
    """Curvature and slip vary: the value is that of the true path, not of its chords."""
    ts = [STEP * k for k in range(500)]
    poses = [winding(t) if side > 0.0 else mirrored(winding(t)) for t in ts]
    results = run(motions(map(body, poses)))[1]
    truths = {k: side * winding_truth(ts[k]) for k in range(250, 500, 10)}
    assert np.ptp(list(truths.values())) > 1.0  # [m] the case is a turning one, or it would prove nothing
    for k, truth in truths.items():
        assert results[k - 1].value == pytest.approx(truth, abs=1e-6)


def paper_off_tracking(sequence: list[BodyMotion]) -> float:
    """de Saxe 2018, eqs 3 to 7, in the paper's axes (x right, y forward, psi clockwise), for the last frame."""
    psi, p = 0.0, np.zeros(2)
    for m in reversed(sequence):
        psi += math.atan2(m.X_PC[1, 0], m.X_PC[0, 0])  # eq. 3
        R = np.array([[math.cos(psi), math.sin(psi)], [-math.sin(psi), math.cos(psi)]])
        older = p - R @ np.array([-m.X_PC[1, 3], m.X_PC[0, 3]])  # eqs 4 and 5
        if older[1] <= -LENGTH:  # eq. 6
            return float(p[0] + (older[0] - p[0]) * (p[1] + LENGTH) / (p[1] - older[1]))  # eq. 7
        p = older
    raise ValueError("the path is too short")


@pytest.mark.slow
def test_agrees_with_the_equations_of_the_paper() -> None:
    """Same increments, the paper's own axes and sums: the value is -e_tr, up to the chord of eq. 7."""
    for poses in (straight(0.24), circle(15.0, 9.0), [winding(STEP * k) for k in range(400)]):
        sequence = motions(map(body, poses))
        value = run(sequence)[1][-1].value
        assert value == pytest.approx(-paper_off_tracking(sequence), abs=2e-4)  # sagitta h^2 / 8 R


@pytest.mark.slow
@given(
    st.lists(st.tuples(st.floats(0.05, 0.6), st.floats(-0.1, 0.1), st.floats(-0.02, 0.02)), min_size=40, max_size=80)
)
@settings(max_examples=25)
def test_mirroring_the_drive_flips_the_off_tracking(increments: list[tuple[float, float, float]]) -> None:
    """Swapping left and right flips every lateral quantity and nothing else: this pins the signs at once."""

    def last(side: float) -> OffTracking:
        steps = (body(Pose2(x, side * y, side * yaw)) for x, y, yaw in increments)
        return run([motion(k, k + 1, X) for k, X in enumerate(steps)], length=3.0)[1][-1]

    left, right = last(1.0), last(-1.0)
    lateral = ("value", "hitch_direction", "hitch_direction_rate", "path_tangent", "v_y", "yaw_rate")
    for name in lateral:
        assert getattr(left, name) == pytest.approx(-getattr(right, name), abs=1e-9)  # rounding
    assert left.v_x == pytest.approx(right.v_x, abs=1e-12)
    assert left.health is right.health


@pytest.mark.slow
def test_rolling_and_pitching_of_the_body_does_not_bias() -> None:
    """Half a degree of roll and pitch tilts the plane of projection: (0.5 deg)^2 over 14 m is 1 mm."""
    poses = circle(15.0, 9.0, 400)
    shaken = [
        body(pose, math.radians(0.5) * math.sin(0.7 * k), math.radians(0.5) * math.sin(0.4 * k))
        for k, pose in enumerate(poses)
    ]
    still, moved = run(motions(map(body, poses)))[1], run(motions(shaken))[1]
    difference = np.array([b.value - a.value for a, b in zip(still, moved, strict=True)][250:])
    assert np.abs(difference).max() < 2e-3  # [m] 14 m x (0.5 deg)^2 = 1.1 mm
    assert abs(difference.mean()) < 5e-4  # [m] and it averages out


@pytest.mark.slow
def test_own_roll_of_the_body_does_not_tilt_the_path_over_undulating_ground() -> None:
    """The path rises and falls by 0.2 m while the body rolls by 2 deg: in the body's own plane that is 7 mm."""
    poses = circle(15.0, 9.0, 400)
    heights = [0.1 * math.sin(0.05 * k) for k in range(len(poses))]
    level, rolled = (
        [
            transform(rotation_zyx(pose.psi, 0.0, roll * math.sin(1.3 * k)), np.array([pose.x, pose.y, heights[k]]))
            for k, pose in enumerate(poses)
        ]
        for roll in (0.0, math.radians(2.0))
    )
    expected, moved = run(motions(level))[1], run(motions(rolled))[1]
    assert max(abs(b.value - a.value) for a, b in zip(expected[250:], moved[250:], strict=True)) < 5e-4


@pytest.mark.slow
def test_standstill_keeps_the_buffer_and_its_end_at_the_hitch() -> None:
    """While the truck waits, jittering, the buffer neither grows nor forgets; afterwards it goes on as before."""
    rng = np.random.default_rng(0)
    before = straight(0.2, 180)
    jitter = [Pose2(before[-1].x + 5e-4 * x, 5e-4 * y, -0.2) for x, y in rng.standard_normal((300, 2))]
    after = [Pose2(before[-1].x + STEP * k, 0.0, -0.2) for k in range(30)]
    poses = before + jitter + after
    memory, results = run(motions(map(body, poses)))
    moving, standing = results[178], results[470]
    assert standing.health is Health.OK
    assert standing.value == pytest.approx(moving.value, abs=2e-3)  # the jitter
    assert len(standing.path) <= len(moving.path) + 3
    assert np.array_equal(standing.path[0], [0.0, 0.0])
    assert results[-1].value == pytest.approx(-LENGTH * math.tan(0.2), abs=1e-9)  # exact poses again
    assert len(memory.samples) <= 182 + 30  # the ways before and after the stop, and next to nothing of it


@pytest.mark.parametrize("step", [0.003, 0.015, 0.019, 0.03])
def test_creeping_is_exact(step: float) -> None:
    """At steps below the buffer's resolution the newest point is the true one, and older ones are merely thinned."""
    poses = [Pose2(step * k, 0.0, -0.2) for k in range(round(1.6 / step))]
    result = run(motions(map(body, poses)), length=1.0)[1][-1]
    assert result.value == pytest.approx(-math.tan(0.2), abs=1e-9)  # rounding
    assert np.abs(np.diff(result.path[1:], axis=0)).max() < 0.05  # [m] no holes


def test_no_health_before_the_path_reaches_back_to_the_follow_point() -> None:
    """The value of an unfilled buffer is none: 0, infinitely uncertain."""
    results = run(motions(map(body, straight(0.0))))[1]
    filled = [result.health is Health.OK for result in results]
    assert filled.index(True) == pytest.approx(LENGTH / STEP, abs=1.0)
    assert all(filled[filled.index(True) :])
    first = results[0]
    assert (first.value, first.std, first.health) == (0.0, math.inf, Health.LOST)
    assert len(first.path) == 2


def test_path_is_kept_only_as_far_as_it_is_needed() -> None:
    """A metre behind the follow point for the tangent, and the cubic's last point."""
    result = run(motions(map(body, straight(0.0, 400))))[1][-1]
    assert -LENGTH - 1.0 - 2.5 * STEP < result.path[-1, 0] < -LENGTH - 1.0 + STEP


@pytest.mark.slow
def test_circle_too_tight_to_reach_the_follow_point_does_not_grow_forever() -> None:
    """A hitch that circles within half a trailer length never passes the follow point."""
    poses = [Pose2(5.0 * math.sin(a), 5.0 * (1.0 - math.cos(a)), a) for a in np.arange(1200) * STEP / 5.0]
    memory, results = run(motions(map(body, poses)))
    assert results[-1].health is Health.LOST
    assert len(memory.samples) < 3.2 * LENGTH / STEP


def lost(first: int, second: int) -> BodyMotion:
    return motion(first, second, np.eye(4), Health.LOST)


def test_lost_motion_is_replaced_when_a_later_one_spans_the_gap() -> None:
    """Frames 200 and 201 are dark; the motion from 199 to 202 takes the place of the bridge, and nothing is lost."""
    bodies = [body(pose) for pose in circle(15.0, 9.0, 230)]
    sequence = [*motions(bodies[:200]), lost(199, 200), lost(199, 201)]
    sequence += [motion(199, 202, inverse(bodies[199]) @ bodies[202])]
    sequence += [motion(k, k + 1, inverse(bodies[k]) @ bodies[k + 1]) for k in range(202, 229)]
    results = run(sequence)[1]
    assert [results[k].health for k in (198, 199, 200, 201)] == [Health.OK, Health.LOST, Health.LOST, Health.OK]
    assert (results[200].value, results[200].std) == (0.0, math.inf)
    exact = run(motions(bodies))[1]
    assert results[201].value == pytest.approx(exact[201].value, abs=1e-9)
    assert results[-1].value == pytest.approx(exact[-1].value, abs=1e-7)  # the cubic over the gap's 0.3 m


def test_lost_motion_while_creeping_keeps_the_path() -> None:
    """The start of a lost motion may be nearer to its predecessor than the buffer's resolution, and is needed again."""
    bodies = [body(Pose2(0.015 * k, 0.0, -0.2)) for k in range(120)]
    sequence = [*motions(bodies[:101]), lost(100, 101), motion(100, 102, inverse(bodies[100]) @ bodies[102])]
    result = run(sequence, length=1.0)[1][-1]
    assert result.health is Health.OK
    assert result.value == pytest.approx(-math.tan(0.2), abs=1e-9)


@pytest.mark.slow
def test_bridged_motion_is_doubted_until_it_has_left_the_buffer() -> None:
    """A motion that never comes is bridged at the last velocity: exact here, but uncertain for one trailer length."""
    bodies = [body(pose) for pose in circle(15.0, 9.0, 500)]
    sequence = motions(bodies)
    sequence[250] = lost(250, 251)
    results = run(sequence)[1]
    assert results[250].health is Health.LOST
    doubted = [k for k, result in enumerate(results) if result.health is Health.DEGRADED]
    assert doubted == list(range(251, doubted[-1] + 1))
    way = STEP * len(doubted)
    assert LENGTH - 1.0 < way < 1.2 * LENGTH  # the arc to the follow point is a little longer than the trailer
    exact = run(motions(bodies))[1]
    assert results[260].value == pytest.approx(exact[260].value, abs=1e-6)
    assert 0.01 < results[260].std < 0.1  # [m] 2 m/s2 and 0.3 rad/s2 unknown for 0.1 s, at 14 m
    assert results[-1].std == 0.0


def test_long_gap_begins_a_new_path() -> None:
    """After more than a second without sight even the speed is unknown."""
    bodies = [body(pose) for pose in straight(0.0, 400)]
    sequence = motions(bodies)
    sequence[200:215] = [lost(k, k + 1) for k in range(200, 215)]
    results = run(sequence)[1]
    assert results[216].health is Health.LOST
    assert results[-1].health is Health.OK


def test_degraded_motion_degrades_until_it_has_left_the_buffer() -> None:
    """The worst increment between the follow point and the hitch decides."""
    sequence = motions(map(body, straight(0.0, 400)))
    sequence[200] = motion(200, 201, sequence[200].X_PC, Health.DEGRADED)
    health = [result.health for result in run(sequence)[1]]
    assert health[199:202] == [Health.OK, Health.DEGRADED, Health.DEGRADED]
    assert health[-1] is Health.OK


def test_errors_of_increments_add_up_and_their_common_part_in_step() -> None:
    """Ten increments to the follow point, each 1 mm across, of which 0.2 mm are alike: sqrt(10 0.96 + 2^2) mm."""
    sure = motions(map(body, [Pose2(float(k), 0.0, 0.0) for k in range(14)]))
    covariance = np.diag([0.0, 0.0, 0.0, 0.0, 1e-6, 0.0])
    common = np.zeros((6, 13))
    common[4, 4] = 2e-4
    result = run([replace(one, covariance=covariance, common=common) for one in sure], length=9.5)[1][-1]
    assert result.std == pytest.approx(1e-3 * math.sqrt(10.0 * 0.96 + 2.0**2))


@pytest.mark.parametrize("poses", [straight(0.1), circle(12.5, 8.0)], ids=["straight", "bend"])
def test_a_scale_that_motions_share_counts_as_much_as_it_moves_the_value(poses: list[Pose2]) -> None:
    """0.1 % too long: straight on the path lies where it was, in the bend 9 mm to the side of the follow point."""
    exact, scaled = motions(map(body, poses)), []
    for one in exact:
        common = np.pad(1e-3 * one.X_PC[:3, 3:], ((3, 0), (6, 6)))
        X_PC = transform(one.X_PC[:3, :3], 1.001 * one.X_PC[:3, 3])
        scaled.append(replace(one, X_PC=X_PC, covariance=common @ common.T, common=common))
    true, found = (run(sequence)[1][-1] for sequence in (exact, scaled))
    assert found.std == pytest.approx(abs(found.value - true.value), rel=0.01, abs=1e-9)


def erring(true: Sequence[BodyMotion], errors: FloatArray, covariance: FloatArray) -> list[BodyMotion]:
    return [
        replace(one, X_PC=disturbed(one.X_PC, error), covariance=covariance)
        for one, error in zip(true, errors, strict=True)
    ]


@pytest.mark.slow
@pytest.mark.parametrize("anchored", [False, True])
def test_standard_deviation_is_that_of_the_spread(anchored: bool) -> None:
    """Monte Carlo over errors of every increment, correlated between rotation and translation.

    All but 4 % of their variance is independent; that share is a bias common to all increments of a trial. With
    every fourth pose a keyframe that the next four are measured from, the errors of 24 motions telescope to those of
    some six keyframes; a deviation that took the motions for independent would be half as large again.
    """
    rng = np.random.default_rng(6)
    poses = [body(winding(0.5 * k)) for k in range(24)]
    L = 1e-3 * np.tril(rng.standard_normal((6, 6)))
    errors = []
    for _ in range(200):
        bias = math.sqrt(0.04) * np.sqrt(np.diag(L @ L.T)) * rng.standard_normal(6)
        if anchored:
            noisy = measured_from_keyframes(poses, range(0, 24, 4), rng, L, bias)
        else:
            noisy = erring(motions(poses), rng.standard_normal((23, 6)) @ L.T + bias, L @ L.T)
        result = run(noisy, length=6.0)[1][-1]
        errors.append(result.value)
    spread = float(np.std(errors))
    assert spread > 2e-3  # [m] the errors do something
    assert result.std == pytest.approx(spread, rel=0.2)  # 4 sigma of the spread of 200, 1 / sqrt(400)


def measured_from_keyframes(
    poses: list[FloatArray], keyframes: Sequence[int], rng: np.random.Generator, L: FloatArray, bias: FloatArray
) -> list[BodyMotion]:
    """Motions of which each carries its keyframe, the last before it, all with the covariance L L' against it."""

    def keyframe_of(k: int) -> int:
        return max(keyframe for keyframe in keyframes if keyframe < k)

    return anchored_motions(poses, keyframe_of, lambda: L @ rng.standard_normal(6) + bias, L @ L.T)


def test_anchored_standstill_keeps_buffer_and_keyframe() -> None:
    """While the truck waits, all poses hang on one keyframe: the path stays, and so does its standard deviation."""
    ways = [0.3 * min(k, 59) + 0.3 * max(k - 99, 0) for k in range(104)]  # standing from frame 59 to 99
    poses = [body(Pose2(way, 0.0, -0.2)) for way in ways]
    keyframes = [*range(0, 58, 4), 100]
    rng = np.random.default_rng(0)
    memory, results = run(measured_from_keyframes(poses, keyframes, rng, 1e-4 * np.eye(6), np.zeros(6)), length=6.0)
    assert results[97].std == pytest.approx(results[58].std, rel=1e-2)  # the same links, pose noise of 0.1 mrad
    assert results[97].value == pytest.approx(results[58].value, abs=5e-3)  # 0.1 mm and 0.1 mrad over some metres
    assert len(memory.samples) <= 60 + 6  # the ways before and after the stop
    assert results[-1].value == pytest.approx(results[58].value, abs=5e-3)


def test_anchor_that_has_left_the_buffer_is_no_error() -> None:
    """After a gap the path is new, while the odometry still measures from an old keyframe."""
    poses, rng = [body(pose) for pose in straight(0.1, 100)], np.random.default_rng(0)
    sequence = measured_from_keyframes(poses, [0, 50], rng, 1e-4 * np.eye(6), np.zeros(6))
    result = run(sequence[40:], length=2.0)[1][-1]
    assert result.health is Health.OK
    assert 0.0 < result.std < 0.1


def test_odometry_noise_hardly_disturbs_directions_and_rate() -> None:
    """A millimetre of noise a frame: the fits keep the hitch's direction within half a degree, unbiased."""
    rng = np.random.default_rng(2)
    exact = motions(map(body, [Pose2(p.x, p.y, p.psi) for p in circle(15.0, 9.0, 900)[::3]]))  # 0.3 m a frame
    noise = rng.standard_normal((len(exact), 6)) * [2e-5, 2e-5, 2e-5, 1e-3, 1e-3, 1e-3]
    noisy = erring(exact, noise, np.eye(6))
    results = run(noisy)[1][100:]
    direction = np.array([result.hitch_direction for result in results]) - math.asin(9.0 / 15.0)
    tangent = np.array([result.path_tangent for result in results])
    assert direction.std() < math.radians(0.5)
    assert abs(direction.mean()) < math.radians(0.1)  # a tenth of the spread or so, over 200 overlapping fits
    assert tangent.std() < math.radians(0.5)
    assert np.std([result.hitch_direction_rate for result in results]) < 0.06  # [rad/s] at 3 m/s


def rate_of(angle: Callable[[float], float], at: float) -> float:
    return (angle(at + 1e-4) - angle(at - 1e-4)) / 2e-4


def test_directions_on_a_winding_path_are_those_of_the_path() -> None:
    """Tangents and their rate against the analytic path; 1 m of x a second."""
    results = run(motions(body(winding(STEP * k)) for k in range(400)))[1]

    def direction(t: float) -> float:
        return math.atan(0.6 * math.cos(t / 8.0)) - winding(t).psi

    for k in range(200, 399, 15):
        t, result = STEP * (k + 1), results[k]
        assert result.hitch_direction == pytest.approx(direction(t), abs=4e-3)  # the parabola's cubic remainder
        assert result.hitch_direction_rate == pytest.approx(rate_of(direction, t), abs=0.02)


def another_attempt() -> list[Pose2]:
    """Forwards on a bend, 9 m back and 0.6 m beside the way in the end, forwards somewhere else; 10 poses a frame."""
    poses = [winding(0.01 * k) for k in range(3000)]
    for k in range(1, 900):
        there, beside = winding(29.99 - 0.01 * k), (k / 900.0) ** 2
        poses.append(Pose2(there.x, there.y + 0.6 * beside, there.psi + 0.1 * beside))
    for _ in range(2000):
        poses.append(poses[-1] @ Pose2(0.01 * math.cos(0.1), 0.01 * math.sin(0.1), -0.0003))
    return poses


def test_join_does_not_turn_the_direction_of_the_hitch() -> None:
    """Back beside the path and forwards again: the hitch's direction is that of its travel, not of the join."""
    poses = another_attempt()[::10]
    results = run(motions(map(body, poses)))[1]
    for k in (*range(302, 388), *range(393, 480)):
        there, here = poses[k], poses[k + 1]
        moved = here.inverse().apply(np.array([[there.x, there.y]]))[0]  # of the hitch, along its line of travel
        assert results[k].hitch_direction == pytest.approx(math.atan(moved[1] / moved[0]), abs=0.02)  # half a chord


def test_reversing_distance_must_not_be_negative() -> None:
    """Refused in one line."""
    with pytest.raises(ValueError, match="reversing_distance = -1"):
        OffTrackingBuffer(LENGTH, reversing_distance=-1.0)
