"""Motions that cannot be true, and frames that repeat an earlier one."""

from dataclasses import replace

import numpy as np
import pytest

from estimators.estimates import Health, Motion, SlipAngle, lost_motion
from estimators.odometry.plausibility import HARDEST, Belief, believed, is_implausible
from estimators.odometry.repeated_frames import NewViews, NewViewsMemory, is_repeated, visible_noise
from estimators.rigid_motion import UncertainMotion, composed
from estimators.slip.rover_odometry import ReferenceSlip
from sensors.messages import GreyImage, RoverView, SlipReading
from tests.estimators.stereo_scene import NOISE as RENDERED
from tests.estimators.stereo_scene import Drive
from vehicle.frames import transform


def motion(tick: int, speed: float, *, previous_tick: int | None = None, health: Health = Health.OK) -> Motion:
    """Straight motion at a speed [m/s]; from 0.1 s before, if no tick is given."""
    start = tick - 100 if previous_tick is None else previous_tick
    X_PC = transform(np.eye(3), np.array([0.0, 0.0, speed * (tick - start) * 1e-3]))
    return replace(lost_motion(tick, start), X_PC=X_PC, covariance=1e-6 * np.eye(6), health=health)


def judge(motions: list[Motion]) -> list[Motion]:
    belief, told = Belief(), []
    for one in motions:
        belief, answer = believed(belief, one)
        told.append(answer)
    return told


def test_a_jump_after_a_loss_is_believed_with_the_next_motion() -> None:
    """From 10 to 4 m/s during one unseen second: the second look confirms it, and its report spans both."""
    across, on = motion(1200, 4.0, previous_tick=200), motion(1300, 4.0)
    told = judge([motion(100, 10.0), motion(200, 10.0, health=Health.LOST), across, on])
    assert [one.health for one in told] == [Health.OK, Health.LOST, Health.LOST, Health.OK]
    assert (told[3].previous_tick, told[3].tick) == (200, 1300)
    both = composed(*(UncertainMotion(one.X_PC, one.covariance) for one in (across, on)))
    assert np.array_equal(told[3].X_PC, both.X)
    assert np.array_equal(told[3].covariance, both.covariance)


@pytest.mark.parametrize(("ticks", "believed"), [(300, True), (1100, False)])
def test_a_degraded_motion_over_a_long_loss_must_go_on_as_before(ticks: int, believed: bool) -> None:
    """From 7 to 1 m/s within 0.3 s is a hard stop; a mean of 1 m/s over a second is what distant scenery says."""
    before = motion(100, 7.0)
    doubtful = motion(100 + ticks, 4.0 if believed else 1.0, previous_tick=100, health=Health.DEGRADED)
    told = judge([before, doubtful])
    assert (told[1].health is Health.DEGRADED) is believed


def test_two_jumps_that_disagree_are_not_believed() -> None:
    """4 m/s, then 17 m/s a tenth of a second later: neither."""
    lost = motion(200, 10.0, health=Health.LOST)
    told = judge([motion(100, 10.0), lost, motion(1200, 4.0, previous_tick=200), motion(1300, 17.0)])
    assert [one.health for one in told[2:]] == [Health.LOST, Health.LOST]


@pytest.mark.parametrize(("health", "believed"), [(Health.OK, True), (Health.DEGRADED, False)])
def test_a_halt_takes_a_second_in_good_health(health: Health, believed: bool) -> None:
    """A vehicle close behind that hides the view looks like a halt: few matches never confirm it."""
    lost = motion(200, 10.0, health=Health.LOST)
    halted = [motion(300 + 100 * k, 0.0, health=health) for k in range(15)]
    told = judge([motion(100, 10.0), lost, *halted])
    found = [one.tick for one in told[2:] if one.health is not Health.LOST]
    assert found == ([1300, 1400, 1500, 1600, 1700] if believed else [])


def test_a_plausible_motion_ends_the_doubt() -> None:
    """After a doubtful jump the old speed is measured again: believed at once."""
    lost = motion(200, 10.0, health=Health.LOST)
    told = judge([motion(100, 10.0), lost, motion(300, 1.0), motion(400, 10.0)])
    assert [one.health for one in told[2:]] == [Health.LOST, Health.OK]
    assert told[3].previous_tick == 300


def test_belief_predicts_from_the_newest_motion() -> None:
    """While a jump is doubted, the next motion is searched at its velocity."""
    belief, _ = believed(Belief(motion(100, 10.0)), motion(300, 2.0))
    assert belief.last is not None
    assert belief.newest is not None
    assert (belief.last.tick, belief.newest.tick) == (100, 300)


