"""EGL's devices, and an OpenGL context without a window on one of them. Importing this module loads EGL."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from OpenGL import EGL, GL
from OpenGL.EGL.EXT import device_base, platform_base
from OpenGL.error import Error as OpenGlError

_DEVICE_FILE, _PLATFORM_DEVICE = 0x3233, 0x313F  # EGL_DRM_DEVICE_FILE_EXT, EGL_PLATFORM_DEVICE_EXT
_CONFIG = (
    *(EGL.EGL_SURFACE_TYPE, EGL.EGL_PBUFFER_BIT, EGL.EGL_RENDERABLE_TYPE, EGL.EGL_OPENGL_BIT),
    *(EGL.EGL_CONFORMANT, EGL.EGL_OPENGL_BIT, EGL.EGL_NONE),
)
_CONTEXT = (
    *(EGL.EGL_CONTEXT_MAJOR_VERSION, 4, EGL.EGL_CONTEXT_MINOR_VERSION, 1),
    *(EGL.EGL_CONTEXT_OPENGL_PROFILE_MASK, EGL.EGL_CONTEXT_OPENGL_CORE_PROFILE_BIT, EGL.EGL_NONE),
)


@dataclass(frozen=True, slots=True, eq=False)
class Device:
    """A graphics card, or Mesa's software renderer."""

    number: int
    name: str  # file of a graphics card, such as "/dev/dri/card0"
    is_software: bool
    handle: Any  # EGL's own

    def __str__(self) -> str:
        return f"{self.number} ({self.name})"


@dataclass(frozen=True, slots=True, eq=False)
class Context:
    """An OpenGL context of this process."""

    display: Any
    handle: Any
    name: str  # of renderer and device

    def make_current(self) -> None:
        """Make it the context of this thread's calls."""
        EGL.eglMakeCurrent(self.display, EGL.EGL_NO_SURFACE, EGL.EGL_NO_SURFACE, self.handle)

    def close(self) -> None:
        """Destroy the context with all that is in it, but not EGL's display, which belongs to the whole process."""
        EGL.eglMakeCurrent(self.display, EGL.EGL_NO_SURFACE, EGL.EGL_NO_SURFACE, EGL.EGL_NO_CONTEXT)
        EGL.eglDestroyContext(self.display, self.handle)


def devices() -> list[Device]:
    """All devices in EGL's order."""
    count = EGL.EGLint()
    device_base.eglQueryDevicesEXT(0, None, count)
    handles = (device_base.EGLDeviceEXT * count.value)()
    device_base.eglQueryDevicesEXT(count.value, handles, count)
    found = []
    for number, handle in enumerate(handles):
        extensions = device_base.eglQueryDeviceStringEXT(handle, EGL.EGL_EXTENSIONS) or b""
        is_software = b"software" in extensions
        has_file = b"EGL_EXT_device_drm" in extensions and not is_software
        file = device_base.eglQueryDeviceStringEXT(handle, _DEVICE_FILE) if has_file else None
        name = file.decode() if file else "software" if is_software else "no name"
        found.append(Device(number, name, is_software, handle))
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
    raise OSError(f"no EGL device gives an OpenGL 4.1 context: {failure}")


def _opened_on(device: Device) -> Context:
    display = platform_base.eglGetPlatformDisplayEXT(_PLATFORM_DEVICE, device.handle, None)
    EGL.eglInitialize(display, None, None)
    configs, count = (EGL.EGLConfig * 1)(), EGL.EGLint()
    EGL.eglChooseConfig(display, _CONFIG, configs, 1, count)
    EGL.eglBindAPI(EGL.EGL_OPENGL_API)
    handle = EGL.eglCreateContext(display, configs[0], EGL.EGL_NO_CONTEXT, _CONTEXT)
    Context(display, handle, "").make_current()
    name, version = (GL.glGetString(key).decode() for key in (GL.GL_RENDERER, GL.GL_VERSION))
    return Context(display, handle, f"{name}, OpenGL {version}, EGL device {device}")
