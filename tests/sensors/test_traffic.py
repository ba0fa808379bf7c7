"""Traffic: vehicles keep to the ways they are said to, out of the trailer, and are seen as geometry with shadows."""

import math
from collections.abc import Callable, Iterator

import numpy as np
import pytest

from sensors.camera.rig import StereoCalibration
from sensors.render import StereoRenderer
from sensors.world.scenery import Instances
from sensors.world.things import Thing
from sensors.world.traffic import Traffic, TrafficKind, car, lorry, populated, vehicle_textures
from sensors.world.world import World
from tests.sensors.conftest import SURFACE
from tests.trailers import truth as truth_at
from vehicle.clock import TICK
from vehicle.combination.truth import Truth
from vehicle.frames import FloatArray

FOLLOW, HALF_WIDTH, SPEED = 14.0, 1.275, 4.0


def on_cone(xy: FloatArray) -> FloatArray:
    return SURFACE.height(xy[:, 0], xy[:, 1])


def traffic(
    kind: TrafficKind, seed: int = 1, gap: float = 5.0, height: Callable[[FloatArray], FloatArray] = on_cone
) -> Traffic:
    """Traffic, by default on the ground of conftest.py."""
    rng = np.random.default_rng(seed)
    return Traffic(rng, kind=kind, gap=gap, follow_distance=FOLLOW, half_width=HALF_WIDTH, height=height)


def truth(time: float, pose: tuple[float, float, float]) -> Truth:
    body = np.eye(4)
    c, s = math.cos(pose[2]), math.sin(pose[2])
    body[:2, :2], body[:2, 3] = [[c, -s], [s, c]], pose[:2]
    return truth_at(round(time / TICK), poses=np.array([pose]), bodies=body[None])


def straight(time: float) -> Truth:
    return truth(time, (SPEED * time, 0.0, 0.0))


def turning(time: float, radius: float = 14.0) -> Truth:
    """A trailer whose hitch and rear go round one left circle."""
    psi = SPEED * time / radius
    half = math.asin(0.5 * FOLLOW / radius)
    at = psi + half
    return truth(time, (radius * math.sin(at), radius * (1.0 - math.cos(at)), psi))


def moments(until: float = 30.0) -> Iterator[float]:
    yield from np.arange(0.0, until, 0.1)


def middle(vehicle: Instances) -> FloatArray:
    place: FloatArray = vehicle.poses[0, :3, 3]
    return place


def test_a_follower_keeps_its_gap_behind_the_rear() -> None:
    """The bumper of the lorry, 5.25 m before its middle, is 5 m behind the cameras, give or take 0.4 m."""
    behind = []
    following = traffic("following")
    for time in moments():
        (vehicle,) = following.at(straight(time))
        behind.append(SPEED * time - FOLLOW - middle(vehicle)[0] - 5.25)
        assert abs(middle(vehicle)[1]) < 0.4
    assert np.min(behind) == pytest.approx(5.0 - 0.4, abs=0.1)
    assert np.max(behind) == pytest.approx(5.0 + 0.4, abs=0.1)


def test_a_follower_goes_where_the_rear_has_gone() -> None:
    """On a circle both its axles are at the circle's radius, up to its wandering by 0.2 m."""
    following = traffic("following")
    for time in moments():
        (vehicle,) = following.at(turning(time))
    for axle in (3.7, -3.0):
        place = vehicle.poses[0] @ np.array([axle, 0.0, 0.0, 1.0])
        assert math.hypot(place[0], place[1] - 14.0) == pytest.approx(14.0, abs=0.3)


@pytest.mark.parametrize("moved", [straight, turning])
@pytest.mark.parametrize("seed", [1, 2])
def test_who_overtakes_stays_clear_of_the_trailer(moved: Callable[[float], Truth], seed: int) -> None:
    """Bodies half as wide as a lorry, sides at least a metre from the trailer's, whichever way it turns."""
    overtaking, passed = traffic("overtaking", seed), 0
    for time in moments(40.0):
        now = moved(time)
        (vehicle,) = overtaking.at(now)
        if middle(vehicle)[2] < -100.0:
            continue
        in_trailer = np.linalg.inv(now.bodies[0]) @ vehicle.poses[0] @ np.array([[3.0, -3.0], [0, 0], [0, 0], [1, 1]])
        beside = (in_trailer[0] > -FOLLOW) & (in_trailer[0] < 0.0)
        assert (np.abs(in_trailer[1, beside]) > HALF_WIDTH + 1.0 + 1.25).all()
        passed += int(beside.any())
    assert passed > 20  # images of it beside the trailer: more than one has come past


