"""Cameras with imperfections: position, time and brightness of what their images show."""

import math
from collections.abc import Callable, Iterator

import cv2
import numpy as np
import pytest
from cv2.typing import MatLike
from numpy.typing import NDArray

from sensors.camera import image_formation
from sensors.camera.rig import UNDISTORTED, RawStereoRig, StereoRig, mount_rotation
from sensors.camera.stereo_camera import Imperfections, RawStereoCamera, pinholes_for
from sensors.messages import StereoFrame
from sensors.render import StereoRenderer
from sensors.world.world import World
from tests.sensors.conftest import SURFACE
from vehicle.combination.truth import Truth
from vehicle.frames import FloatArray

TruthOf = Callable[..., Truth]
Sees = Callable[..., StereoFrame]
RIG = StereoRig(facing="rear", width=672, height=240, hfov=math.radians(100.0), x=-13.6, y=0.0, z=3.0, baseline=0.5)
BARREL = (-0.2, 0.04, 0.001, -0.0008, -0.003)
KNOCKED = mount_rotation(-0.0026, 0.0017, 0.001)  # the paper's roll and yaw, and some pitch [rad]
BLURRED = Imperfections(exposure_time=0.02, rolling_shutter=0.02)
PERIOD = 0.1  # [s]
PLAIN = Imperfections()


@pytest.fixture(scope="module")
def wide(world: World) -> Iterator[StereoRenderer]:
    """A pinhole whose view covers those of all these cameras."""
    opened = StereoRenderer(world, pinholes_for(RIG.raw(BARREL), BLURRED))
    yield opened
    opened.close()


@pytest.fixture
def pose() -> FloatArray:
    """X_WB of a trailer half way round."""
    return SURFACE.pose_on(9.0, 8.0, 1.9, (0.0, -8.0))


@pytest.fixture
def sees(wide: StereoRenderer, pose: FloatArray, truth_of: TruthOf) -> Sees:
    """The frame of a camera with some imperfections, by default at ``pose``, maybe after one from another pose."""

    def frame(
        imperfections: Imperfections = PLAIN,
        *,
        tick: int = 100,
        at: FloatArray = pose,
        before: FloatArray | None = None,
        load_transfer: float = 0.0,
        rig: RawStereoRig | None = None,
        sun: FloatArray | None = None,
        keep_colour: bool = False,
    ) -> StereoFrame:
        camera = RawStereoCamera(
            renderer=wide,
            imperfections=imperfections,
            unit=0,
            rig=rig or RIG.raw(),
            sun=sun,
            keep_colour=keep_colour,
            rng=np.random.default_rng(5),
        )
        if before is not None:
            camera.sample(truth_of(0, before))
        return camera.sample(truth_of(tick, at, load_transfer=load_transfer))

    return frame


def difference(a: NDArray[np.generic], b: NDArray[np.generic]) -> float:
    """Mean absolute difference [grey levels] away from the edges."""
    return float(np.abs(a.astype(float) - b.astype(float))[8:-8, 8:-8].mean())


def displacement(image: MatLike, other: MatLike, rows: tuple[float, float] = (15, 224)) -> FloatArray:
    """Displacement (n, 2) [px] of corners within some rows from one image to the other."""
    corners = cv2.goodFeaturesToTrack(image, 1500, 0.004, 4)
    start = np.empty_like(corners)
    found, status, _ = cv2.calcOpticalFlowPyrLK(image, other, corners, start, winSize=(15, 15), maxLevel=2)
    u, v = corners[:, 0].T
    inside = (u > 14) & (u < image.shape[1] - 15) & (v >= rows[0]) & (v <= rows[1]) & (status.ravel() == 1)
    return np.asarray((found - corners)[inside, 0], dtype=float)


def next_pixel(image: NDArray[np.uint8]) -> float:
    return difference(image[:, 1:], image[:, :-1])


def test_plain_cameras_see_what_pinholes_see(world: World, pose: FloatArray, sees: Sees) -> None:
    """No imperfection, no difference: up to resampling at whole pixels, which changes nothing.

    But the ground's level of detail is chosen for all of a view, and the wider one looks down more steeply.
    """
    frame = sees()
    direct = StereoRenderer(world, RIG.calibration())
    left, right = (image_formation.grey(image) for image in direct.render(pose))
    direct.close()
    # [px] What is drawn at another place of the framebuffer is rasterised differently, which no one image shows.
    assert np.abs(np.median(displacement(frame.left, left), axis=0)).max() < 0.01
    assert np.abs(np.median(displacement(frame.right, right), axis=0)).max() < 0.01
    assert difference(frame.left, left) < 0.2 * next_pixel(left)


def test_undistorting_a_distorted_image_gives_the_pinholes(sees: Sees) -> None:
    """OpenCV undoes what was done here: coefficients, principal point and pixel centres all agree."""
    straight = sees().left
    bent = sees(rig=RIG.raw(BARREL)).left
    K = RIG.raw().left.matrix
    back = cv2.undistort(bent, K, np.array(BARREL))
    moved_by = displacement(back, straight)
    assert len(moved_by) > 200
    assert np.abs(np.median(moved_by, axis=0)).max() < 0.04  # [px] maps are rounded to 1/32 px, twice
    assert np.median(np.hypot(*moved_by.T)) < 0.08  # [px] of interpolation, everywhere
    assert np.median(np.hypot(*displacement(bent, straight).T)) > 1.0


