"""Camera behind a rover's wheel: sand, trace, wheel and shadows are at the places that geometry gives."""

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest

from sensors.messages import ColourImage, GreyImage
from sensors.sand.rover_pass import RoverPass, route_of
from sensors.sand.solids import Casters
from sensors.sand.trace_camera import GroundView, TraceCamera, VisibleGround, Webcam
from sensors.sand.trace_rig import TraceRig, nominal_rig
from sensors.sand.world import SandWorld, Sun
from vehicle.engine.compiler import compiler
from vehicle.frames import FloatArray, inverse, rotation_zyx, transform
from vehicle.rover.description import Rover, load_rover
from vehicle.rover.terrain import Terrain
from vehicle.rover.truth import RoverTruth

SLOPE = Terrain(slope_x=0.03, slope_y=math.tan(math.radians(5.0)))
LEFT = Sun(azimuth=math.radians(100.0), elevation=math.radians(40.0))  # keeps the rover's own shadow out of view
PLAIN = Webcam(read_noise=0.0, shot_noise=0.0, blur=0.0, exposure_time=0.0, exposure=None, jpeg_quality=None)
FRAMES = 60  # 1 m: the trace is as long as the view


@pytest.fixture(scope="module")
def rover() -> Rover:
    return load_rover("el_dorado_ii")


@pytest.fixture(scope="module")
def rig(rover: Rover) -> TraceRig:
    return nominal_rig(rover)


@pytest.fixture(scope="module")
def truths(rover: Rover) -> list[RoverTruth]:
    """A metre across a slope."""
    return RoverPass(frames=FRAMES, profile="none").truths(rover, SLOPE, np.random.default_rng(3))


@pytest.fixture(scope="module")
def sand(rover: Rover, truths: list[RoverTruth]) -> SandWorld:
    """Uniform sand with the traces of that metre."""
    world = world_of(rover, truths, LEFT)
    world.drive(truths)
    return world


def world_of(rover: Rover, truths: list[RoverTruth], sun: Sun, *, overcast: bool = False) -> SandWorld:
    rng, route = np.random.default_rng(4), route_of(truths)
    return SandWorld("uniform", rng=rng, rover=rover, terrain=SLOPE, route=route, sun=sun, overcast=overcast)


def camera_of(world: SandWorld, rig: TraceRig, webcam: Webcam = PLAIN) -> TraceCamera:
    return TraceCamera(world, rig, webcam, np.random.default_rng(5))


def full_place(view: GroundView, ground: VisibleGround) -> tuple[FloatArray, FloatArray]:
    """W (n, 3) of some pixels (n, 2), away from the image's edge."""
    v, u = np.mgrid[20:460:40, 20:620:40]
    places = np.stack([view.full(part)[v, u] for part in (ground.x, ground.y, ground.z)], axis=-1)
    return places.reshape(-1, 3).astype(float), np.stack([u, v], axis=-1).reshape(-1, 2).astype(float)


def test_visible_points_lie_on_the_ground_and_project_back_to_their_pixels(
    sand: SandWorld, rig: TraceRig, truths: list[RoverTruth]
) -> None:
    """With lens, slope, roll, pitch, sinkage and the rut: rays end on the relief, not on the plane they start from."""
    view, X_WC = GroundView.of(rig.camera), truths[-1].X_WB @ rig.X_RC
    visible = view.look(X_WC, sand)
    places, pixels = full_place(view, visible)
    X_CW = inverse(X_WC)
    error = rig.camera.project(places @ X_CW[:3, :3].T + X_CW[:3, 3]) - pixels
    # Error of interpolated rays: the relief between two pixels, some tenths of a millimetre, times the view's tangent.
    assert np.abs(error).max() < 0.6
    assert np.abs(error).mean() < 0.06
    ground = sand.field.height(visible.window)
    shown = tuple(pixels[:, ::-1].astype(int).T)
    at = [view.full(part)[shown].round().astype(int) for part in (visible.v, visible.u)]
    assert np.abs(ground[at[0], at[1]] - places[:, 2]).mean() < 0.0005  # roughness from texel to texel
    plane = SLOPE.height(places[:, 0], places[:, 1])
    assert np.abs(places[:, 2] - plane).max() > 0.008  # the rut in the view is 11 mm deep


