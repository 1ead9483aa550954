"""Cameras of photographs as camera objects, whose background images are the photographs: new ones, and such that move when refined."""

import contextlib
import math
from pathlib import Path

import bpy
import mathutils
import numpy as np

from ...core.errors import FileError, SettingsError
from ...core.files.far_meshes import near_origin
from ...core.files.ply_headers import read_ply_header
from ...core.geometry.lenses import Lens, PhotoCamera
from .photo_folders import PhotoFolder, strip_extension
from .scene_cameras import TO_PHOTO_AXES, find_background, has_photograph, read_lens, store_lens

SENSOR_SIZE = 36.0  # millimeters, along the side that the sensor spans
DISPLAY_FRACTION = 0.04  # size of cameras in the view relative to the diagonal of the box around all of them
VIEW_DISTANCE = 10.0  # cameras show what is nearer than this multiple of the diagonal


def create_cameras(
    cameras: list[PhotoCamera], folder: Path, name: str, scene: bpy.types.Scene, *, is_y_up: bool
) -> tuple[bpy.types.Object, int]:
    """Create a collection with an Empty and its children, a camera object for each of `cameras`.

    Args:
        cameras: at least one.
        folder: of the photographs. Those that are missing become images without a file.
        name: of the collection and the Empty.
        scene: that gets the collection, and whose render size decides the placement of the photographs.
        is_y_up: turn all cameras, so that the y axis of their world becomes the z axis of Blender.

    Returns:
        The Empty, and the number of missing photographs.
    """
    collection = bpy.data.collections.new(name)
    scene.collection.children.link(collection)
    parent = bpy.data.objects.new(name, None)
    collection.objects.link(parent)
    parent.rotation_euler.x = 0.5 * math.pi if is_y_up else 0.0
    diagonal = float(np.linalg.norm(np.ptp([camera.position for camera in cameras], axis=0)))
    missing, photographs = 0, PhotoFolder(folder)
    for camera in cameras:
        image, is_found = _open_photograph(camera.name, photographs)
        missing += not is_found
        item = _create_camera(camera, image, scene)
        if diagonal > 0.0:
            item.data.display_size = DISPLAY_FRACTION * diagonal
            item.data.clip_end = max(item.data.clip_end, VIEW_DISTANCE * diagonal)
        item.parent = parent
        collection.objects.link(item)
    parent.empty_display_size = max(2.0 * DISPLAY_FRACTION * diagonal, 1e-3) if diagonal > 0.0 else 1.0
    return parent, missing


def import_mesh(path: Path, *, is_y_up: bool) -> np.ndarray | None:
    """Import an .obj or .ply file with its own axes, or turned like cameras in `create_cameras`. Returns the position (3,) from which it
    was moved to the origin, because its coordinates are too large for single precision, otherwise None. Raises FileError."""
    forward, up = ("NEGATIVE_Z", "Y") if is_y_up else ("Y", "Z")
    importer = bpy.ops.wm.obj_import if path.suffix.lower() == ".obj" else bpy.ops.wm.ply_import
    if path.suffix.lower() == ".ply":
        read_ply_header(path)
    with near_origin(path) as (near, origin):
        try:
            importer(filepath=str(near), forward_axis=forward, up_axis=up)
        except RuntimeError as error:  # raised by Blender's operators
            raise FileError(f'Blender cannot read "{path}"; export it again.') from error
    return origin


def place_registered_camera(camera: PhotoCamera, image: bpy.types.Image, scene: bpy.types.Scene) -> bpy.types.Object:
    """Give the camera object of `scene` whose background image is `image` the place and lens of `camera`, or create such an object."""
    item = next((item for item in scene.objects if has_photograph(item) and find_background(item.data).image == image), None)
    if item is None:
        item = _create_camera(camera, image, scene)
        scene.collection.objects.link(item)
        return item
    show_lens(item.data, camera.lens, scene)
    item.matrix_world = _world_matrix(camera)
    return item


def set_render_size(scene: bpy.types.Scene, size: tuple[int, int]) -> None:
    """Render square pixels, `size` (width, height) of them."""
    render = scene.render
    render.resolution_x, render.resolution_y = size
    render.pixel_aspect_x = render.pixel_aspect_y = 1.0


def show_lens(data: bpy.types.Camera, lens: Lens, scene: bpy.types.Scene) -> None:
    """Store `lens` with a camera, and set its focal length, sensor and shift like `lens` without its distortion, so that the camera view
    shows the photograph, fitted into the render size of `scene`, where it belongs."""
    store_lens(data, lens)
    (width, height), (focal_x, focal_y) = lens.size, lens.focal
    render = scene.render
    frame_aspect = render.resolution_x * render.pixel_aspect_x / (render.resolution_y * render.pixel_aspect_y)
    data.type = "PERSP"
    if width / focal_x > frame_aspect * height / focal_y:
        data.sensor_fit, data.sensor_width, side = "HORIZONTAL", SENSOR_SIZE, width / focal_x
    else:
        data.sensor_fit, data.sensor_height, side = "VERTICAL", SENSOR_SIZE, height / focal_y
    data.lens = SENSOR_SIZE / side
    data.shift_x = (0.5 * width - lens.center[0]) / focal_x / side
    data.shift_y = (lens.center[1] - 0.5 * height) / focal_y / side


def check_movable(item: bpy.types.Object) -> None:
    """Check that nothing but its own transform and its parent place a camera object. Raises SettingsError if it is linked, constrained or
    animated."""
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
    motion = _world_matrix(refined) @ _world_matrix(given).inverted()
    item.matrix_world = motion @ item.matrix_world
    if refined.lens == given.lens:
        return
    if read_lens(item.data) is None:
        item.data.lens *= refined.lens.focal[0] / given.lens.focal[0]
    else:
        show_lens(item.data, refined.lens, scene)


def _create_camera(camera: PhotoCamera, image: bpy.types.Image, scene: bpy.types.Scene) -> bpy.types.Object:
    name = strip_extension(camera.name)
    data = bpy.data.cameras.new(name)
    show_lens(data, camera.lens, scene)
    focal_x, focal_y = camera.lens.focal
    image.display_aspect = (focal_y / focal_x, 1.0) if focal_y > focal_x else (1.0, focal_x / focal_y)
    background = data.background_images.new()
    background.image, background.frame_method, background.alpha = image, "FIT", 1.0
    data.show_background_images = True
    item = bpy.data.objects.new(name, data)
    item.rotation_mode = "QUATERNION"  # Euler angles lose digits near the poles
    item.matrix_basis = _world_matrix(camera)
    return item


def _world_matrix(camera: PhotoCamera) -> mathutils.Matrix:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = camera.rotation.T @ TO_PHOTO_AXES, camera.position
    return mathutils.Matrix(matrix.tolist())


def _open_photograph(name: str, folder: PhotoFolder) -> tuple[bpy.types.Image, bool]:
    """Return a new image that loads a photograph when it is needed, and whether its file was found."""
    try:
        path, is_found = folder.find_photograph(name), True
    except FileError:
        path, is_found = folder.folder / name, False
    image = bpy.data.images.load(str(path)) if is_found else bpy.data.images.new(path.name, 1, 1)
    if not is_found:
        image.source = "FILE"
    image.filepath = _stored_path(path)
    return image, is_found


def _stored_path(path: Path) -> str:
    """Return `path` relative to the .blend file if that is saved and users want that, as Blender does."""
    if bpy.data.is_saved and bpy.context.preferences.filepaths.use_relative_paths:
        with contextlib.suppress(ValueError):  # on another drive
            return bpy.path.relpath(str(path))
    return str(path)
