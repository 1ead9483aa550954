"""Blender's camera as the core's."""

import bpy
import numpy as np

from ..core.cameras import Camera


def scene_camera(scene: bpy.types.Scene) -> Camera | None:
    """The active camera of `scene` at its render resolution, or None when it has none."""
    camera = scene.camera
    if camera is None or camera.type != "CAMERA":
        return None
    render = scene.render
    scale = render.resolution_percentage / 100.0
    width, height = max(int(render.resolution_x * scale), 1), max(int(render.resolution_y * scale), 1)
    across_width = _spans_width(camera.data, width * render.pixel_aspect_x, height * render.pixel_aspect_y)
    pixels = width if across_width else height
    position = np.array(camera.matrix_world.translation, np.float64)
    if camera.data.type == "ORTHO":
        return Camera(position, pixels, 0.0, camera.data.ortho_scale)
    return Camera(position, pixels, camera.data.angle)


def _spans_width(data: bpy.types.Camera, width: float, height: float) -> bool:
    """Whether the angle of the camera, or its orthographic scale, is measured across the width of the picture."""
    return width >= height if data.sensor_fit == "AUTO" else data.sensor_fit == "HORIZONTAL"