@pytest.mark.parametrize("overcast", [False, True])
def test_compiled_and_plain_code_see_the_same_sand(
    rover: Rover, rig: TraceRig, truths: list[RoverTruth], monkeypatch: pytest.MonkeyPatch, overcast: bool
) -> None:
    """OpenCV looks up at a 32nd of a texel and rounds the light to bytes; compiled code does neither."""

    def images() -> list[GreyImage | ColourImage]:
        world = world_of(rover, truths, LEFT, overcast=overcast)
        world.drive(truths)
        cameras = [camera_of(world, rig, webcam) for webcam in (PLAIN, noisy)]
        return [*(camera.sample(truths[-1]) for camera in cameras), cameras[0].colour(truths[-1])]

    noisy = replace(PLAIN, read_noise=2.0, shot_noise=3.0)
    compiled, is_compiled = images(), compiler() is not None
    monkeypatch.setenv("OFFTRACK_COMPILER", "none")
    for one, plain in zip(compiled, images(), strict=True):
        difference = cv2.absdiff(one, plain)
        assert difference.any() == is_compiled  # a source that does not compile would go unnoticed
        assert difference.mean() < 0.4  # [grey levels]: they round by up to half a level each
        assert np.quantile(difference, 0.999) <= 2.0  # at edges of lug marks


def test_nominal_camera_has_the_field_of_view_of_the_paper(rover: Rover, rig: TraceRig) -> None:
    """Reina 2008: 0.60 m along by 0.80 m across, behind the left rear wheel."""
    H_inverse = np.linalg.inv(rig.image_of_ground())
    edges = rig.camera.rays(np.array([[0.0, 239.5], [639.0, 239.5], [319.5, 0.0], [319.5, 479.0]]))
    ground = np.column_stack([edges, np.ones(4)]) @ (H_inverse @ rig.camera.matrix).T
    right_of_it, left_of_it, far, near = ground[:, :2] / ground[:, 2:]
    x, y = rover.wheel_places[2]
    assert left_of_it[1] - right_of_it[1] == pytest.approx(0.80, rel=0.05)  # the lens's barrel adds some
    assert near[0] - far[0] == pytest.approx(0.60, rel=0.10)
    assert 0.5 * (left_of_it[1] + right_of_it[1]) == pytest.approx(y, abs=0.01)
    assert x - 0.05 < near[0] < x + 0.05  # it begins at the wheel


def test_roll_moves_the_view_by_its_tangent(sand: SandWorld, rig: TraceRig, truths: list[RoverTruth]) -> None:
    """A camera at 0.75 m that rolls by 2 deg, left side up, sees ground 26 mm farther to the left."""
    view, straight = GroundView.of(rig.camera), truths[-1].X_WB @ rig.X_RC
    ahead = truths[-1].X_WB[:3, :3]
    R = ahead @ rotation_zyx(0.0, 0.0, math.radians(2.0)) @ ahead.T
    rolled = transform(R @ straight[:3, :3], straight[:3, 3])
    shift = (view.footprint(rolled, sand) - view.footprint(straight, sand)).mean(axis=0) @ ahead[:2, 1]
    assert shift == pytest.approx(rig.X_RC[2, 3] * math.tan(math.radians(2.0)), rel=0.25)  # slope, edge of the view


def test_wheel_hides_the_head_of_the_trace(sand: SandWorld, rig: TraceRig, truths: list[RoverTruth]) -> None:
    """The wheel's axle is 0.1 m up: ground within its radius is hidden behind the tread."""
    image = camera_of(sand, rig).sample(truths[-1]).astype(float)
    lower, upper = image[430:470, 290:350], image[330:380, 290:350]
    assert lower.mean() < 0.75 * upper.mean()  # dull metal against sand
    beside = image[430:470, 440:560]  # to the rover's left, where the sun is
    assert beside.mean() > 0.9 * upper.mean()


