"""Camera objects that take the place of a refined camera of their photograph."""

import bpy
import mathutils
import numpy as np

from ...core.errors import SettingsError
from ...core.geometry.lenses import PhotoCamera
from .camera_objects import show_lens
from .scene_cameras import TO_PHOTO_AXES, read_lens, store_lens


def check_movable(item: bpy.types.Object) -> None:
    """Check that nothing but its own transform and its parent place a camera object.

    Raises:
        SettingsError: it is linked, constrained or animated.
    """
    if not item.is_editable:
        raise SettingsError(f'The camera "{item.name}" is linked from a library; make it local.')
    animation = item.animation_data
    is_animated = animation is not None and (animation.action is not None or len(animation.drivers) or len(animation.nla_tracks))
    if is_animated or any(not constraint.mute for constraint in item.constraints):
        raise SettingsError(
            f'The camera "{item.name}" is animated or has constraints, which would move it back; remove them, or bake them.'
        )


def has_own_lens(item: bpy.types.Object) -> bool:
    """Return whether the lens of a camera object may be changed: its camera data is local and belongs to no other object."""
    return item.data.is_editable and item.data.users == 1


def move_camera(item: bpy.types.Object, given: PhotoCamera, refined: PhotoCamera, scene: bpy.types.Scene) -> None:
    """Move a camera object as the camera of its photograph moved from `given` to `refined`, and change its lens if that differs."""
    motion = _to_world(refined) @ _to_world(given).inverted()
    item.matrix_world = motion @ item.matrix_world
    if refined.lens == given.lens:
        return
    if read_lens(item.data) is None:
        item.data.lens *= refined.lens.focal[0] / given.lens.focal[0]
    else:
        show_lens(item.data, refined.lens, scene)
        store_lens(item.data, refined.lens)


def _to_world(camera: PhotoCamera) -> mathutils.Matrix:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = camera.rotation.T @ TO_PHOTO_AXES, camera.position
    return mathutils.Matrix(matrix.tolist())
