"""Rendering of two camera views: colour, depth and inverse depth. Only this package uses pyrender and OpenGL.

OpenGL is loaded when the first renderer is opened. It works without a GPU (Mesa's software renderer through EGL).
Open one renderer at a time per process and close it before the next. Use it only in the thread that opened it. Do not
fork after a renderer has been opened: spawn instead.
"""

import ctypes
import os
from collections.abc import Iterator
from contextlib import contextmanager
from copy import copy
from typing import TYPE_CHECKING, Any

from sensors.camera.rig import StereoCalibration
from sensors.messages import ColourImage, NearnessImage
from sensors.world.scenery import Instances
from sensors.world.world import World
from vehicle.frames import FloatArray

if TYPE_CHECKING:
    from sensors.render.pair import PairRenderer

__all__ = ["DEVICE_VARIABLE", "RendererUnavailableError", "StereoRenderer", "check_renderer", "device_names"]

DEVICE_VARIABLE = "OFFTRACK_EGL_DEVICE"  # environment: number or file of the device; empty: choose one


class RendererUnavailableError(RuntimeError):
    """OpenGL does not work on this machine."""

    def __init__(self, cause: BaseException) -> None:
        reason = _missing_library() or " ".join(str(cause).split()) or type(cause).__name__
        super().__init__(
            f"no rendered cameras: OpenGL through EGL failed ({reason}); install it with "
            "'apt-get install libegl1 libgl1 libgl1-mesa-dri', or run without cameras: off_tracking=truth; "
            "see offtrack doctor"
        )


def _missing_library() -> str | None:
    """The loader's message for the first OpenGL library that cannot be loaded; None if all can."""
    for library in ("libEGL.so.1", "libGL.so.1"):
        try:
            ctypes.CDLL(library)
        except OSError as error:
            return str(error)
    return None


class StereoRenderer:
    """Renderer of the views of a stereo rig in a world.

    Raises:
        RendererUnavailableError: if EGL or OpenGL is missing or does not work.
        ValueError: one line, if the environment names a device that EGL does not have.
    """

    def __init__(self, world: World, calibration: StereoCalibration) -> None:
        self.calibration = calibration
        with _opengl() as renderers:
            wanted = os.environ.get(DEVICE_VARIABLE, "")
            pair: PairRenderer = renderers.PairRenderer(world, calibration, renderers.egl.open_context(wanted))
        self._pair: PairRenderer | None = pair
        self.name = pair.name  # and version of the OpenGL renderer

    def on(self, calibration: StereoCalibration) -> "StereoRenderer":
        """Renderer for another rig of equal pinholes in the same world; it shares this one's OpenGL objects.

        Raises:
            ValueError: if the pinholes differ.
        """
        if _pinhole(calibration) != _pinhole(self.calibration):
            raise ValueError("only rigs of equal pinhole cameras can share a renderer")
        shared = copy(self)
        shared.calibration = calibration
        return shared

    def __deepcopy__(self, _: object) -> "StereoRenderer":
        """The same renderer: OpenGL's objects cannot be copied, and every picture is drawn anew."""
        return self

    def render(self, X_WB: FloatArray) -> tuple[ColourImage, ColourImage]:
        """Left and right image, RGBA, of cameras carried by a body at X_WB (4, 4)."""
        return self.render_from(*self.cameras(X_WB))

    def render_from(self, X_WCl: FloatArray, X_WCr: FloatArray) -> tuple[ColourImage, ColourImage]:
        """Left and right image, RGBA, of two such cameras at any poses (4, 4)."""
        pair = self._live()
        pair.draw(X_WCl, X_WCr)
        left, right = pair.read_colour()
        return left, right

    def place(self, moved: tuple[Instances, ...]) -> None:
        """Move the world's moving things to these poses; same things in the same order."""
        self._live().place(moved)

    def nearness(self) -> tuple[NearnessImage, NearnessImage]:
        """Inverse depth (height, width) [1/m] of the last left and right image; almost zero in the sky."""
        left, right = self._live().read_nearness()
        return left, right

    def render_depth_from(self, X_WC1: FloatArray, X_WC2: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Depth images (height, width) [m] of two such cameras anywhere in the world (4, 4).

        The depth of a pixel is the z coordinate, in the camera's frame C, of the point that its centre shows; it is
        infinite in the sky. It is exact to the resolution of a 32-bit depth buffer: 0.2 mm at 30 m.
        """
        pair = self._live()
        pair.draw(X_WC1, X_WC2)
        first, second = pair.read_depth()
        return first, second

    def cameras(self, X_WB: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Poses X_WC (4, 4) of the left and the right camera, carried by a body at X_WB (4, 4)."""
        X_WCl = X_WB @ self.calibration.X_SC
        return X_WCl, X_WCl @ self.calibration.X_ClCr

    def close(self) -> None:
        """Release the OpenGL context; closing twice does no harm."""
        if self._pair is not None:
            self._pair.close()
            self._pair = None

    def _live(self) -> "PairRenderer":
        if self._pair is None:
            raise ValueError("this StereoRenderer is closed: open a new one")
        return self._pair


def _pinhole(c: StereoCalibration) -> tuple[float, ...]:
    return c.width, c.height, c.focal_length, c.cx, c.cy


def check_renderer() -> str:
    """Open an OpenGL context and close it again; return the name of its renderer and device.

    Raises:
        RendererUnavailableError: if that fails.
        ValueError: one line, if the environment names a device that EGL does not have.
    """
    with _opengl() as renderers:
        context = renderers.egl.open_context(os.environ.get(DEVICE_VARIABLE, ""))
        context.close()
        return str(context.name)


def device_names() -> list[str]:
    """Files of EGL's devices, in its order; "software" for Mesa's renderer on the processor.

    Raises:
        RendererUnavailableError: if EGL is missing.
    """
    with _opengl() as renderers:
        return [str(device.name) for device in renderers.egl.devices()]


@contextmanager
def _opengl() -> Iterator[Any]:
    """Module of the OpenGL renderer, whose errors become ``RendererUnavailableError``."""
    os.environ["PYOPENGL_PLATFORM"] = "egl"  # read when OpenGL is imported
    try:
        from sensors.render import pair
    except (ImportError, OSError, AttributeError) as error:  # PyOpenGL looks into libraries it could not load
        raise RendererUnavailableError(error) from error
    try:
        yield pair
    except pair.FAILURES as error:  # no device, a refused call, a shader that does not compile
        raise RendererUnavailableError(error) from error
