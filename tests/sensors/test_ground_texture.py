"""The rendered ground is good for odometry, and shows its friction, potholes, and what wheels leave."""

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from sensors.camera.image_formation import NoiseBank, grey
from sensors.camera.rig import StereoCalibration, ground_watching_pair
from sensors.messages import ColourImage
from sensors.render import StereoRenderer
from sensors.render.pair import levels_of
from sensors.textures import ground_detail
from sensors.world.ground import Centreline, Landscape, condition_of, line_map, road_map
from sensors.world.world import ReformedGround, World
from tests.sensors.conftest import SURFACE
from tests.sensors.test_render import points_seen
from vehicle.frames import FloatArray, inverse, rotation_zyx, transform
from vehicle.surface import (
    Friction,
    FrictionPatch,
    PatchedFriction,
    Potholes,
    Roughness,
    RoughProfile,
    SplitFriction,
    Surface,
)

STRAIGHT = SURFACE.pose_on(-12.0, 0.0, 0.0, (0.0, -8.0))  # X_WB on the straight before the roundabout


def from_above(world: World, *, height: float, size: int) -> FloatArray:
    """Grey image (size, size) of the ground around the origin of W, ``height`` metres wide, from that far up."""
    looking_down = transform(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, height]))
    middle = 0.5 * (size - 1)
    camera = StereoCalibration(
        width=size, height=size, focal_length=float(size), cx=middle, cy=middle, baseline=0.5, X_SC=looking_down
    )
    renderer = StereoRenderer(world, camera)
    image = grey(renderer.render(np.eye(4))[0])
    renderer.close()
    return image.astype(float)


def largest_repeat(image: FloatArray, *, beyond: int) -> float:
    """Highest autocorrelation coefficient at any shift of more than ``beyond`` and less than half the image [px]."""
    detail = image - cv2.GaussianBlur(image, (0, 0), 0.25 * beyond)
    padded = np.zeros((2 * image.shape[0], 2 * image.shape[1]))
    inside = padded.copy()
    padded[: image.shape[0], : image.shape[1]] = detail - detail.mean()
    inside[: image.shape[0], : image.shape[1]] = 1.0
    correlation = np.fft.irfft2(np.abs(np.fft.rfft2(padded)) ** 2) / detail.var()
    overlap = np.maximum(np.fft.irfft2(np.abs(np.fft.rfft2(inside)) ** 2), 0.25 * image.size)
    shift = np.hypot(*np.meshgrid(np.fft.fftfreq(len(padded)), np.fft.fftfreq(len(padded)))) * len(padded)
    return float((correlation / overlap)[(shift > beyond) & (shift < 0.5 * len(image))].max())


@pytest.mark.slow
@pytest.mark.parametrize("on_road", [True, False])
def test_texture_does_not_repeat(bare_world: World, on_road: bool) -> None:
    """Seen from above, 80 m of ground look nowhere like another place: a repeat is poison to matching.

    The detail's own period is 12 m; without its bending the autocorrelation there is 0.58.
    """
    edge = np.full_like(bare_world.road.edge_distance, -3.0 if on_road else 15.0)  # all road, or none
    flat = np.full_like(edge, 0.5)
    world = replace(bare_world, road=replace(bare_world.road, edge_distance=edge, gravel=flat))
    image = from_above(world, height=80.0, size=1024)
    assert image.std() > 4.0  # [grey levels] or there is nothing to repeat
    assert largest_repeat(image, beyond=12) < 0.3


def frame(renderer: StereoRenderer, X_WB: FloatArray, rng: np.random.Generator) -> NDArray[np.uint8]:
    """Left image with noise of 2 grey levels."""
    image = grey(renderer.render(X_WB)[0])
    return NoiseBank.draw(rng, 2.0, image.size).added_to(image, rng)