def test_a_turned_right_camera_sees_the_papers_homography(sees: Sees) -> None:
    """K R K^-1 of the turned camera's image is the straight one's: eqs (8) and (9) with the very angles."""
    straight = sees()
    turned = sees(rig=RIG.raw(UNDISTORTED, KNOCKED))
    K = RIG.raw().right.matrix
    back = cv2.warpPerspective(turned.right, K @ KNOCKED @ np.linalg.inv(K), (RIG.width, RIG.height))
    assert np.array_equal(turned.left, straight.left)
    assert np.abs(np.median(displacement(back, straight.right), axis=0)).max() < 0.04  # [px] as above
    assert np.median(np.hypot(*displacement(turned.right, straight.right).T)) > 0.7  # 0.0026 rad at 300 px and more


def test_chassis_twist_follows_the_load_transfer(sees: Sees) -> None:
    """Half of the load moved turns the right camera half way; in a bend to the other side it turns the other way."""
    angles = (-0.01, 0.008, 0.004)
    for load_transfer in (0.5, -0.5):
        half = (load_transfer * angle for angle in angles)
        fixed = sees(rig=RIG.raw(UNDISTORTED, mount_rotation(*half)))
        assert np.array_equal(sees(Imperfections(twist=angles), load_transfer=load_transfer).right, fixed.right)


def driven(pose: FloatArray, seconds: float) -> FloatArray:
    """The trailer at some time around ``pose``: 5 m/s around a bend of 12 m, while it pitches and rolls."""
    return image_formation.moved(
        pose, image_formation.Twist(np.array([5.0, 0.3, 0.1]), np.array([0.20, -0.12, 0.42])), seconds
    )


def test_twist_and_pose_are_each_others_inverse(pose: FloatArray) -> None:
    """The motion found between two captures leads from the one to the other; up to a quarter of the squared turn."""
    twist = image_formation.twist_between(pose, driven(pose, PERIOD), PERIOD)
    np.testing.assert_allclose(twist.v, [5.0, 0.3, 0.1], atol=5.0 * 0.05**2 / 4.0)
    np.testing.assert_allclose(twist.w, [0.20, -0.12, 0.42], atol=1e-9)
    assert not image_formation.twist_between(pose, driven(pose, PERIOD), 1.0).v.any()  # too long ago to know


@pytest.mark.slow
def test_an_exposure_is_the_mean_of_its_moments(pose: FloatArray, sees: Sees) -> None:
    """Against sixteen renderings while the shutter is open: the depth of every pixel decides how far it is smeared."""
    seconds = 0.02
    moments = [sees(at=driven(pose, seconds * ((k + 0.5) / 16 - 0.5))).left.astype(float) for k in range(16)]
    expected = np.mean(moments, axis=0)
    blurred = sees(Imperfections(exposure_time=seconds), before=driven(pose, -PERIOD)).left
    sharp = difference(sees().left, expected)
    assert difference(blurred, expected) < 0.3 * sharp  # what is left: interpolation, and what things uncover


def test_each_row_of_a_rolling_shutter_sees_its_own_moment(pose: FloatArray, sees: Sees) -> None:
    """Against renderings from where the camera was when they were read; the middle one is read at the stamp."""
    seconds = 0.02
    rolled, still = (sees(Imperfections(rolling_shutter=seconds), before=driven(pose, -PERIOD)).left, sees().left)
    for row in (25, 180, 215):
        then = sees(at=driven(pose, seconds * (row / (RIG.height - 1) - 0.5))).left
        own, stamp = (displacement(rolled, other, (row - 4, row + 4)) for other in (then, still))
        assert len(own) > 10
        assert np.median(np.hypot(*own.T)) < 0.15  # [px] within 0.3 ms, and interpolated
        assert np.median(np.hypot(*stamp.T)) > 0.9
    assert np.median(np.hypot(*displacement(rolled, still, (115, 124)).T)) < 0.15


def test_nothing_is_smeared_at_standstill(pose: FloatArray, sees: Sees) -> None:
    assert np.array_equal(sees(BLURRED, before=pose).left, sees().left)


def test_vignetting_darkens_the_corners_by_its_share(sees: Sees) -> None:
    """Half of the light lost in the corner, none in the middle, and a quarter half way out; to a level of rounding."""
    clear = sees().left.astype(float)
    dim = sees(Imperfections(vignetting=0.5)).left
    for v, u, share in ((0, 0, 0.5), (120, 336, 1.0), (60, 168, 0.875)):
        assert dim[v, u] == pytest.approx(share * clear[v, u], abs=1.0)


