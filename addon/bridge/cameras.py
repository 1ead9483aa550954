"""Conversion between Blender cameras and the cameras and views of the core."""

from collections.abc import Sequence

import bpy
import mathutils
import numpy as np

from ..core.errors import SettingsError
from ..core.geometry.cameras import Camera, CameraProjection, OrthographicView


def read_scene_camera(scene: bpy.types.Scene) -> Camera | None:
    """Return the active camera of `scene` at its render resolution, or None if there is none."""
    camera = scene.camera
    if camera is None or camera.type != "CAMERA":
        return None
    render = scene.render
    width, height = render_size(render)
    spans_width = sensor_spans_width(camera.data, width * render.pixel_aspect_x, height * render.pixel_aspect_y)
    pixels = width if spans_width else height
    position = np.array(camera.matrix_world.translation, np.float64)
    if camera.data.type == "ORTHO":
        return Camera(position, pixels, 0.0, camera.data.ortho_scale)
    return Camera(position, pixels, camera.data.angle)


def light_matrix(direction: Sequence[float]) -> mathutils.Matrix:
    """Return the world matrix of a light at the origin whose light comes from `direction` (3,)."""
    return mathutils.Vector(direction).to_track_quat("Z", "Y").to_matrix().to_4x4()


def set_camera_view(scene: bpy.types.Scene, view: OrthographicView) -> None:
    """Set the orthographic camera and the resolution of `scene` to `view`."""
    extent = view.resolution * view.pixel_size
    camera, render = scene.camera, scene.render
    camera.data.ortho_scale = extent
    camera.data.clip_start, camera.data.clip_end = 0.01 * extent, 4.0 * extent
    matrix = np.eye(4)
    matrix[:3] = np.column_stack([view.right, view.up, view.direction, view.center + 2.0 * extent * view.direction])
    camera.matrix_world = mathutils.Matrix(matrix.tolist())
    render.resolution_x = render.resolution_y = view.resolution


def read_camera_projection(scene: bpy.types.Scene, camera: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> CameraProjection:
    """Return the projection of a camera at the render resolution of `scene`.

    Raises:
        SettingsError: the camera is panoramic.
    """
    if camera.data.type not in ("PERSP", "ORTHO"):
        raise SettingsError(f'The camera "{camera.name}" is panoramic; choose a perspective or an orthographic one.')
    render = scene.render
    width, height = render_size(render)
    aspect = {"scale_x": render.pixel_aspect_x, "scale_y": render.pixel_aspect_y}
    projection = np.array(camera.calc_matrix_camera(depsgraph, x=width, y=height, **aspect), np.float64)
    return CameraProjection(projection @ np.array(camera.matrix_world.normalized().inverted(), np.float64), (width, height))


def render_size(render: bpy.types.RenderSettings) -> tuple[int, int]:
    """Return width and height of the rendered image in pixels."""
    scale = render.resolution_percentage / 100.0
    return max(int(render.resolution_x * scale), 1), max(int(render.resolution_y * scale), 1)


def sensor_spans_width(data: bpy.types.Camera, width: float, height: float) -> bool:
    """Return whether the field of view, or the orthographic scale, spans the width of the image."""
    return width >= height if data.sensor_fit == "AUTO" else data.sensor_fit == "HORIZONTAL"