@pytest.mark.slow
def test_ground_is_full_of_corners(renderer: StereoRenderer, calibration: StereoCalibration) -> None:
    """Buckets of 50 x 50 px have a corner far stronger than noise makes them: all nearer than 22 m, most up to 38 m."""
    rng = np.random.default_rng(0)
    response = cv2.cornerMinEigenVal(frame(renderer, STRAIGHT, rng), 5)
    grey_card = np.full((calibration.height, calibration.width), 128, dtype=np.uint8)
    noise = cv2.cornerMinEigenVal(NoiseBank.draw(rng, 2.0, grey_card.size).added_to(grey_card, rng), 5)
    buckets = response[240:390, :1300].reshape(3, 50, 26, 50).max(axis=(1, 3))  # down to the image's lower edge
    strong = buckets > 5.0 * np.quantile(noise, 0.99)
    assert strong[0].mean() > 0.6  # the farthest row, where grass is nearly smooth
    assert strong[1:].mean() > 0.95


def test_tracked_points_land_where_the_ground_went(renderer: StereoRenderer, calibration: StereoCalibration) -> None:
    """Pyramidal Lucas-Kanade over a motion of 0.28 m (10 km/h at 10 frames/s), against truth from depth."""
    rng = np.random.default_rng(1)
    forward = transform(np.eye(3), np.array([0.28, 0.0, 0.0]))
    before, after = frame(renderer, STRAIGHT, rng), frame(renderer, STRAIGHT @ forward, rng)
    depth = renderer.render_depth_from(*renderer.cameras(STRAIGHT))[0]
    ground = (depth < 40.0).astype(np.uint8)
    ground[:225] = 0  # things stand out above the ground's horizon
    corners = cv2.goodFeaturesToTrack(before, 600, 0.01, 8, mask=ground)[:, 0]
    start = np.empty_like(corners)
    tracked, found, _ = cv2.calcOpticalFlowPyrLK(before, after, corners, start, winSize=(13, 13), maxLevel=3)
    v, u = np.round(corners.T[::-1]).astype(int)
    Z = depth[v, u]
    rays = np.column_stack([(corners - (calibration.cx, calibration.cy)) / calibration.focal_length, np.ones(len(u))])
    motion = inverse(forward @ calibration.X_SC) @ calibration.X_SC
    moved = (rays * Z[:, None]) @ motion[:3, :3].T + motion[:3, 3]
    expected = moved[:, :2] / moved[:, 2:] * calibration.focal_length + (calibration.cx, calibration.cy)
    inside = (np.abs(expected - (671.5, 195.0)) < (665.0, 188.0)).all(axis=1)
    good = (found[:, 0] == 1) & (np.hypot(*(tracked - expected).T) < 0.5)
    assert inside.sum() > 100
    assert good[inside].mean() > 0.80


# Lines between lanes on the map of the road, and in pictures


def arc_with_lines(radius: float = 30.0) -> tuple[FloatArray, FloatArray]:
    """A quarter of a circle about the origin, a broken line in its middle and a solid one 3.5 m to its right."""
    angles = np.arange(0.0, 0.5 * math.pi, 0.25 / radius)
    centre = radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    return centre, np.tile([[-3.5, 0.0], [0.0, 1.0]], (len(centre), 1, 1))


def test_the_map_holds_distances_from_lines() -> None:
    """Interpolated between its nodes: zero on both lines, right within 1 mm close to them, and no line elsewhere."""
    centre, lines = arc_with_lines()
    line = Centreline(centre, 6.0)
    road = road_map(np.random.default_rng(0), line, np.full(2, -10.0), np.full(2, 50.0))
    table = line_map(road, centre, lines)
    assert table is not None

    def at(radius: FloatArray, angle: FloatArray) -> FloatArray:
        xy = radius * np.stack([np.cos(angle), np.sin(angle)])
        nodes = (xy[::-1] - road.origin[::-1, None]) / road.cell
        return np.stack([map_coordinates(table[..., i], nodes, order=1) for i in range(2)])

    angles = np.linspace(0.1, 1.4, 400)
    for place in (30.0, 33.5):
        for aside in (-0.1, 0.0, 0.1):
            across, _ = at(place + aside + 0.0 * angles, angles)
            assert np.abs(np.abs(across) - abs(aside)).max() < 2e-3
    assert (at(33.5 + 0.0 * angles, angles)[1] > 0.0).all()
    painted = at(30.0 + 0.0 * angles, angles)[1] > 0.0
    along = 30.0 * angles
    assert painted == pytest.approx((along % 12.0 < 1.5) | (along % 12.0 > 10.5))
    everywhere = at(np.repeat(np.linspace(25.0, 35.0, 201), 400), np.tile(angles, 201)).reshape(2, 201, 400)
    radii = np.linspace(25.0, 35.0, 201)
    lined = ((np.abs(everywhere[0]) < 0.06) & (everywhere[1] > 0.0)).any(axis=1)
    assert radii[lined].tolist() == pytest.approx([29.95, 30.0, 30.05, 33.45, 33.5, 33.55])


