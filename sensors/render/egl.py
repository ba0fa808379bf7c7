"""EGL's devices, and an OpenGL context without a window on one of them. Importing this module loads EGL."""

from collections.abc import Sequence
from dataclasses import dataclass

from OpenGL import EGL, GL
from OpenGL.error import Error as OpenGlError

from sensors.render.pyrender_parts import EGLDevice, EGLPlatform, device_text, query_devices


@dataclass(frozen=True, slots=True, eq=False)
class Device:
    """A graphics card, or Mesa's software renderer."""

    number: int
    name: str  # file of a graphics card, such as "/dev/dri/card0"
    is_software: bool
    handle: EGLDevice

    def __str__(self) -> str:
        return f"{self.number} ({self.name})"


@dataclass(frozen=True, slots=True, eq=False)
class Context:
    """An OpenGL context of this process."""

    platform: EGLPlatform  # makes it the context of the calls that follow
    name: str  # of renderer and device

    def close(self) -> None:
        """Destroy the context with all that is in it, but not EGL's display, which belongs to the whole process."""
        self.platform.make_current()
        display, context = EGL.eglGetCurrentDisplay(), EGL.eglGetCurrentContext()
        EGL.eglMakeCurrent(display, EGL.EGL_NO_SURFACE, EGL.EGL_NO_SURFACE, EGL.EGL_NO_CONTEXT)
        EGL.eglDestroyContext(display, context)


def devices() -> list[Device]:
    """All devices in EGL's order."""
    found = []
    for number, handle in enumerate(query_devices()):
        is_software = b"software" in (device_text(handle._display, EGL.EGL_EXTENSIONS) or b"")
        found.append(Device(number, handle.name or ("software" if is_software else "no name"), is_software, handle))
    return found


def in_order(found: Sequence[Device], wanted: str) -> list[Device]:
    """Devices to try: the wanted one by number or name, or all if that is empty, graphics cards first.

    Raises:
        ValueError: one line, if there is no such device.
    """
    if not wanted:
        return sorted(found, key=lambda device: device.is_software)
    fitting = [device for device in found if wanted in (str(device.number), device.name)]
    if not fitting:
        there = ", ".join(map(str, found)) or "none"
        raise ValueError(f"OFFTRACK_EGL_DEVICE={wanted}: EGL has no such device; there are: {there}")
    return fitting


def open_context(wanted: str) -> Context:
    """Context on the first device of ``in_order`` that works.

    Raises:
        ValueError: one line, if there is no such device.
        OSError: with the last device's error if none works.
    """
    failure = "EGL has no device"
    for device in in_order(devices(), wanted):
        try:
            return _opened_on(device)
        except OpenGlError as error:
            failure = f"{getattr(error.baseOperation, '__name__', 'EGL')} answers {error.err}"
        except AssertionError:  # pyrender asserts that EGL's calls succeed
            failure = "EGL refuses a call"
    raise OSError(f"no EGL device gives an OpenGL 4.1 context: {failure}")


def _opened_on(device: Device) -> Context:
    platform = EGLPlatform(
        1, 1, device=device.handle
    )  # rendering is into a framebuffer object: the size is without effect
    platform.init_context()
    name, version = (GL.glGetString(key).decode() for key in (GL.GL_RENDERER, GL.GL_VERSION))
    return Context(platform, f"{name}, OpenGL {version}, EGL device {device}")
