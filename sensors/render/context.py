"""OpenGL context without a window, and OpenGL objects that pyrender does not provide.

Importing this module imports pyrender and loads EGL.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from OpenGL import EGL, GL
from OpenGL.error import Error as OpenGlError
from pyrender.platforms.egl import EGLDevice, EGLPlatform, query_devices
from pyrender.shader_program import ShaderProgram, ShaderProgramCache

from vehicle.frames import FloatArray

Uniforms = Mapping[str, float | tuple[float, ...] | FloatArray]

_SHADERS = Path(__file__).parent / "shaders"
_LAYOUTS = {3: (GL.GL_RGB8, GL.GL_RGB), 4: (GL.GL_RGBA8, GL.GL_RGBA)}  # channels: internal layout, layout


@dataclass(frozen=True, slots=True, eq=False)
class Context:
    """A current OpenGL context of this process."""

    platform: EGLPlatform
    name: str

    def make_current(self) -> None:
        """Make this the context of the OpenGL calls that follow."""
        self.platform.make_current()

    def close(self) -> None:
        """Destroy the context, but not EGL's display, which belongs to the whole process."""
        display, context = EGL.eglGetCurrentDisplay(), EGL.eglGetCurrentContext()
        EGL.eglMakeCurrent(display, EGL.EGL_NO_SURFACE, EGL.EGL_NO_SURFACE, EGL.EGL_NO_CONTEXT)
        EGL.eglDestroyContext(display, context)


def open_context() -> Context:
    """Context on the first device that works: an accessible graphics card, or else the processor.

    Raises:
        OSError: with the last device's error if none works.
    """
    failure = "EGL has no device"
    for device in query_devices():
        try:
            return _opened_on(device)
        except OpenGlError as error:
            failure = f"{getattr(error.baseOperation, '__name__', 'EGL')} answers {error.err}"
        except AssertionError:  # pyrender asserts that EGL's calls succeed
            failure = "EGL refuses a call"
    raise OSError(f"no EGL device gives an OpenGL 4.1 context: {failure}")


def _opened_on(device: EGLDevice) -> Context:
    platform = EGLPlatform(1, 1, device=device)  # rendering is into a framebuffer object: the size does not matter
    platform.init_context()
    name, version = (GL.glGetString(key).decode() for key in (GL.GL_RENDERER, GL.GL_VERSION))
    return Context(platform, f"{name}, OpenGL {version}")


def upload_table(table: NDArray[np.float32]) -> int:
    """Name of a new texture with a table (ny, nx, 4) of numbers, without filtering."""
    texture = int(GL.glGenTextures(1))
    GL.glBindTexture(GL.GL_TEXTURE_2D, texture)
    ny, nx = table.shape[:2]
    GL.glTexImage2D(GL.GL_TEXTURE_2D, 0, GL.GL_RGBA32F, nx, ny, 0, GL.GL_RGBA, GL.GL_FLOAT, np.ascontiguousarray(table))
    for key, value in (
        (GL.GL_TEXTURE_WRAP_S, GL.GL_CLAMP_TO_EDGE),
        (GL.GL_TEXTURE_WRAP_T, GL.GL_CLAMP_TO_EDGE),
        (GL.GL_TEXTURE_MAG_FILTER, GL.GL_NEAREST),
        (GL.GL_TEXTURE_MIN_FILTER, GL.GL_NEAREST),
    ):
        GL.glTexParameteri(GL.GL_TEXTURE_2D, key, value)
    return texture


def upload_texture(image: NDArray[np.uint8], shrink: int) -> int:
    """Name of a new repeating texture; v = 0 at its first row; ``shrink`` is OpenGL's minification filter."""
    internal, layout = _LAYOUTS[image.shape[2]]
    texture = int(GL.glGenTextures(1))
    GL.glBindTexture(GL.GL_TEXTURE_2D, texture)
    GL.glPixelStorei(GL.GL_UNPACK_ALIGNMENT, 1)
    data = np.ascontiguousarray(image)
    GL.glTexImage2D(GL.GL_TEXTURE_2D, 0, internal, image.shape[1], image.shape[0], 0, layout, GL.GL_UNSIGNED_BYTE, data)
    GL.glGenerateMipmap(GL.GL_TEXTURE_2D)
    for key, value in (
        (GL.GL_TEXTURE_WRAP_S, GL.GL_REPEAT),
        (GL.GL_TEXTURE_WRAP_T, GL.GL_REPEAT),
        (GL.GL_TEXTURE_MAG_FILTER, GL.GL_LINEAR),
        (GL.GL_TEXTURE_MIN_FILTER, shrink),
    ):
        GL.glTexParameteri(GL.GL_TEXTURE_2D, key, value)
    return texture


@dataclass(frozen=True, slots=True, eq=False)
class Program:
    """A linked shader program with its uniforms."""

    identity: int
    locations: dict[str, int] = field(default_factory=dict)

    @classmethod
    def load(cls, cache: ShaderProgramCache, vertex: str, fragment: str, *defined: str) -> Program:
        """Program of two files in ``shaders``, with preprocessor definitions; the cache owns it."""
        defines = dict.fromkeys(defined, 1)
        program: ShaderProgram = cache.get_program(f"{vertex}.vert", f"{fragment}.frag", defines=defines)
        program._add_to_context()
        return cls(int(program._program_id))

    def use(self, uniforms: Uniforms) -> None:
        """Make this the current program and set uniforms: numbers, vectors, matrices, or ints for texture units."""
        GL.glUseProgram(self.identity)
        for name, value in uniforms.items():
            if name not in self.locations:
                self.locations[name] = int(GL.glGetUniformLocation(self.identity, name))
            _set(self.locations[name], value)


def _set(location: int, value: float | tuple[float, ...] | FloatArray) -> None:
    if isinstance(value, int):
        GL.glUniform1i(location, value)
        return
    array = np.ascontiguousarray(value, dtype=np.float32)
    if array.ndim == 2:
        GL.glUniformMatrix4fv(location, 1, GL.GL_TRUE, array)
    else:
        (GL.glUniform1fv, GL.glUniform2fv, GL.glUniform3fv)[max(array.size, 1) - 1](location, 1, array)


def shader_cache() -> ShaderProgramCache:
    """Pyrender's cache for this package's shaders."""
    return ShaderProgramCache(shader_dir=str(_SHADERS))