def test_who_overtakes_in_a_turn_does_so_on_the_outside() -> None:
    """The right in a left turn, whatever the seed."""
    for seed in range(2):
        overtaking = traffic("overtaking", seed)
        for time in moments(40.0):
            (vehicle,) = overtaking.at(turning(time))
            if time > 20.0 and middle(vehicle)[2] > -100.0:
                assert math.hypot(middle(vehicle)[0], middle(vehicle)[1] - 14.0) > 14.0


def test_who_crosses_does_so_at_right_angles_behind() -> None:
    """Sideways at 6 m/s, never where the trailer is."""
    crossing, seen = traffic("crossing"), []
    for time in moments():
        (vehicle,) = crossing.at(straight(time))
        if middle(vehicle)[2] > -100.0:
            seen.append((time, *middle(vehicle)[:2]))
            assert middle(vehicle)[0] < SPEED * time - FOLLOW
    t, x, y = np.array(seen).T
    step = np.diff(t) < 0.15
    assert np.abs(np.diff(y)[step]) == pytest.approx(0.6, abs=0.01)
    assert np.abs(np.diff(x)[step]) == pytest.approx(0.0, abs=0.01)


def test_vehicles_stand_on_sloping_ground() -> None:
    """A ramp of 5 % tilts them by as much, and their wheels touch it."""
    on_ramp = traffic("following", height=lambda xy: 0.05 * xy[:, 0])
    for time in moments(5.0):
        (vehicle,) = on_ramp.at(straight(time))
    pose = vehicle.poses[0]
    assert pose[:3, :3] @ pose[:3, :3].T == pytest.approx(np.eye(3), abs=1e-12)
    for axle in (3.7, -3.0):
        wheel = pose @ np.array([axle, 1.0, 0.0, 1.0])
        assert wheel[2] == pytest.approx(0.05 * wheel[0], abs=0.02)


@pytest.mark.parametrize("build", [lorry, car])
def test_vehicles_are_closed_and_seen_from_outside(build: Callable[[np.random.Generator], Thing]) -> None:
    """Triangles wind the way their normals point, and every part's texture is there."""
    thing = build(np.random.default_rng(1))
    for part in thing.parts:
        assert part.texture in vehicle_textures(np.random.default_rng(1))
        a, b, c = (part.mesh.vertices[part.mesh.faces[:, k]] for k in range(3))
        facing = np.einsum("ij,ij->i", np.cross(b - a, c - a), part.mesh.normals[part.mesh.faces[:, 0]])
        assert (facing > 0.0).all()
        assert part.mesh.vertices[:, 2].min() >= -0.01


def test_a_lorry_hides_a_fifth_of_the_picture_and_shades_the_ground(
    bare_world: World, calibration: StereoCalibration
) -> None:
    """Beside a picture without it, in both eyes; farther away its shadow is seen, where no part of it is."""
    near_by, farther = traffic("following", gap=2.8), traffic("following", gap=9.0)
    now = truth(0.0, (-20.0, 0.0, 0.0))
    now.bodies[0, 2, 3] = SURFACE.height(-20.0, 0.0)
    shown = StereoRenderer(populated(bare_world, near_by), calibration)
    depths, pictures = [], []
    try:
        for vehicles in (near_by.hidden, near_by.at(now), farther.at(now)):
            shown.place(vehicles)
            pictures.append(shown.render(now.bodies[0]))
            depths.append(shown.render_depth_from(*shown.cameras(now.bodies[0])))
    finally:
        shown.close()
    for eye in (0, 1):
        hidden, hidden_far = (depths[k][eye] < 0.98 * depths[0][eye] for k in (1, 2))
        assert 0.2 < hidden.mean() < 0.5
        assert 0.02 < hidden_far.mean() < 0.1
        darker = pictures[2][eye].astype(int).sum(axis=2) < pictures[0][eye].astype(int).sum(axis=2) - 30
        assert np.count_nonzero(darker & ~hidden_far) > 500  # [px]
