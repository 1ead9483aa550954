"""Viewers of terrains: the 3D Viewport that the user looks at, or a camera with the scene's render settings. Also sentences
about what they show."""

import math

import bpy
import mathutils
import numpy as np

from ..core.geometry.cameras import Camera
from ..core.geometry.viewers import FULL_SPHERE, Projection, Viewer, camera_window, projection_from_matrix
from .cameras import render_size, sensor_spans_width
from .units import format_length

DEFAULT_EXTENT = 36.0 / 50.0  # sensor width divided by focal length of a new camera
MIN_EXTENT = 1e-6  # An orthographic camera may have the scale 0.
DEFAULT_NEAR, DEFAULT_FAR = 0.1, 1000.0  # Those of a new camera.
MIN_CLIP_END = 4.0  # relative to the size of a terrain
MIN_CLIP_START = 2e-6  # relative to the end of the clipping range: nearer surfaces of far terrain would flicker


def viewer_matrix(scene: bpy.types.Scene, region: bpy.types.RegionView3D | None) -> mathutils.Matrix:
    """Return the matrix of the viewer in world space.

    The viewer is the 3D Viewport `region`. Without it, or if it looks through the active camera, the viewer is that camera. Without a
    camera it is the 3D cursor.
    """
    if scene.camera is not None and (region is None or region.view_perspective == "CAMERA"):
        return scene.camera.matrix_world
    return region.view_matrix.inverted() if region is not None else scene.cursor.matrix


def viewer_projection(scene: bpy.types.Scene, area: bpy.types.Area | None) -> Projection:
    """Return the projection of the viewer that `viewer_matrix` returns for the 3D Viewport `area`.

    A view through the active camera has the zoom and offset of its frame in the viewport. Without a viewport it is the render resolution
    of the scene that counts.
    """
    if area is None:
        return camera_projection(scene, scene.camera)
    space = area.spaces.active
    window = [region for region in area.regions if region.type == "WINDOW"][-1]  # A quad view has four; region_3d belongs to the last one.
    camera = scene.camera if space.region_3d.view_perspective == "CAMERA" else None
    lens = camera.data if camera is not None and camera.type == "CAMERA" else space
    size = max(window.width, 1), max(window.height, 1)
    return projection_from_matrix(np.array(space.region_3d.window_matrix, np.float64), size, lens.clip_start, lens.clip_end)


def camera_projection(scene: bpy.types.Scene, camera: bpy.types.Object | None) -> Projection:
    """Return the projection of a camera at the render resolution of `scene`, of a new camera for any other object.

    camera: the original object, or the evaluated one if its lens is animated.
    """
    render = scene.render
    size, pixel_aspect = render_size(render), (render.pixel_aspect_x, render.pixel_aspect_y)
    if camera is None or camera.type != "CAMERA":
        window = camera_window(DEFAULT_EXTENT, size[0] >= size[1], (0.0, 0.0), size)
        return Projection("perspective", window, size, DEFAULT_NEAR, DEFAULT_FAR)
    data = camera.data
    if data.type not in ("PERSP", "ORTHO"):
        return Projection("panoramic", FULL_SPHERE, size, data.clip_start, data.clip_end)
    is_orthographic = data.type == "ORTHO"
    sensor = data.sensor_height if data.sensor_fit == "VERTICAL" else data.sensor_width
    extent = max(data.ortho_scale if is_orthographic else sensor / data.lens, MIN_EXTENT)
    spans_width = sensor_spans_width(data, size[0] * pixel_aspect[0], size[1] * pixel_aspect[1])
    window = camera_window(extent, spans_width, (data.shift_x, data.shift_y), size, pixel_aspect)
    return Projection("orthographic" if is_orthographic else "perspective", window, size, data.clip_start, data.clip_end)


def build_viewer(matrix: mathutils.Matrix, projection: Projection) -> Viewer:
    """Return the viewer in world space with a matrix of Blender, whose scale does not count: a camera that is scaled sees the same."""
    columns = np.array(matrix, np.float64)
    lengths = np.linalg.norm(columns[:3, :3], axis=0)
    columns[:3, :3] /= np.where(lengths > 0.0, lengths, 1.0)
    return Viewer(columns, projection)


def camera_viewer(scene: bpy.types.Scene, camera: bpy.types.Object) -> Viewer:
    """Return a camera, as an original or an evaluated object, at the render resolution of `scene` as a viewer in world space."""
    return build_viewer(camera.matrix_world, camera_projection(scene, camera))


def viewport_camera(region: bpy.types.RegionView3D, width: int) -> Camera:
    """Return the view of a 3D Viewport that is `width` pixels wide, also through a camera."""
    position, projection = np.array(region.view_matrix.inverted().translation, np.float64), region.window_matrix
    if projection[3][3] != 0.0:  # orthographic
        return Camera(position, max(width, 1), 0.0, 2.0 / projection[0][0])
    return Camera(position, max(width, 1), 2.0 * math.atan(1.0 / projection[0][0]))


def extend_clipping(space: bpy.types.SpaceView3D, size: float) -> None:
    """Let a 3D Viewport show a terrain of this size, scene units, as a whole, also from outside and after *Frame All*.

    In Solid shading it no longer outlines objects, which would draw lines between tiles.
    """
    space.shading.show_object_outline = False
    space.clip_end = max(space.clip_end, MIN_CLIP_END * size)
    space.clip_start = max(space.clip_start, MIN_CLIP_START * space.clip_end)


def describe_camera_range(scene: bpy.types.Scene, size: float) -> str:
    """Return a sentence if the active camera does not reach to the end of a terrain of this size, scene units; else an empty string."""
    camera = scene.camera
    if camera is None or camera.type != "CAMERA" or camera.data.clip_end >= size:
        return ""
    shown = format_length(scene, camera.data.clip_end)
    return f'The camera "{camera.name}" shows nothing beyond {shown}; raise Clip End to {format_length(scene, size)}.'


def describe_solid_view() -> str:
    """Return a sentence if a 3D Viewport shows one color per material; else an empty string."""
    is_solid = any(shading.color_type == "MATERIAL" for shading in _solid_views())
    return "Solid view shows the terrain in one color, Material Preview in those of the ground." if is_solid else ""


def describe_solid_cloud() -> str:
    """Return a sentence about billboard clouds if a 3D Viewport is in Solid shading; else an empty string."""
    return "Material Preview shows how a cloud looks, Solid view only its quads." if _solid_views() else ""


def _solid_views() -> list[bpy.types.View3DShading]:
    """Return the shading of the 3D Viewports of all windows that are in Solid shading."""
    windows = [] if bpy.app.background else bpy.context.window_manager.windows
    viewports = (area.spaces.active for window in windows for area in window.screen.areas if area.type == "VIEW_3D")
    return [space.shading for space in viewports if space.shading.type == "SOLID"]
