"""The world as plain data: where things stand, where the road runs, what the seed decides."""

import math
from collections.abc import Callable

import numpy as np
import pytest
import scipy

from sensors.world.ground import Centreline, RoadMap, road_map
from sensors.world.scenery import Instances
from sensors.world.sky import HIGHEST, LOWEST, daylight, panorama
from sensors.world.things import Mesh, blob, inside, massed
from sensors.world.world import World, build_world
from tests.sensors.conftest import CLEARANCE, RADIUS, ROAD_HALF_WIDTH, SURFACE
from vehicle.frames import FloatArray
from vehicle.surface import Surface


def _distance_from_way(points: FloatArray) -> FloatArray:
    """Distance [m] from the roundabout's centreline, from its geometry: a straight line and a circle."""
    on_line = np.hypot(np.maximum(np.abs(points[..., 0]) - 60.0, 0.0), points[..., 1])
    on_circle = np.abs(np.hypot(points[..., 0], points[..., 1] - RADIUS) - RADIUS)
    return np.minimum(on_line, on_circle)


def _vertices(instances: Instances) -> FloatArray:
    """All vertices (n, 3) of all instances in W."""
    own = np.concatenate([part.mesh.vertices for part in instances.thing.parts])
    turned = np.einsum("nij,mj->nmi", instances.poses[:, :3, :3], own)
    return np.asarray(turned + instances.poses[:, None, :3, 3]).reshape(-1, 3)


def _solid(world: World) -> list[Instances]:
    return [stand for stand in world.scenery if stand.thing.name != "kerb_stone"]


def test_nothing_but_kerb_stones_stands_within_the_clearance(world: World) -> None:
    """Trailers cut in; neither they nor their cameras may pass through a thing. Checked for every vertex."""
    nearest = min(_distance_from_way(_vertices(stand)[:, :2]).min() for stand in _solid(world))
    assert nearest > CLEARANCE - 0.01  # the circle's polygon of 400 corners is 0.3 mm off, shapes not at all
    assert nearest < CLEARANCE + 1.0  # or nothing near would give parallax


def test_kerbs_follow_the_outline_and_leave_the_crossing_free(world: World) -> None:
    """The arms of a road that meets itself merge: a kerb stone on the asphalt would be an obstacle."""
    (kerb,) = (stand for stand in world.scenery if stand.thing.name == "kerb_stone")
    distance = _distance_from_way(_vertices(kerb)[:, :2])
    assert distance.min() > ROAD_HALF_WIDTH - 0.05  # 10 mm of batter, 17 mm of sagitta, 20 mm let in
    assert distance.max() < ROAD_HALF_WIDTH + 0.2  # 125 mm wide
    assert _vertices(kerb)[:, 2].max() < 0.15  # low enough for any body to pass over [m]


def test_things_stand_on_the_ground(world: World) -> None:
    for stand in world.scenery:
        foot = stand.poses[:, :3, 3]
        near = _distance_from_way(foot) < 90.0
        height = SURFACE.height(foot[near, 0], foot[near, 1])
        np.testing.assert_allclose(foot[near, 2], height, atol=1e-9)  # the same function of the same numbers


def test_ground_mesh_lies_on_the_surface(world: World) -> None:
    """Its nodes do, up to 100 m beyond the course; its triangles as nearly as eyes that pass there can tell."""
    x, y, z = world.ground.vertices.T
    near = (np.abs(x) < 160.0) & (y > -100.0) & (y < 120.0)
    np.testing.assert_allclose(z[near], SURFACE.height(x[near], y[near]), atol=1e-9)  # the same function
    middles = world.ground.vertices[world.ground.faces].mean(axis=1)  # corners at equal heights have the largest sag
    beside = _distance_from_way(middles) < 12.0
    sag = np.abs(middles[:, 2] - SURFACE.height(middles[:, 0], middles[:, 1]))[beside]
    assert np.quantile(sag, 0.9) < 2.5e-3  # [m]
    assert sag.max() < 0.015  # at the cone's very tip a cell falls by c L/2 = 31 mm


def test_ground_mesh_covers_the_land_once(world: World) -> None:
    """Seen from above its triangles fill their bounding box without overlap, and all of them look up."""
    a, b, c = (world.ground.vertices[world.ground.faces[:, i], :2] for i in range(3))
    area = 0.5 * ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])
    assert area.min() > 0.0
    assert area.sum() == pytest.approx(np.prod(np.ptp(world.ground.vertices[:, :2], axis=0)))


@pytest.mark.slow
def test_flat_ground_takes_few_triangles(world: World, small_world: World) -> None:
    """Cells are fine near the tip of the cone, and not on a plane: each costs time in every image."""

    def width(of: World, middle: FloatArray) -> float:
        corners = of.ground.vertices[of.ground.faces][..., :2]
        near = np.linalg.norm(corners.mean(axis=1) - middle, axis=1) < 10.0
        return float(np.median(np.ptp(corners[near], axis=1)))

    assert width(world, np.array([0.0, RADIUS])) < 4.0  # [m]
    assert width(small_world, np.zeros(2)) > 10.0


