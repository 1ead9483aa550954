"""Blender's camera as the core's, and the core's views as Blender's camera."""

import bpy
import mathutils
import numpy as np

from ..core.btf.texels import View
from ..core.cameras import Camera
from ..core.errors import SettingsError
from ..core.unwrap.visibility import Shot


def scene_camera(scene: bpy.types.Scene) -> Camera | None:
    """The active camera of `scene` at its render resolution, or None when it has none."""
    camera = scene.camera
    if camera is None or camera.type != "CAMERA":
        return None
    render = scene.render
    width, height = _resolution(render)
    across_width = _spans_width(camera.data, width * render.pixel_aspect_x, height * render.pixel_aspect_y)
    pixels = width if across_width else height
    position = np.array(camera.matrix_world.translation, np.float64)
    if camera.data.type == "ORTHO":
        return Camera(position, pixels, 0.0, camera.data.ortho_scale)
    return Camera(position, pixels, camera.data.angle)


def look(scene: bpy.types.Scene, view: View) -> None:
    """Let the camera of `scene`, an orthographic one, take the picture `view`."""
    extent = view.side * view.pixel
    camera, render = scene.camera, scene.render
    camera.data.ortho_scale = extent
    camera.data.clip_start, camera.data.clip_end = 0.01 * extent, 4.0 * extent
    matrix = np.eye(4)
    matrix[:3] = np.column_stack([view.right, view.up, view.direction, view.center + 2.0 * extent * view.direction])
    camera.matrix_world = mathutils.Matrix(matrix.tolist())
    render.resolution_x = render.resolution_y = view.side


def shot(scene: bpy.types.Scene, camera: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> Shot:
    """What a camera takes at the render resolution of `scene`.

    Raises:
        SettingsError: when it is a panoramic one.
    """
    if camera.data.type not in ("PERSP", "ORTHO"):
        raise SettingsError(f'The camera "{camera.name}" is panoramic; choose a perspective or an orthographic one.')
    render = scene.render
    width, height = _resolution(render)
    aspect = {"scale_x": render.pixel_aspect_x, "scale_y": render.pixel_aspect_y}
    projection = np.array(camera.calc_matrix_camera(depsgraph, x=width, y=height, **aspect), np.float64)
    return Shot(projection @ np.array(camera.matrix_world.normalized().inverted(), np.float64), (width, height))


def _resolution(render: bpy.types.RenderSettings) -> tuple[int, int]:
    """Width and height of what is rendered, in pixels."""
    scale = render.resolution_percentage / 100.0
    return max(int(render.resolution_x * scale), 1), max(int(render.resolution_y * scale), 1)


def _spans_width(data: bpy.types.Camera, width: float, height: float) -> bool:
    """Whether the angle of the camera, or its orthographic scale, is measured across the width of the picture."""
    return width >= height if data.sensor_fit == "AUTO" else data.sensor_fit == "HORIZONTAL"
