"""OpenGL without a display: which library draws here, and a context of it.

EGL on a device without a screen comes first, OSMesa (all in software) second. PyOpenGL binds
itself to one of them at its first import, so a process draws with one backend only.
"""

from __future__ import annotations

import ctypes
import ctypes.util
import importlib
import os
from collections.abc import Callable
from functools import cache
from typing import Protocol

from spatial.errors import MissingError, StateError, unknown

PACKAGES = {"egl": "libegl1 libgl1-mesa-dri", "osmesa": "libosmesa6"}
"""Debian packages a backend needs."""
_LIBRARIES = {"egl": "EGL", "osmesa": "OSMesa"}
_EGL_PLATFORM_DEVICE = 0x313F
_MOST_DEVICES = 8


class GlContext(Protocol):
    """What the contexts of MuJoCo offer."""

    def make_current(self) -> None:
        """Draw in the calling thread from now on."""

    def free(self) -> None:
        """Give everything back."""


@cache
def usable_backends() -> tuple[str, ...]:
    """Return the backends whose library works here, best first; empty without any."""
    probes: dict[str, Callable[[ctypes.CDLL], bool]] = {
        "egl": _egl_initialises,
        "osmesa": lambda library: hasattr(library, "OSMesaCreateContextExt"),
    }
    found = []
    for backend, probe in probes.items():
        name = ctypes.util.find_library(_LIBRARIES[backend])
        try:
            if name is not None and probe(ctypes.CDLL(name)):
                found.append(backend)
        except (OSError, AttributeError):  # present but broken, or too old: the same as missing
            continue
    return tuple(found)


def open_context(backend: str, *, width: int, height: int, threads: int | None = None) -> GlContext:
    """Return a context of `egl` or `osmesa` for images up to a size [px].

    `threads` limits what the software rasteriser of this process uses, if it is asked first:
    a live site shares its cores with physics, tracker and browser.

    Raises:
        MissingError: the library is not installed or does not start.
        StateError: this process draws with the other one already.
    """
    if backend not in PACKAGES:
        raise MissingError(unknown("GL backend", backend, PACKAGES))
    if backend not in usable_backends():
        raise MissingError(
            f"the {_LIBRARIES[backend]} library does not work here; on Debian and Ubuntu: "
            f"apt-get install {PACKAGES[backend]}"
        )
    bound = os.environ.get("PYOPENGL_PLATFORM", backend)
    if bound != backend:
        raise StateError(f"this process draws with {bound} already and cannot use {backend} too")
    if threads is not None:
        os.environ.setdefault("LP_NUM_THREADS", str(threads))
    context: GlContext = importlib.import_module(f"mujoco.{backend}").GLContext(width, height)
    return context


def _egl_initialises(library: ctypes.CDLL) -> bool:
    """Try to start EGL on a device, as MuJoCo will."""
    library.eglGetProcAddress.restype = ctypes.c_void_p
    library.eglGetProcAddress.argtypes = [ctypes.c_char_p]
    query, display_of = (
        library.eglGetProcAddress(name)
        for name in (b"eglQueryDevicesEXT", b"eglGetPlatformDisplayEXT")
    )
    if not query or not display_of:
        return False
    devices = (ctypes.c_void_p * _MOST_DEVICES)()
    count = ctypes.c_int()
    query_devices = ctypes.CFUNCTYPE(ctypes.c_uint, ctypes.c_int, ctypes.c_void_p, ctypes.c_void_p)
    get_display = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_uint, ctypes.c_void_p, ctypes.c_void_p)
    if not query_devices(query)(_MOST_DEVICES, devices, ctypes.byref(count)):
        return False
    library.eglInitialize.argtypes = [ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p]
    displays = (
        get_display(display_of)(_EGL_PLATFORM_DEVICE, device, None)
        for device in devices[: count.value]
    )
    return any(display and library.eglInitialize(display, None, None) for display in displays)