def test_things_have_one_shape_at_every_distance(world: World) -> None:
    """Levels of detail follow each other without a gap in distance, and fill the same volume."""
    for stand in world.scenery:
        coarse = [part for part in stand.thing.parts if part.distances[0] > 0.0]
        for part in coarse:
            (fine,) = (
                p for p in stand.thing.nearest_parts if (p.texture, p.distances[1]) == (part.texture, part.distances[0])
            )
            assert len(part.mesh.faces) < len(fine.mesh.faces)
            for end in (np.min, np.max):
                shift = np.abs(end(part.mesh.vertices, axis=0) - end(fine.mesh.vertices, axis=0))
                assert shift.max() < 0.6  # [m] 8 px at 45 m: lumps are uneven by 15 %, and pentagons


def test_density_zero_is_bare_ground(bare_world: World) -> None:
    """No things at all, not even kerbs or their shadows, but ground and sky all the same."""
    assert bare_world.scenery == ()
    assert bare_world.road.light.min() > 0.9999  # of blurring ones
    assert bare_world.panorama.std() > 5.0  # grey levels; a sky of one colour has none


def test_road_map_holds_the_distance_from_the_edge(world: World) -> None:
    road = world.road
    rows, columns = road.edge_distance.shape
    x, y = road.origin[0] + road.cell * np.arange(columns), road.origin[1] + road.cell * np.arange(rows)
    expected = _distance_from_way(np.stack(np.meshgrid(x, y), axis=-1)) - ROAD_HALF_WIDTH
    near = expected < 10.0
    error = np.abs(road.edge_distance - expected)[near & (expected > -3.5)]
    assert error.max() < 2e-3  # [m] points every 50 mm and a polygon of 400 corners: 0.3 mm each


def test_road_map_of_a_long_road_is_complete_and_bounded() -> None:
    """30 km: cells are narrower than half the road, so the nodes around an edge are on its side of the middle."""
    road, half_width = _map_over((30_000.0, 0.0)), 4.5
    assert road.cell < half_width
    assert max(road.light.shape) < 8192  # with its coarser levels beside it, 16384
    u = (np.linspace(100.0, 29_900.0, 999) - road.origin[0]) / road.cell
    v = np.full(999, (half_width - road.origin[1]) / road.cell)
    assert np.abs(scipy.ndimage.map_coordinates(road.edge_distance, [v, u], order=1)).max() < 0.01


def test_road_map_of_wide_cells_has_no_gap(monkeypatch: pytest.MonkeyPatch) -> None:
    """A course 30 km wide has cells of 7 m, which show no wave of 12 m; here fewer nodes do the same."""
    monkeypatch.setattr("sensors.world.ground._MAP_NODES", 1 << 16)
    road = _map_over((1800.0, 1800.0))
    assert 7.0 < road.cell < 7.5
    assert road.light.size < 1.2 * 2**16  # whole cells, and sides that are quickly transformed
    assert all(np.isfinite(layer).all() for layer in (road.edge_distance, road.gravel, road.lushness))


def _map_over(end: tuple[float, float]) -> RoadMap:
    """Map of a straight road of 9 m from W's origin."""
    line = Centreline(np.array([[0.0, 0.0], end]), 4.5)
    return road_map(np.random.default_rng(1), line, np.array([-20.0, -20.0]), np.array(end) + 20.0)


def test_a_crossing_centreline_is_near_to_both_arms() -> None:
    cross = Centreline(np.array([[-20.0, 0.0], [20.0, 0.0], [20.0, 20.0], [0.0, 20.0], [0.0, -20.0]]))
    np.testing.assert_allclose(
        cross.distance(np.array([[3.0, -5.0], [-7.0, 2.0]])), [3.0, 2.0], atol=1e-3
    )  # 50 mm steps


def test_shadows_fall_away_from_the_sun(world: World) -> None:
    (tree, *_) = (stand for stand in world.scenery if stand.thing.name == "broadleaf")
    towards = world.light.direction[:2] / np.linalg.norm(world.light.direction[:2])

    def light_at(points: FloatArray) -> FloatArray:
        index = np.round((points - world.road.origin) / world.road.cell).astype(int)
        inside = ((index >= 0) & (index < world.road.light.shape[::-1])).all(axis=1)
        return np.asarray(world.road.light[index[inside, 1], index[inside, 0]], dtype=np.float64)

    foot = tree.poses[:, :2, 3]
    assert light_at(foot - 6.0 * towards).mean() < 0.4  # crowns 5.4 m up throw their shadow some 6 m away
    assert light_at(foot + 6.0 * towards).mean() > 0.7  # now and then that of another tree


def _small(seed: int, **changes: object) -> World:
    arguments = {"road_half_width": 3.0, "scenery_density": 0.3, "clearance": 8.0, **changes}
    return build_world(
        rng=np.random.default_rng(seed),
        centreline=np.array([[0.0, 0.0], [10.0, 0.0]]),
        surface=Surface(friction=0.8),
        **arguments,  # type: ignore[arg-type]  # one dict of several types keeps the cases below short
    )