def test_lines_are_seen_where_they_are(bare_world: World) -> None:
    """From above: two bright stripes 3.5 m apart, one of them with gaps, and nothing else differs from no lines."""
    edge = np.full_like(bare_world.road.edge_distance, -3.0)
    road = replace(bare_world.road, edge_distance=edge)
    centre = np.column_stack([np.arange(-30.0, 30.5, 0.5), np.zeros(121)])
    lines = np.tile([[-3.5, 0.0], [0.0, 1.0]], (len(centre), 1, 1))
    size = 320  # [px] for 20 m
    with_lines, without = (
        from_above(replace(bare_world, road=replace(road, lines=table)), height=20.0, size=size)
        for table in (line_map(road, centre, lines), None)
    )
    across = (with_lines - without).mean(axis=1)
    y = (0.5 * (size - 1) - np.arange(size)) / 16.0  # [m]
    solid, broken = (np.abs(y - place) < 0.1 for place in (-3.5, 0.0))
    assert across[solid].mean() > 30.0
    assert across[broken].mean() == pytest.approx(0.25 * across[solid].mean(), rel=0.4)  # 3 m of 12, 20 m in view
    assert np.abs(across[~(np.abs(y + 3.5) < 0.3) & ~(np.abs(y) < 0.3)]).max() == 0.0


LEVEL = Surface(friction=0.8)
SLOPE = Surface(friction=0.8, cross_fall=0.025, centre=(0.0, 10.0))  # as in conftest.py
POSE = SLOPE.pose_on(-12.0, 0.0, 0.0, (0.0, -8.0))  # cameras 25.6 m before the circle, looking back along the entry
MIDDLE = (-37.0, 0.5)  # of what is there to be seen, 11 m from the cameras, which see the ground from 9 m on [m]


@pytest.fixture(scope="module")
def plain(bare_world: World, calibration: StereoCalibration) -> ColourImage:
    return seen(bare_world, calibration)


@pytest.fixture(scope="module")
def places(bare_world: World, calibration: StereoCalibration) -> FloatArray:
    """x, y in W of what each pixel shows (height, width, 2) [m], far away where it is not the ground."""
    renderer = StereoRenderer(bare_world, calibration)
    depth = renderer.render_depth_from(*renderer.cameras(POSE))[0]
    renderer.close()
    return points_seen(depth, calibration, POSE @ calibration.X_SC)[..., :2]


def seen(world: World, calibration: StereoCalibration) -> ColourImage:
    renderer = StereoRenderer(world, calibration)
    image = renderer.render(POSE)[0][..., :3]
    renderer.close()
    return image


def with_condition(world: World, surface: Surface) -> World:
    return replace(world, condition=condition_of(surface, world.road))


def changed(image: ColourImage, plain: ColourImage) -> NDArray[np.bool_]:
    return np.asarray(np.abs(image.astype(int) - plain).max(axis=-1) > 3)  # [levels] of 8-bit rounding: 1


