"""Rendered points lie where geometry says: the renderer as a source of truth."""

import os
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from sensors.camera.image_formation import grey
from sensors.camera.rig import StereoCalibration
from sensors.render import StereoRenderer
from sensors.world.scenery import Instances
from sensors.world.things import Part, Thing, box
from sensors.world.world import World
from tests.sensors.conftest import SURFACE
from vehicle.frames import FloatArray, rotation_zyx, transform

WALL = Part(mesh=box((-30.0, -29.0), (-3.0, 5.0), (-1.0, 4.0), texture_size=1.0), texture="stone")


@pytest.fixture
def pose() -> FloatArray:
    """X_WB of a trailer that has come half way round and cuts in; its cameras see the circle and the entry."""
    return SURFACE.pose_on(9.0, 8.0, 1.9, (0.0, -8.0))


def points_seen(depth: FloatArray, calibration: StereoCalibration, X_WC: FloatArray) -> FloatArray:
    """Points in W (height, width, 3) at the centres of the pixels, from their depth [m]."""
    v, u = np.mgrid[0 : calibration.height, 0 : calibration.width]
    x, y = (u - calibration.cx) / calibration.focal_length, (v - calibration.cy) / calibration.focal_length
    far = np.minimum(depth, 1e4)  # the sky's depth is infinite
    rays = np.stack([x * far, y * far, far], axis=-1)
    return np.asarray(rays @ X_WC[:3, :3].T + X_WC[:3, 3])


def on_ground(points: FloatArray, tolerance: float) -> NDArray[np.bool_]:
    return np.asarray(np.abs(points[..., 2] - SURFACE.height(points[..., 0], points[..., 1])) < tolerance)


@pytest.mark.slow
def test_ground_is_rendered_where_the_surface_is(
    renderer: StereoRenderer, calibration: StereoCalibration, pose: FloatArray
) -> None:
    """Points from rendered depth lie on the cone; half a pixel of row shift would lift those at 20 m by 18 mm."""
    X_WC = pose @ calibration.X_SC
    poses = (X_WC, X_WC @ calibration.X_ClCr)
    for depth, X in zip(renderer.render_depth_from(*poses), poses, strict=True):
        points = points_seen(depth, calibration, X)
        near = (depth < 40.0) & on_ground(points, 0.03)  # what is higher is kerbs and things
        error = points[near, 2] - SURFACE.height(points[near, 0], points[near, 1])
        assert near.sum() > 150_000  # a third of the image, or the pose tells nothing
        assert np.abs(np.median(error)) < 1e-3  # chords of 2.5 m cells: h^2/8 times the curvature c/R = 1 mm at 20 m
        assert np.quantile(np.abs(error), 0.98) < 4e-3  # [m] 2 mm of chord at R = 10 m, 6 mm at the cone's very tip


@pytest.fixture
def wall_only(renderer: StereoRenderer, bare_world: World, calibration: StereoCalibration) -> Iterator[StereoRenderer]:
    """A renderer of bare ground with one wall 16 m behind the camera of a trailer at the origin."""
    thing = Thing(name="wall", parts=(WALL,), variety=0.0)
    stand = Instances(thing=thing, poses=np.eye(4)[None], brightness=np.ones(1))
    opened = StereoRenderer(replace(bare_world, scenery=(stand,)), calibration)
    yield opened
    opened.close()


def test_a_wall_covers_the_pixels_that_its_corners_project_to(
    wall_only: StereoRenderer, calibration: StereoCalibration
) -> None:
    """Rows and columns count from the centre of the first pixel; left and right differ by f b / Z; none is mirrored.

    The wall faces the cameras: (y, z) in -3..5 m and -1..4 m at x = -29 m, seen against the sky above.
    """
    Z = 29.0 - 13.6  # [m]
    f, cx, cy = calibration.focal_length, calibration.cx, calibration.cy
    for depth, y_camera in zip(wall_only.render_depth_from(*wall_only.cameras(np.eye(4))), (-0.25, 0.25), strict=True):
        wall = np.abs(depth[:280] - Z) < 1e-3  # [m] 32-bit depth at 15 m: 0.05 mm; ground as far off is lower
        rows, columns = np.flatnonzero(wall.any(axis=1)), np.flatnonzero(wall.any(axis=0))
        assert columns[0] == np.ceil(cx + f * (-3.0 - y_camera) / Z)  # looking to the rear, W's y points to the right
        assert columns[-1] == np.floor(cx + f * (5.0 - y_camera) / Z)
        assert rows[0] == np.ceil(cy - f * (4.0 - 3.0) / Z)  # cameras 3 m up, the wall's top 4 m
        assert wall[rows[0] : rows[0] + 60, columns[0] : columns[-1] + 1].all()


def test_depth_of_two_cameras_that_look_different_ways(
    wall_only: StereoRenderer, calibration: StereoCalibration
) -> None:
    """One stands at the origin and sees the wall, the other one turns its back to it and sees ground and sky."""
    towards = calibration.X_SC
    away = towards @ transform(rotation_zyx(0.0, np.pi, 0.0), np.zeros(3))  # about the camera's y axis, which is down
    seen, unseen = wall_only.render_depth_from(towards, away)
    wall = np.abs(seen[:200] - (29.0 - 13.6)) < 1e-3  # [m] above the ground that lies as far off
    assert wall.sum() > 10_000
    assert np.array_equal(seen, wall_only.render_depth_from(*wall_only.cameras(np.eye(4)))[0])
    assert np.isinf(unseen[:100]).all()  # the sky, where the wall would be
    ground = points_seen(unseen, calibration, away)[300:]
    assert on_ground(ground, 0.01).mean() > 0.95