@pytest.mark.parametrize(
    ("share", "lost_for", "implausible"),
    [(0.7, 400, False), (0.0, 400, True), (0.0, 2000, True), (1.4, 2000, False), (0.0, 6000, False)],
)
def test_what_is_seen_first_after_a_loss_must_go_on_as_before(share: float, lost_for: int, implausible: bool) -> None:
    """In good health even, and if brakes could explain it: at rest is what a vehicle close behind would look like.

    After five seconds nobody knows any more how fast it ought to be.
    """
    last = motion(400, 5.0)
    first = motion(400 + lost_for, share * 5.0)
    assert is_implausible(last, first, HARDEST) is implausible


STANDING = 43  # first frame of the drive that is where the one before was


def test_noise_is_seen_at_standstill_and_under_way(drive: Drive) -> None:
    """Mean difference of two normal numbers: 2 / sqrt(pi) standard deviations; the quietest cell has a little less."""
    expected = 2.0 / np.sqrt(np.pi) * RENDERED
    for first in (20, STANDING):
        noise = visible_noise(drive.frames[first].left, drive.frames[first + 1].left)
        assert 0.7 * expected < noise < 1.1 * expected


def test_standstill_is_not_repeated(drive: Drive) -> None:
    """New noise, so a new image; the same noise again is the same image again."""
    one, other = (frame.left for frame in drive.frames[STANDING : STANDING + 2])
    still = replace(lost_motion(4300, 4200), health=Health.OK)
    assert not is_repeated(one, other, 2.0, still)
    assert is_repeated(one, one.copy(), 2.0, still)
    assert not is_repeated(one, one.copy(), 0.0, still)  # a camera without noise
    assert is_repeated(one, one.copy(), 0.0, None)


RADIUS = 0.1  # [m]
ROLLING = 0.8  # of a wheel: 8 cm/s [rad/s]
PERIOD = 200  # [ticks]
NOISE = 2.0  # of the images, 1 sigma [grey levels]
SAND = np.random.default_rng(1).uniform(60.0, 200.0, (120, 160))


class Counting(ReferenceSlip):
    def init(self) -> int:  # type: ignore[override]
        return 0

    def step(self, memory: int, view: RoverView) -> tuple[int, SlipAngle]:  # type: ignore[override]
        reading = SlipReading(tick=view.tick, slip_angle=0.1, wheel_slip=0.1)
        return memory + 1, super().step(None, reading)[1]


def image(k: int, *, shift: int = 0, noise: float = NOISE) -> GreyImage:
    """Image k of the sand, which has moved by ``shift`` [px]."""
    noisy = np.roll(SAND, shift, axis=0) + np.random.default_rng(100 + k).normal(0.0, noise, SAND.shape)
    return noisy.clip(0.0, 255.0).astype(np.uint8)


def seen(images: list[GreyImage], speed: float) -> tuple[NewViewsMemory, list[Health]]:
    """Memory after views of these images by a rover whose wheels turn at a ``speed`` [rad/s], and all healths."""
    watch = NewViews(Counting(), RADIUS)
    memory, healths = watch.init(), []
    for k, each in enumerate(images):
        view = RoverView(tick=k * PERIOD, image=each, heading=0.0, wheel_speeds=np.full(4, speed), steer=np.zeros(4))
        memory, estimate = watch.step(memory, view)
        assert estimate.tick == view.tick
        healths.append(estimate.health)
    return memory, healths


@pytest.mark.parametrize("noise", [NOISE, 0.0])
def test_an_image_that_repeats_under_way_is_lost_and_not_passed_on(noise: float) -> None:
    """The ground moves by 16 mm, some pixels: even without noise an image differs from the one before."""
    images = [image(k, shift=5 * k, noise=noise) for k in range(4)]
    memory, healths = seen([*images[:2], images[1], images[1], *images[2:]], ROLLING)
    assert healths == [Health.OK, Health.OK, Health.LOST, Health.LOST, Health.OK, Health.OK]
    assert memory.estimator == 4


def test_a_rover_at_standstill_is_not_taken_for_a_frozen_camera() -> None:
    still = [image(k) for k in range(3)]
    assert seen(still, 0.0)[1] == [Health.OK] * 3
    assert seen([image(0, noise=0.0)] * 3, 0.0)[1] == [Health.OK] * 3
    assert seen([*still, still[-1]], 0.0)[1][-1] is Health.LOST


def test_black_images_are_lost() -> None:
    black = np.zeros_like(image(0))
    assert seen([image(0), black, black, image(1, shift=15)], ROLLING)[1][2:] == [Health.LOST, Health.OK]


def test_other_messages_are_passed_on() -> None:
    """An exact instrument repeats its reading when the slip is the same."""
    watch = NewViews(ReferenceSlip(), RADIUS)
    memory = watch.init()
    for tick in (0, 200):
        memory, estimate = watch.step(memory, SlipReading(tick=tick, slip_angle=0.1, wheel_slip=0.1))
        assert estimate.health is Health.OK