@pytest.mark.slow
@pytest.mark.parametrize(
    ("friction", "tint"),
    [(0.12, (0, 1, 2)), (0.35, (2, 1, 0))],  # ice is blue, mud is brown: channels from the weakest to the strongest
)
def test_a_patch_is_seen_where_it_is_and_nowhere_else(
    bare_world: World,
    calibration: StereoCalibration,
    plain: ColourImage,
    places: FloatArray,
    friction: float,
    tint: tuple[int, ...],
) -> None:
    """A circle of 2 m on the road, in the colour of its friction; ragged by less than the map's cell."""
    patch = PatchedFriction(0.8, [FrictionPatch(x=MIDDLE[0], y=MIDDLE[1], rounding=2.0, friction=friction)])
    image = seen(with_condition(bare_world, Surface(friction=patch)), calibration)
    distance = np.linalg.norm(places - MIDDLE, axis=-1)
    inside, beyond = distance < 1.75, distance > 2.5  # [m] of the outline, more than a cell of 0.25 m and its mipmap
    assert inside.sum() > 2000
    assert changed(image, plain)[inside].mean() > 0.9
    assert not changed(image, plain)[beyond].any()
    level = image[inside].astype(float).mean(axis=0) - plain[inside].astype(float).mean(axis=0)
    assert tuple(np.argsort(level)) == tint


def test_a_wet_lane_is_darker_than_the_dry_one(
    bare_world: World, calibration: StereoCalibration, plain: ColourImage, places: FloatArray
) -> None:
    """Split along the entry, y = 0: near the cameras the wet side has lost a third of its light, the dry none."""
    line = np.array([[-60.0, 0.0], [60.0, 0.0]])
    world = with_condition(bare_world, Surface(friction=SplitFriction(0.5, 0.8, line)))
    image = seen(world, calibration)
    near = np.linalg.norm(places - MIDDLE, axis=-1) < 6.0
    wet, dry = near & (places[..., 1] > 0.6) & (places[..., 1] < 3.0), near & (places[..., 1] < -0.6)
    assert image[wet].mean() < 0.8 * plain[wet].mean()
    assert np.array_equal(image[dry], plain[dry])


def test_a_pothole_is_a_dark_hole_of_its_size(
    bare_world: World, calibration: StereoCalibration, plain: ColourImage, places: FloatArray
) -> None:
    """0.8 m wide, 80 mm deep: rubble and shadow inside, cracks around it, the road as ever from 1.5 radii on."""
    hole = Potholes(*(np.array([value]) for value in (*MIDDLE, 0.8, 0.08)))
    image = seen(with_condition(bare_world, Surface(friction=0.8, roughness=Roughness(potholes=hole))), calibration)
    distance = np.linalg.norm(places - MIDDLE, axis=-1)
    inside, beyond = distance < 0.3, distance > 0.85
    assert inside.sum() > 150
    assert image[inside].mean() < 0.8 * plain[inside].mean()
    assert not changed(image, plain)[beyond].any()


def test_ground_of_one_friction_without_holes_is_drawn_as_before(bare_world: World) -> None:
    """Nothing is looked up for what is not there, however slippery; the frames of such a world stay what they were."""
    for surface in (LEVEL, Surface(friction=0.2), Surface(friction=0.8, roughness=Roughness())):
        condition = condition_of(surface, bare_world.road)
        assert condition.looks is None
        assert condition.holes is None


@pytest.mark.parametrize(("friction", "look"), [(0.8, None), (0.55, 0), (0.35, 1), (0.15, 2)])
def test_friction_decides_the_look(bare_world: World, friction: float, look: int | None) -> None:
    """Dry, wet, muddy, icy on the road; and meadows beyond are left alone."""
    everywhere: Friction = PatchedFriction(0.8, [FrictionPatch(x=0.0, y=0.0, rounding=400.0, friction=friction)])
    looks = condition_of(Surface(friction=everywhere), bare_world.road).looks
    assert looks is not None
    expected = np.zeros(3)
    if look is not None:
        expected[look] = 1.0
    on_road = bare_world.road.edge_distance < 0.0
    np.testing.assert_allclose(looks[on_road], np.broadcast_to(expected, looks[on_road].shape), atol=1e-6)  # float32
    assert looks[bare_world.road.edge_distance > 10.0].max() == 0.0


