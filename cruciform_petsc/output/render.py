# SPDX-License-Identifier: MIT
"""Render a scene off-screen with VTK, in a process of its own; scene.py calls it.

    python -m cruciform_petsc.output.render SCENE.npz IMAGE.npy

Of its own, because VTK does not raise but abort where it cannot draw, and ranks would go with it.
"""

from __future__ import annotations

import ctypes
import os
import subprocess
import sys
import tempfile
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

# From EGL/egl.h and EGL/eglext.h.
_SURFACELESS, _OPENGL_API = 0x31DD, 0x30A2
_CONFIG = (0x3033, 0x0001, 0x3040, 0x0008, 0x3025, 24, 0x3038)  # pbuffers, OpenGL, depth 24
_CONTEXT = (0x3098, 3, 0x30FB, 2, 0x3038)  # OpenGL 3.2, what VTK asks for
_PBUFFER = (0x3057, 16, 0x3056, 16, 0x3038)  # VTK draws into a buffer of its own


def render(scene: dict[str, np.ndarray]) -> np.ndarray:
    """Draw a mesh on white in parallel projection; uint8 (height, width, 3), first row on top.

    Parameters
    ----------
    scene : dict
        ``size`` (width, height) in pixels, ``focus`` (3,), ``towards`` and ``up`` (3,): from the
        focus to the camera, unit vectors; ``half_height`` of what is seen; and the mesh:
        ``points`` (n, 3), ``normals`` (n, 3), ``quads`` (m, 4) and ``colours`` uint8 (n, 3).
        Lengths in any one unit.
    """
    if sys.platform == "linux":
        _without_glx()
    import pyvista as pv
    from vtkmodules.vtkRenderingCore import vtkRenderer, vtkWindowToImageFilter

    window = _window()
    window.SetSize(*map(int, scene["size"]))
    window.SetMultiSamples(0)  # the picture is made larger and averaged
    renderer = vtkRenderer()
    renderer.SetBackground(1.0, 1.0, 1.0)
    window.AddRenderer(renderer)
    quads = scene["quads"]
    faces = np.column_stack([np.full(len(quads), 4), quads])
    mesh = pv.PolyData(scene["points"], faces.ravel())
    mesh.point_data.active_normals = scene["normals"]
    mesh.point_data["colour"] = scene["colours"]
    mapper = pv.DataSetMapper(mesh)
    mapper.SetScalarModeToUsePointFieldData()
    mapper.SelectColorArray("colour")
    mapper.SetColorModeToDirectScalars()
    actor = pv.Actor(mapper=mapper)
    actor.prop.SetInterpolationToPhong()
    actor.prop.ambient, actor.prop.diffuse = 0.3, 0.8
    actor.prop.specular, actor.prop.specular_power = 0.25, 15.0
    renderer.AddActor(actor)
    towards, up, focus = scene["towards"], scene["up"], scene["focus"]
    side = np.cross(up, towards)
    half = float(scene["half_height"])
    far = 20.0 * half
    # From the upper left, as readers of maps and buttons expect; a weak one from the other side.
    for direction, strength in ((towards + 0.9 * up - 0.8 * side, 0.85), (towards + side, 0.3)):
        light = pv.Light(position=tuple(focus + far * direction), focal_point=tuple(focus))
        light.positional = False
        light.intensity = strength
        renderer.AddLight(light)
    camera = renderer.GetActiveCamera()
    camera.SetParallelProjection(True)
    camera.SetFocalPoint(*focus)
    camera.SetPosition(*(focus + far * towards))
    camera.SetViewUp(*up)
    camera.SetParallelScale(half)
    renderer.ResetCameraClippingRange()
    window.Render()
    grab = vtkWindowToImageFilter()
    grab.SetInput(window)
    grab.SetInputBufferTypeToRGB()
    grab.ReadFrontBufferOff()
    grab.Update()
    image = pv.wrap(grab.GetOutput())
    width, height, _ = image.dimensions
    pixels = np.asarray(image.active_scalars).reshape(height, width, 3)[::-1]
    if (pixels[0, 0] != 255).any():  # VTK prints what fails, and goes on
        raise OSError("VTK drew nothing")
    return pixels