def test_trace_in_the_image_is_on_the_true_line(sand: SandWorld, rig: TraceRig, truths: list[RoverTruth]) -> None:
    """Lug marks make the rut the only rough stripe in uniform sand: its middle is the true line."""
    truth = truths[-1]
    image = camera_of(sand, rig).sample(truth).astype(float)
    trace = sand.trace_truth(truth)
    assert trace.present
    on_ground = np.column_stack([trace.line, np.ones(len(trace.line))]) @ rig.image_of_ground().T
    rays = (on_ground[:, :2] / on_ground[:, 2:] - [rig.camera.cx, rig.camera.cy]) / [rig.camera.fx, rig.camera.fy]
    offsets = []
    for u, v in rig.camera.pixels(rays)[4:-6]:
        band = image[int(v) - 25 : int(v) + 26]
        rough = np.abs(np.diff(band, axis=0)).mean(axis=0)
        column = np.arange(len(rough))
        weight = np.clip(rough - 0.5 * (rough.min() + rough.max()), 0.0, None) * (np.abs(column - u) < 90)
        offsets.append(np.average(column, weights=weight) - u)
    # 1 px is 1.3 mm; edges of the rough band are ragged, and 0.2 deg of the camera move the ground by 3 mm.
    assert abs(np.mean(offsets)) < 6.0


def test_rover_casts_its_shadow_away_from_the_sun(rover: Rover, truths: list[RoverTruth]) -> None:
    """A point is dark just where its ray to the sun meets the body."""
    truth, casters = truths[-1], Casters.of(rover, mast=False, lugs=20)
    sun = np.array([0.5, -0.4, 0.6]) / np.linalg.norm([0.5, -0.4, 0.6])
    body = truth.X_WB @ np.array([0.0, 0.0, 0.36, 1.0])  # the middle of the body
    ground = float(truth.wheel_positions[2, 2])
    shaded = body[:3] - (body[2] - ground) / sun[2] * sun
    lit = body[:3] + 2.0 * (body[2] - ground) / sun[2] * sun  # as far off again on the other side, past the wheels
    x, y = (np.array([[shaded[k], lit[k]]], np.float32) for k in (0, 1))
    share = casters.shadows(truth, sun, x, y, np.full((1, 2), ground, np.float32))
    assert share[0, 0] < 0.01
    assert share[0, 1] > 0.99


@pytest.mark.slow
def test_nothing_casts_a_shadow_under_clouds(rover: Rover, rig: TraceRig, truths: list[RoverTruth]) -> None:
    behind = Sun(azimuth=math.radians(-20.0), elevation=math.radians(40.0))  # would cast the rover's shadow into view

    def image(sun: Sun, overcast: bool) -> GreyImage:
        return camera_of(world_of(rover, truths, sun, overcast=overcast), rig).sample(truths[0])

    clouds = image(LEFT, overcast=True)
    assert np.array_equal(clouds, image(behind, overcast=True))
    assert clouds.std() < 0.5 * image(behind, overcast=False).std()


def test_shutter_smears_along_the_motion(sand: SandWorld, rig: TraceRig, truths: list[RoverTruth]) -> None:
    """At 0.1 s the ground passes by 8 mm, some 6 px: contrast along the way is lost, across it is not."""
    sharp, smeared = (
        camera_of(sand, rig, replace(PLAIN, exposure_time=time)).sample(truths[-1]).astype(float)[150:350]
        for time in (0.0, 0.1)
    )
    along, across = (np.abs(np.diff(smeared, axis=k)).mean() / np.abs(np.diff(sharp, axis=k)).mean() for k in (0, 1))
    assert along < 0.5
    assert across > 1.2 * along


def test_exposure_follows_the_light(sand: SandWorld, rig: TraceRig, truths: list[RoverTruth]) -> None:
    image = camera_of(sand, rig, replace(Webcam(), jpeg_quality=None)).sample(truths[-1])
    assert image.mean() == pytest.approx(118.0, abs=3.0)  # the target of AutoExposure; nothing saturates


def test_colour_is_that_of_sand(sand: SandWorld, rig: TraceRig, truths: list[RoverTruth]) -> None:
    red, green, blue = camera_of(sand, rig).colour(truths[-1]).reshape(-1, 3).mean(axis=0)
    assert red > green > blue


def test_camera_below_the_ground_is_refused(sand: SandWorld, rig: TraceRig, truths: list[RoverTruth]) -> None:
    over = transform(rotation_zyx(0.0, 0.0, math.pi), np.array([0.5, 0.0, 0.0]))
    with pytest.raises(ValueError, match="must look down"):
        camera_of(sand, rig).sample(replace(truths[-1], X_WB=over))