def test_every_pothole_is_found_from_all_around_it() -> None:
    """Each node of the map near a hole names it: its middle, its radius and its depth."""
    rng = np.random.default_rng(0)
    line = Centreline(np.array([[0.0, 0.0], [40.0, 0.0]]), 4.0)
    road = road_map(rng, line, np.array([-20.0, -20.0]), np.array([60.0, 20.0]))
    holes = Potholes(np.array([5.0, 30.1]), np.array([1.0, -2.2]), np.array([0.9, 0.4]), np.array([0.08, 0.03]))
    table = condition_of(Surface(friction=0.8, roughness=Roughness(potholes=holes)), road).holes
    assert table is not None
    for i in range(2):
        around = np.arange(-1, 2) * 0.5 * holes.diameter[i]
        column = np.round((holes.x[i] + around - road.origin[0]) / road.cell).astype(int)
        row = np.round((holes.y[i] + around - road.origin[1]) / road.cell).astype(int)
        hole = (holes.x[i], holes.y[i], 0.5 * holes.diameter[i], holes.depth[i])
        np.testing.assert_allclose(table[np.ix_(row, column)], np.broadcast_to(hole, (3, 3, 4)), rtol=1e-6)  # float32
    assert np.unique(table[..., 2]) == pytest.approx([0.2, 0.45, 1.0])  # the last one: there is none


def test_the_drawn_ground_rises_and_falls_with_a_rough_road() -> None:
    """Rendered and driven heights agree, except for potholes, which are narrower than a triangle."""
    profile = RoughProfile(np.random.default_rng(0), "D")
    holes = Potholes(*(np.array([value]) for value in (0.0, 0.0, 0.8, 0.08)))
    surface = Surface(friction=0.8, grade=0.03, roughness=Roughness(profile=profile, potholes=holes))
    landscape = Landscape(np.random.default_rng(0), surface, np.zeros(2), np.ones(2))
    xy = np.random.default_rng(1).uniform(-40.0, 40.0, (50, 2))
    xy[0] = 0.0
    expected = 0.03 * xy[:, 0] + profile.height(xy[:, 0], xy[:, 1])
    np.testing.assert_allclose(landscape.height(xy), expected, atol=1e-12)  # sums in another order


# Cameras under the trailer: where they look, and ground that wheels leave different


RIG = ground_watching_pair(200, 160, math.radians(70.0), front_x=-1.5, rear_x=-13.5, z=1.0)
WHEELS = np.array([[-8.0, 1.0], [-8.0, -1.0]])
FLAT = Surface(friction=0.8)


class PaintedGround:
    """A source whose pixels carry where on the ground they look, W of x and y in centimetres modulo 256."""

    calibration = RIG

    def render(self, X_WB: FloatArray) -> tuple[ColourImage, ColourImage]:
        X_WCl = X_WB @ self.calibration.X_SC
        left, right = (painted(self.calibration, X_WC) for X_WC in (X_WCl, X_WCl @ self.calibration.X_ClCr))
        return left, right


def looked_at(c: StereoCalibration, X_WC: FloatArray) -> FloatArray:
    """W of the ground z = 0 behind every pixel (height, width, 2) [m]."""
    v, u = np.mgrid[0 : c.height, 0 : c.width]
    rays = np.stack([(u - c.cx) / c.focal_length, (v - c.cy) / c.focal_length, np.ones(u.shape)], axis=-1)
    along = rays @ X_WC[:3, :3].T
    return np.asarray(X_WC[:2, 3] - X_WC[2, 3] / along[..., 2:] * along[..., :2])


def painted(c: StereoCalibration, X_WC: FloatArray) -> ColourImage:
    centimetres = np.floor(100.0 * looked_at(c, X_WC)) % 256
    return np.concatenate([centimetres, np.zeros((c.height, c.width, 1))], axis=-1).astype(np.uint8)


def body(x: float, y: float = 0.0, yaw: float = 0.0) -> FloatArray:
    return transform(rotation_zyx(yaw, 0.0, 0.0), np.array([x, y, 0.0]))


def test_both_cameras_look_straight_down_from_where_they_hang() -> None:
    """The middle of each image is the ground right below; columns run to the rear, rows to the left."""
    c = RIG
    for X_SC, x in ((c.X_SC, -1.5), (c.X_SC @ c.X_ClCr, -13.5)):
        seen = looked_at(c, X_SC)
        np.testing.assert_allclose(seen.mean(axis=(0, 1)), [x, 0.0], atol=1e-9)
        assert seen[80, 150, 0] < seen[80, 50, 0]
        assert seen[120, 100, 1] > seen[40, 100, 1]
    width = 2.0 * math.tan(math.radians(35.0)) * 199 / 200  # between the centres of the outer pixels, 1 m up
    assert np.ptp(looked_at(c, c.X_SC)[..., 0]) == pytest.approx(width)