def warped(right: NDArray[np.uint8], depth: FloatArray, calibration: StereoCalibration, rows: int) -> FloatArray:
    """The right image moved to the left one by the disparity f b / Z and by some rows (height, width)."""
    v, u = np.mgrid[0 : calibration.height, 0 : calibration.width].astype(np.float32)
    disparity = (calibration.focal_length * calibration.baseline / depth).astype(np.float32)
    return cv2.remap(right, u - disparity, v + np.float32(rows), cv2.INTER_LINEAR).astype(float)


def test_left_and_right_image_agree_along_rows(
    renderer: StereoRenderer, calibration: StereoCalibration, pose: FloatArray
) -> None:
    """A ground point seen at (u, v) on the left is seen at (u - f b / Z, v) on the right, and looks the same there."""
    left, right = (grey(image) for image in renderer.render(pose))
    depth = renderer.render_depth_from(*renderer.cameras(pose))[0]
    ground = on_ground(points_seen(depth, calibration, pose @ calibration.X_SC), 0.03) & (depth < 30.0)
    ground[:, :40] = False  # out of the right camera's view

    def difference(rows: int) -> float:
        return float(np.abs(warped(right, depth, calibration, rows) - left)[ground].mean())

    assert difference(0) < 2.5  # [grey levels] of interpolation; the texture's own deviation is some 12
    assert difference(0) < 0.6 * min(difference(1), difference(-1))


def test_images_are_copies(renderer: StereoRenderer, pose: FloatArray) -> None:
    first = renderer.render(pose)[0]
    kept = first.copy()
    renderer.render(np.eye(4))
    assert np.array_equal(first, kept)


def test_closed_renderer_says_so(bare_world: World, calibration: StereoCalibration) -> None:
    """Closing twice does no harm; drawing then is an error in words, not a crash in the driver."""
    opened = StereoRenderer(bare_world, calibration)
    assert opened.calibration is calibration
    assert "OpenGL" in opened.name
    opened.close()
    opened.close()
    with pytest.raises(ValueError, match="closed"):
        opened.render(np.eye(4))


OPENED = """
from sensors.render import RendererUnavailableError, StereoRenderer
try:
    StereoRenderer(None, None)
except RendererUnavailableError as error:
    print(error)
"""


def python(program: str, **environment: str) -> str:
    result = subprocess.run(
        [sys.executable, "-c", program], env={**os.environ, **environment}, capture_output=True, text=True, check=True
    )
    return result.stdout


@pytest.mark.slow
def test_an_opengl_that_is_too_old_is_one_clear_line() -> None:
    """Cause, remedy and alternative; without the libraries it is the same line (`test_cli.py`)."""
    (line,) = python(OPENED, MESA_GL_VERSION_OVERRIDE="2.1").splitlines()
    assert "eglCreateContext answers EGL_BAD_MATCH" in line
    assert "apt-get install libegl1 libgl1 libgl1-mesa-dri" in line
    assert "off_tracking=truth" in line


def test_importing_the_renderer_does_not_load_opengl() -> None:
    program = "import sys, sensors.render; print(sorted({'OpenGL', 'pyrender', 'trimesh'} & set(sys.modules)))"
    assert python(program).strip() == "[]"


def test_drawing_loads_no_more_of_pyrender_than_it_uses_and_leaves_it_to_others() -> None:
    program = """
import os, sys
os.environ["PYOPENGL_PLATFORM"] = "egl"
import sensors.render.pair
print(sorted({"pyrender", "trimesh", "networkx"} & set(sys.modules)))
import pyrender
print(pyrender.Mesh.__name__, pyrender.OffscreenRenderer.__name__)
"""
    assert python(program).split("\n")[:2] == ["[]", "Mesh OffscreenRenderer"]


# Choice of EGL's device


def test_graphics_cards_come_before_the_processor_and_a_device_can_be_named() -> None:
    """By number or by file; the order of equals is EGL's. Devices are made up, as a machine may have only one."""
    program = """
from sensors.render import _opengl
with _opengl() as renderers:
    made = [("software", True), ("/dev/dri/card0", False), ("/dev/dri/card1", False)]
    found = [renderers.egl.Device(k, name, soft, None) for k, (name, soft) in enumerate(made)]
    for wanted in ("", "2", "/dev/dri/card0", "software"):
        print([device.number for device in renderers.egl.in_order(found, wanted)])
    try:
        renderers.egl.in_order(found, "3")
    except ValueError as error:
        print(error)
"""
    *orders, refusal = python(program).splitlines()
    assert orders == ["[1, 2, 0]", "[2]", "[1]", "[0]"]
    assert refusal == (
        "OFFTRACK_EGL_DEVICE=3: EGL has no such device; there are: 0 (software), 1 (/dev/dri/card0), 2 (/dev/dri/card1)"
    )


def test_the_environment_chooses_the_device_and_the_renderer_names_it() -> None:
    """The processor is there wherever Mesa is."""
    program = "from sensors.render import check_renderer, device_names; print(check_renderer(), device_names())"
    named = python(program, OFFTRACK_EGL_DEVICE="software")
    assert "llvmpipe" in named
    assert "(software) ['" in named