def test_auto_exposure_brings_the_dark_to_a_medium_level(sees: Sees) -> None:
    """It comes settled; when the light changes it follows within some time constants, one of them for 63 %."""
    control = image_formation.AutoExposure(time_constant=0.2)
    gain = control.settled(59.0)
    assert gain == pytest.approx(2.0)
    after = control.step(gain, 118.0, 0.2)  # twice the light
    assert math.log2(after) == pytest.approx(math.exp(-1.0))  # of the stop that it has to go back
    assert control.step(after, 118.0, 10.0) == pytest.approx(1.0)
    assert control.settled(0.0) == control.settled(1.0) == 8.0  # the amplifier's end
    seen = sees(Imperfections(vignetting=0.9, auto_exposure=control))
    assert 0.5 * (seen.left.mean() + seen.right.mean()) == pytest.approx(118.0, rel=0.02)  # every 64th pixel is metered


@pytest.mark.parametrize(("level", "gain"), [(0.0, 1.0), (60.0, 1.0), (60.0, 3.0)])
def test_noise_grows_with_the_light_and_with_the_gain(level: float, gain: float) -> None:
    """var = read^2 + shot^2 gain level/255 of the amplified level, plus 1/12 of rounding; 0 cuts half of it off."""
    rng = np.random.default_rng(7)
    noise = image_formation.LightNoise.draw(rng, 2.0, 10.0, 500_000)
    seen = noise.sensed(np.full((500, 1000), level, dtype=np.float32), gain, rng).astype(float)
    expected = math.sqrt(4.0 + 100.0 * gain * (gain * level) / 255.0 + 1.0 / 12.0)
    if level == 0.0:
        assert seen.max() > 3.0 * 2.0
        return
    assert seen.mean() == pytest.approx(gain * level, abs=5.0 * expected / math.sqrt(seen.size))  # five standard errors
    assert seen.std() == pytest.approx(expected, rel=0.01)  # ten standard errors


def test_dirt_hides_its_share_of_each_lens_and_rests_there(pose: FloatArray, sees: Sees) -> None:
    """Dirt stays in its place from frame to frame; the lenses are dirty in different places."""
    clear, first, second = sees(), sees(Imperfections(dirt=0.3)), sees(Imperfections(dirt=0.3), before=pose)
    assert np.array_equal(first.left, second.left)
    hidden = [a < 0.75 * b.astype(float) for a, b in ((first.left, clear.left), (first.right, clear.right))]
    for mask in hidden:
        assert mask.mean() == pytest.approx(0.3, abs=0.06)  # edges are soft
    assert (hidden[0] & hidden[1]).mean() < 0.2


def test_drops_show_the_scene_upside_down(sees: Sees) -> None:
    clear = sees()
    wet = sees(Imperfections(rain=0.1))
    changed = [np.abs(a.astype(int) - b) > 2 for a, b in ((wet.left, clear.left), (wet.right, clear.right))]
    for mask in changed:
        assert 0.05 < mask.mean() < 0.16  # soft edges count as covered in part
    assert not np.array_equal(changed[0], changed[1])


def test_glare_is_brightest_where_the_sun_is(pose: FloatArray, sees: Sees) -> None:
    """A sun in the view whitens the image around where its direction projects to; one behind adds hardly anything."""
    X_WC = pose @ RIG.calibration().X_SC
    ray = np.array([-0.4, -0.25, 1.0])
    clear, sun = sees().left.astype(float), X_WC[:3, :3] @ (ray / np.linalg.norm(ray))
    ahead, behind = (sees(Imperfections(glare=1.0), sun=sign * sun).left for sign in (1.0, -1.0))
    u, v = (RIG.raw().left.project(ray[None])[0]).astype(int)
    assert ahead[v - 5 : v + 6, u - 5 : u + 6].min() == 255
    assert ahead[v, u + 300] - clear[v, u + 300] < 60.0
    assert np.abs(behind - clear).max() < 5.0


def test_frames_are_stamped_and_coloured_as_asked(sees: Sees) -> None:
    sent = sees(Imperfections(vignetting=0.3, read_noise=2.0), tick=30)
    shown = sees(Imperfections(vignetting=0.3, read_noise=2.0), keep_colour=True, tick=30)
    assert sent.tick == shown.tick == 30
    assert sent.colour is None
    assert shown.colour is not None
    assert np.array_equal(sent.left, shown.left)
    assert image_formation.grey(shown.colour).mean() == pytest.approx(sent.left.mean(), abs=0.5)


def test_covering_pinhole_is_the_camera_itself_if_there_is_no_lens() -> None:
    """Then nothing is resampled and nothing costs more; a lens that bends outwards needs a larger one."""
    plain = image_formation.covering_pinholes(RIG.raw())
    assert (plain.width, plain.height) == (RIG.width, RIG.height)
    assert image_formation.LensMap.of(RIG.raw().left, plain).is_identity
    bent = image_formation.covering_pinholes(RIG.raw(BARREL))
    assert bent.width > 1.3 * RIG.width
    at = image_formation.LensMap.of(RIG.raw(BARREL).left, bent).pixels
    assert at.min() >= 1.0  # a cubic reaches one pixel before and two behind
    assert (at.max(axis=(0, 1)) <= [bent.width - 3.0, bent.height - 3.0]).all()