def driven(ground: ReformedGround, way: float) -> tuple[ColourImage, ColourImage]:
    for x in np.arange(0.0, way, 0.5):
        ground.render(body(x))
    return ground.render(body(way))


def test_only_what_wheels_have_rolled_on_looks_different() -> None:
    """At y = +-0.5 m wheels 0.4 m wide leave strips in the rear view; the front camera is ahead of them."""
    ground = ReformedGround(PaintedGround(), FLAT, [np.array([[-8.0, 0.5], [-8.0, -0.5]])], width=0.4)
    left, right = driven(ground, 20.0)
    plain_left, plain_right = PaintedGround().render(body(20.0))
    np.testing.assert_array_equal(left, plain_left)
    different = (right != plain_right).any(axis=-1)
    y = looked_at(RIG, body(20.0) @ RIG.X_SC @ RIG.X_ClCr)[..., 1]
    pixel = 0.008  # two pixels: drawn lines have round ends and whole thicknesses [m]
    assert different[np.abs(np.abs(y) - 0.5) < 0.2 - pixel].all()
    assert not different[np.abs(np.abs(y) - 0.5) > 0.2 + pixel].any()


def test_reformed_ground_stays_where_it_is() -> None:
    ground = ReformedGround(PaintedGround(), FLAT, [WHEELS], width=2.2)
    _, before = driven(ground, 20.0)
    c = RIG
    shift = round(0.1 * c.focal_length)  # 10 cm at 1 m [px]
    _, after = ground.render(body(20.0 + shift / c.focal_length))
    same = (before[:, :-shift].astype(int) - after[:, shift:].astype(int))[..., :2]
    assert (np.abs(same) <= 1).mean() > 0.99  # whole centimetres may flip by rounding


def test_flowing_ground_moves_along_with_the_vehicle() -> None:
    """At a tenth of the vehicle's velocity a pattern passes the camera at nine tenths of it."""
    ground = ReformedGround(PaintedGround(), FLAT, [WHEELS], width=2.2, flow=0.1)
    _, before = driven(ground, 20.0)
    _, after = ground.render(body(20.5))
    moved = (after[80, 100, 0].astype(int) - before[80, 100, 0].astype(int)) % 256
    assert moved == pytest.approx(45, abs=1)  # [cm]


def test_ground_that_one_group_left_is_changed_again_by_the_next() -> None:
    """Two groups on the same strip: what the rear camera sees is neither as it was nor as the first one left it."""
    first, second = (np.array([[x, 0.0]]) for x in (-4.0, -8.0))
    pictures = [
        driven(ReformedGround(PaintedGround(), FLAT, groups, width=2.2), 20.0)[1]
        for groups in ([first], [first, second])
    ]
    middle = [picture[80, 100, :2].astype(int) for picture in (PaintedGround().render(body(20.0))[1], *pictures)]
    assert not (middle[0] == middle[1]).all()
    assert not (middle[0] == middle[2]).all()
    assert not (middle[1] == middle[2]).all()


def test_samples_between_the_texels_of_a_level_keep_the_contrast_of_the_colours_there() -> None:
    """Compares bilinear samples, half a texel apart, with means over a texel. Without sharpening the gain is 0.83."""
    image = ground_detail(np.random.default_rng(4), 256)
    levels, _ = levels_of(image, 2)
    gravel, half = image[..., 2].astype(float), levels[2:130, 262:390, 2].astype(float)  # margins are 2 px wide
    means = np.mean([np.roll(gravel, (-i, -j), axis=(0, 1)) for i in (0, 1) for j in (0, 1)], axis=0)
    samples = map_coordinates(half, np.mgrid[0:256, 0:256] / 2.0, order=1, mode="grid-wrap")
    gain = np.cov(samples.ravel(), means.ravel())[0, 1] / means.var()
    assert gain == pytest.approx(1.0, abs=0.06)
    assert samples.mean() == pytest.approx(means.mean(), abs=0.3)
