"""What the active camera sees of the places of assets, at some frames of its animation."""

import math
from collections.abc import Sequence

import bpy
import mathutils
import numpy as np

from ...core.distance.forecasts import PlacedLevels, View
from ..cameras import read_scene_camera, render_size
from ..imaging.images import find_images
from .assets import Asset
from .chains import Chain

MAX_FRAMES = 9


def read_view(scene: bpy.types.Scene) -> View | None:
    """Return what the active camera of a scene sees at the current frame, or None if there is none."""
    camera = read_scene_camera(scene)
    if camera is None:
        return None
    direction = np.array(scene.camera.matrix_world.to_quaternion() @ mathutils.Vector((0.0, 0.0, -1.0)))
    if camera.field_of_view == 0.0 or scene.camera.data.type != "PERSP":
        return View(camera, direction)
    pixel, data = camera.pixel_size(1.0), scene.camera.data
    diagonal = pixel * (0.5 * math.hypot(*render_size(scene.render)) + camera.pixels * math.hypot(data.shift_x, data.shift_y))
    return View(camera, direction, diagonal)


def choose_frames(scene: bpy.types.Scene, count: int = MAX_FRAMES) -> list[int]:
    """Return up to `count` frames, from the first to the last, at which the active camera may see something else; the current one if it
    does not move."""
    movers: list[bpy.types.ID] = [] if scene.camera is None else [scene.camera.data]
    item = scene.camera
    while item is not None:
        movers.append(item)
        item = item.parent
    is_moving = any(mover.animation_data is not None or getattr(mover, "constraints", ()) for mover in movers)
    if not is_moving and not any(marker.camera is not None for marker in scene.timeline_markers):
        return [scene.frame_current]
    return np.unique(np.linspace(scene.frame_start, scene.frame_end, count).round().astype(int)).tolist()


def read_views(scene: bpy.types.Scene) -> list[View]:
    """Return what the active camera sees at the frames of `choose_frames`, without those that have no camera.

    The scene is evaluated at each of them, and is at its current frame afterwards.
    """
    frames = choose_frames(scene)
    if frames == [scene.frame_current]:
        views = [read_view(scene)]
    else:
        current, subframe, views = scene.frame_current, scene.frame_subframe, []
        try:
            for frame in frames:
                scene.frame_set(frame)
                views.append(read_view(scene))
        finally:
            scene.frame_set(current, subframe=subframe)
    return [view for view in views if view is not None]


def place_levels(asset: Asset, chain: Chain, error_factor: float, views: Sequence[View]) -> PlacedLevels:
    """Return the levels of an asset with the sizes of pixels at its places."""
    places = asset.places
    sizes = (np.array(values) for values in zip(*(view.measure(places) for view in views), strict=True))
    return PlacedLevels(np.array(chain.pixel_sizes), np.array(chain.triangles, np.int64), error_factor, *sizes)


def count_image_bytes(objects: Sequence[bpy.types.Object]) -> dict[bpy.types.Image, int]:
    """Return the memory that a renderer needs for each image in the materials of `objects`, in bytes: four channels of one byte, or of four
    bytes if it has floats."""
    materials = dict.fromkeys(slot.material for item in objects for slot in item.material_slots if slot.material is not None)
    return {image: 4 * math.prod(image.size) * (4 if image.is_float else 1) for image in find_images(materials)}