@pytest.fixture(scope="module")
def small_world() -> World:
    return _small(2)


# Meshes of overlapping lumps: what is inside of others is left out, and nothing else


def ball(x: float, radius: float = 1.0) -> Mesh:
    """A ball about (x, 0, 0), as 12 meridians and 8 rings."""
    rng = np.random.default_rng(0)
    return blob(rng, (x, 0.0, 0.0), (radius, radius, radius), rings=8, sides=12, roughness=0.0)


def test_a_ball_encloses_what_is_nearer_than_its_radius() -> None:
    """But for the sagitta of its facets."""
    points = np.random.default_rng(1).uniform(-1.5, 1.5, size=(2000, 3))
    r = np.linalg.norm(points, axis=1)
    enclosed = inside(ball(0.0), points)
    assert enclosed[r < 0.93].all()  # cos(pi/12) cos(pi/16) = 0.95
    assert not enclosed[r > 1.0].any()


def test_hidden_triangles_are_left_out() -> None:
    """Of two balls half a radius apart neither has a triangle well inside the other; the outside stays closed."""
    balls = ball(-0.25), ball(0.25)
    mass = massed(*balls)
    middles = mass.vertices[mass.faces].mean(axis=1)
    for other, x in zip(balls, (-0.25, 0.25), strict=True):
        deep = np.linalg.norm(middles - [x, 0.0, 0.0], axis=1) < 0.7
        assert not deep.any()
        corners = other.vertices[other.faces]
        seen = (np.linalg.norm(corners + np.array([x, 0.0, 0.0]), axis=2) > 1.0).all(axis=1)  # out of the other ball
        seen &= np.linalg.norm(np.cross(*np.diff(corners, axis=1).swapaxes(0, 1)), axis=1) > 1e-6  # poles have no area
        kept = np.linalg.norm(corners[seen].mean(axis=1)[:, None] - middles, axis=2).min(axis=1)
        assert kept.max() < 1e-9


def test_a_ball_within_another_is_never_seen() -> None:
    outer = ball(0.0)
    assert np.abs(massed(outer, ball(0.1, 0.4)).vertices).max() == np.abs(outer.vertices).max()
    assert len(massed(outer, ball(0.1, 0.4)).faces) == len(massed(outer).faces)


# Position and light of the sun, and their effect on the rendered world


@pytest.mark.parametrize(
    ("compass", "towards"), [(0.0, (0.0, 1.0)), (90.0, (1.0, 0.0)), (180.0, (0.0, -1.0)), (270.0, (-1.0, 0.0))]
)
def test_azimuth_is_read_as_on_a_compass(compass: float, towards: tuple[float, float]) -> None:
    light = daylight(1.0, azimuth=math.radians(compass), elevation=math.radians(30.0))
    np.testing.assert_allclose(light.direction[:2] / math.cos(math.radians(30.0)), towards, atol=1e-12)
    assert light.direction[2] == pytest.approx(0.5)


def test_a_low_sun_is_dim_and_red() -> None:
    """Its light has come through more air, which takes most from the blue."""
    noon, evening = (daylight(0.0, elevation=math.radians(degrees)) for degrees in (43.0, 8.0))
    kept = np.array(evening.sun_colour) / np.array(noon.sun_colour)
    assert 1.0 > kept[0] > kept[1] > kept[2] > 0.0
    assert kept[2] < 0.5


def test_clouds_leave_no_sun() -> None:
    """Light comes from everywhere, and more of it than from a clear sky."""
    light = daylight(0.0, overcast=True)
    assert light.sun_colour == (0.0, 0.0, 0.0)
    assert min(light.sky_colour) > max(daylight(0.0).sky_colour)


@pytest.mark.slow
def test_the_sun_is_drawn_where_it_stands() -> None:
    """The brightest place of the panorama, whose columns go round from W's x, its rows down from the highest."""
    light = daylight(0.0, azimuth=math.radians(200.0), elevation=math.radians(20.0))
    sky = panorama(np.random.default_rng(0), light)
    plain = panorama(np.random.default_rng(0), daylight(0.0))
    rows, columns = sky.shape[:2]
    column = round((90.0 - 200.0) % 360.0 / 360.0 * columns)
    row = round((HIGHEST - math.radians(20.0)) / (HIGHEST - LOWEST) * (rows - 1))
    assert sky[row, column].min() > 230
    assert sky[row, column].astype(int).sum() >= plain[row, column].sum()
    opposite = (column + columns // 2) % columns
    assert sky[row, opposite].mean() < plain[row, opposite].mean() + 1.0


@pytest.mark.slow
def test_shadows_are_long_in_the_evening(world: World, built_in: Callable[..., World]) -> None:
    """At 10 degrees they are five and a half times as long as things are high: much more of the land lies in them.

    At the usual 43 degrees they are as long as things are high.
    """
    evening = built_in(sun_elevation=math.radians(10.0)).road.light
    assert (evening < 0.5).mean() > 2.5 * (world.road.light < 0.5).mean()