def _window() -> Any:
    """Return a window that needs no display."""
    from vtkmodules import vtkRenderingOpenGL2 as gl
    from vtkmodules.vtkRenderingCore import vtkRenderWindow

    for name in ("vtkEGLRenderWindow", "vtkOSOpenGLRenderWindow"):
        if hasattr(gl, name):
            window = getattr(gl, name)()
            window.SetOffScreenRendering(True)
            return window
    window = vtkRenderWindow()
    if "X" in type(window).__name__:  # as Debian builds it: X or nothing
        return _window_on_egl()
    window.SetOffScreenRendering(True)
    return window


def _window_on_egl() -> Any:
    """Give VTK an OpenGL context that EGL has made without any display."""
    from vtkmodules.vtkRenderingOpenGL2 import vtkGenericOpenGLRenderWindow

    egl = ctypes.CDLL("libEGL.so.1")
    pointer = ctypes.c_void_p
    egl.eglGetProcAddress.restype = pointer
    for name in ("eglCreateContext", "eglCreatePbufferSurface"):
        getattr(egl, name).restype = pointer
    get_display = ctypes.CFUNCTYPE(pointer, ctypes.c_uint, pointer, pointer)(
        egl.eglGetProcAddress(b"eglGetPlatformDisplayEXT")
    )
    display = pointer(get_display(_SURFACELESS, None, None))
    config, count = pointer(), ctypes.c_int()

    def integers(values: tuple[int, ...]) -> ctypes.Array:
        return (ctypes.c_int * len(values))(*values)

    good = egl.eglInitialize(display, None, None) and egl.eglBindAPI(_OPENGL_API)
    good = good and egl.eglChooseConfig(
        display, integers(_CONFIG), ctypes.byref(config), 1, ctypes.byref(count)
    )
    if not (good and count.value):
        raise OSError("EGL offers no OpenGL")
    context = pointer(egl.eglCreateContext(display, config, None, integers(_CONTEXT)))
    surface = pointer(egl.eglCreatePbufferSurface(display, config, integers(_PBUFFER)))

    def make_current(*_: Any) -> None:
        egl.eglMakeCurrent(display, surface, surface, context)

    make_current()
    window = vtkGenericOpenGLRenderWindow()
    window.SetOffScreenRendering(True)
    window.AddObserver("WindowMakeCurrentEvent", make_current)
    window.SetReadyForRendering(True)
    window.SetSupportsOpenGL(True)
    window.SetIsCurrent(True)
    window.SetIsDirect(True)
    window.OpenGLInit()
    return window


def _without_glx() -> None:
    """Keep GLEW, through which VTK finds OpenGL, from asking the X server as well.

    GLEW has all of OpenGL by then, but fails for want of a display. A function of the same name
    that is loaded before VTK answers in its place; Python cannot define one, a C compiler is at
    hand wherever dolfinx is. Builds of VTK that bring EGL or OSMesa can do without.
    """
    with tempfile.TemporaryDirectory() as folder:
        source, library = Path(folder) / "glx.c", Path(folder) / "glx.so"
        source.write_text("int glxewInit(void) { return 0; }\n", encoding="ascii")
        compiler = os.environ.get("CC", "cc").split()
        with suppress(OSError, subprocess.CalledProcessError):
            subprocess.run([*compiler, "-shared", "-fPIC", "-o", library, source], check=True)
            ctypes.CDLL(str(library), mode=ctypes.RTLD_GLOBAL)


def main() -> int:
    """Render one file into another."""
    scene, image = sys.argv[1:]
    with np.load(scene, allow_pickle=False) as data:
        np.save(image, render(dict(data)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
