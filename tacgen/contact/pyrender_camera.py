"""The gap map's depth by pyrender, as in the paper: needs EGL, or OSMesa with PyOpenGL 3.1.4."""

import os
from typing import Any

import numpy as np

from tacgen.contact.raster import Float64, Int32
from tacgen.core.errors import ContactError
from tacgen.core.records import Sensor

_renderers: dict[tuple[int, int], Any] = {}
"""The one living renderer of this process: deleting one takes the EGL display of all others with
it, so it is resized and never deleted."""


def depth_map_mm(
    vertices_mm: Float64, faces: Int32, pose_gel_object: Float64, sensor: Sensor
) -> Float64:
    """Height of the nearest surface over each pixel (H, W), mm; +inf where there is none.

    The pose's translation along z is left out, as in the rasteriser.

    Raises ``ContactError`` if neither EGL nor OSMesa works here.
    """
    import trimesh

    pyrender = _load_pyrender()
    turned = vertices_mm @ pose_gel_object[:3, :3].T + [*pose_gel_object[:2, 3], 0.0]
    low_mm, high_mm = float(turned[:, 2].min()), float(turned[:, 2].max())
    # The camera looks along +z from just below the object, so that its depth buffer's digits are
    # spent on the object alone.
    near_mm, far_mm = 1.0, 1.0 + 1.02 * (high_mm - low_mm) + 0.02
    start_mm = low_mm - near_mm - 0.01
    half_mm = 0.5 * sensor.mm_per_px * np.array([sensor.width_px, sensor.height_px])
    camera = pyrender.OrthographicCamera(*half_mm, znear=near_mm, zfar=far_mm)
    view = np.diag([1.0, -1.0, -1.0, 1.0])
    view[2, 3] = start_mm
    scene = pyrender.Scene()
    mesh = trimesh.Trimesh(turned, faces, process=False)
    node = scene.add(pyrender.Mesh.from_trimesh(mesh, smooth=False))
    scene.add(camera, pose=view)
    # Segmentation is the one mode of pyrender without multisampling, which would give the depth
    # a third of a pixel beside each centre.
    flags = pyrender.RenderFlags.SEG | pyrender.RenderFlags.SKIP_CULL_FACES
    _, shown = _renderer(pyrender, sensor).render(scene, flags=flags, seg_node_map={node: 255})
    shown = shown.astype(np.float64)
    miss = shown == 0.0
    # pyrender 0.1.45 turns every depth buffer into distances as if the camera were perspective:
    # back to the buffer's value, and from there as an orthographic camera has it.
    # Source: mmatl/pyrender issue 254, pull request 40.
    with np.errstate(divide="ignore", invalid="ignore"):
        screen = (far_mm + near_mm - 2 * near_mm * far_mm / shown) / (far_mm - near_mm)
        depth_mm = 0.5 * (screen * (far_mm - near_mm) + far_mm + near_mm)
    return np.where(miss, np.inf, start_mm + depth_mm)


def _load_pyrender() -> Any:
    """Import pyrender on a platform that needs no display, on which PyOpenGL then settles."""
    os.environ.setdefault("PYOPENGL_PLATFORM", "egl")
    try:
        import pyrender
    except (ImportError, AttributeError, OSError) as error:
        raise ContactError(_unusable(error)) from None
    return pyrender


def _renderer(pyrender: Any, sensor: Sensor) -> Any:
    size = (sensor.width_px, sensor.height_px)
    if not _renderers:
        try:
            _renderers[size] = pyrender.OffscreenRenderer(*size)
        # Drivers fail in many ways, and each means the same: this machine cannot do it.
        except Exception as error:
            raise ContactError(_unusable(error)) from None
    renderer = next(iter(_renderers.values()))
    renderer.viewport_width, renderer.viewport_height = size
    return renderer


def _unusable(error: Exception) -> str:
    platform = os.environ.get("PYOPENGL_PLATFORM", "")
    return (
        f"camera = 'pyrender' does not work here with PYOPENGL_PLATFORM={platform} ({error}); "
        "use camera = 'raster', or install EGL (libegl1), or install OSMesa (libosmesa6) with "
        "PyOpenGL 3.1.4 or newer and set PYOPENGL_PLATFORM=osmesa"
    )
