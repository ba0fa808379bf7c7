"""The rendered ground is good for odometry: aperiodic, full of corners, and stable from frame to frame."""

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from sensors.camera.image_formation import NoiseBank, grey
from sensors.camera.rig import StereoCalibration
from sensors.render import StereoRenderer
from sensors.world.ground import Centreline, line_map, road_map
from sensors.world.world import World
from tests.sensors.conftest import SURFACE
from vehicle.frames import FloatArray, inverse, transform

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
