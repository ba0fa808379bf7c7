"""The parts of pyrender that offtrack uses: the EGL context and the shader programs.

Importing the whole package also imports trimesh, networkx and a viewer. That takes a third of a second at each start.
"""

import sys
from importlib.util import find_spec, module_from_spec

_spec = find_spec("pyrender")
_is_loaded = "pyrender" in sys.modules
if _spec is not None and not _is_loaded:
    sys.modules["pyrender"] = module_from_spec(_spec)  # knows where its parts are
try:
    from pyrender.platforms.egl import EGLDevice, EGLPlatform, query_devices
    from pyrender.platforms.egl import _eglQueryDeviceStringEXT as device_text
    from pyrender.shader_program import ShaderProgram
finally:
    if not _is_loaded:
        sys.modules.pop("pyrender", None)  # others get the whole package

__all__ = ["EGLDevice", "EGLPlatform", "ShaderProgram", "device_text", "query_devices"]
