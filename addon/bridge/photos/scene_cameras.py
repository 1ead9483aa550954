"""Cameras of the scene whose background image is a photograph, as cameras of photographs."""

import json
import math
from dataclasses import asdict, dataclass

import bpy
import numpy as np

from ...core.errors import FarfieldError, SettingsError
from ...core.geometry.lenses import Lens, PhotoCamera

LENS_PROPERTY = "farfield_lens"  # custom property of camera data: the lens of its photograph as JSON, which replaces that of Blender
TO_PHOTO_AXES = np.diag([1.0, -1.0, -1.0])  # y up and looking along -z, to y down and looking along z
MAX_SHEAR = 1e-4  # largest cosine between the axes of a camera


@dataclass(frozen=True)
class _Rectangle:
    """A rectangle in the image plane at distance 1: its size, and its center (2,) relative to the optical axis, y up."""

    width: float
    height: float
    center: np.ndarray


def find_background(data: bpy.types.Camera) -> bpy.types.CameraBackgroundImage | None:
    """Return the first background image of a camera that is shown and is an image, None if there is none."""
    if not data.show_background_images:
        return None
    shown = (item for item in data.background_images if item.show_background_image and item.source == "IMAGE")
    return next((item for item in shown if item.image is not None), None)


def has_photograph(item: bpy.types.Object) -> bool:
    """Return whether an object is a camera with a background image."""
    return item.type == "CAMERA" and find_background(item.data) is not None


def read_photo_camera(item: bpy.types.Object, scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> PhotoCamera:
    """Return the camera that projects world space to the pixels of the background image of `item`, as the camera view shows them.

    The lens stored in LENS_PROPERTY replaces focal length, sensor and shift of Blender, and the placement of the image. Flips of the image
    are not part of the camera: they mirror its pixels. The image is loaded if its size is needed.

    Raises:
        SettingsError: the camera is not perspective, is sheared or has no size, or its stored lens is damaged.
    """
    evaluated = item.evaluated_get(depsgraph)
    data = evaluated.data
    background = find_background(data)
    if data.type != "PERSP":
        kind = "orthographic" if data.type == "ORTHO" else "panoramic"
        raise SettingsError(f'The camera "{item.name}" is {kind}; make it perspective, or hide its background image.')
    axes, position = _read_axes(evaluated)
    lens = read_lens(item.data)  # the evaluated copy does not follow changes of custom properties at once
    if lens is None:
        lens, roll = _lens_of_background(item.name, data, background, scene)
        axes = axes @ roll.T
    rotation = TO_PHOTO_AXES @ axes.T
    return PhotoCamera(background.image.name, lens, rotation, -rotation @ position)


def store_lens(data: bpy.types.Camera, lens: Lens) -> None:
    """Store `lens` with a camera."""
    data[LENS_PROPERTY] = json.dumps(asdict(lens))


def read_lens(data: bpy.types.Camera) -> Lens | None:
    """Return the lens stored with a camera, None if there is none. Raises SettingsError if the property is no lens."""
    stored = data.get(LENS_PROPERTY)
    if stored is None:
        return None
    try:
        values = json.loads(stored)
        width, height = (int(value) for value in values["size"])
        focal, center = (tuple(float(value) for value in values[name]) for name in ("focal", "center"))
        if len(focal) != 2 or len(center) != 2:
            raise ValueError(values)
        return Lens(str(values["model"]), (width, height), focal, center, tuple(float(value) for value in values["coefficients"]))
    except (TypeError, ValueError, KeyError, OverflowError, FarfieldError) as error:
        raise SettingsError(
            f'The custom property "{LENS_PROPERTY}" of the camera data "{data.name}" is damaged; remove it, or import the cameras again.'
        ) from error


def _read_axes(evaluated: bpy.types.Object) -> tuple[np.ndarray, np.ndarray]:
    """Return the unit axes of a camera in the columns of (3, 3), and its position (3,). Its scale does not matter, as in Blender. Raises
    SettingsError if an axis has no length, or the axes are not perpendicular."""
    matrix = np.array(evaluated.matrix_world, np.float64)
    lengths = np.linalg.norm(matrix[:3, :3], axis=0)
    if not np.isfinite(matrix).all() or not lengths.all():
        raise SettingsError(f'The camera "{evaluated.name}" has no scale, or a place that is not finite; clear its transform.')
    axes = matrix[:3, :3] / lengths
    if np.abs(axes.T @ axes - np.eye(3)).max() > MAX_SHEAR:
        raise SettingsError(f'The camera "{evaluated.name}" is sheared by its parent; give the parent the same scale along all axes.')
    return axes, matrix[:3, 3]


def _lens_of_background(
    name: str, data: bpy.types.Camera, background: bpy.types.CameraBackgroundImage, scene: bpy.types.Scene
) -> tuple[Lens, np.ndarray]:
    """Return the lens of a background image, and the rotation (3, 3) that takes camera space to the space of this lens: the image may be
    rotated in the frame, so that the camera seems to roll. Raises SettingsError if the image has no size in the view."""
    width, height = background.image.size
    image, angle = _place_background(background, *_read_frame(data, scene))
    if width < 1 or height < 1 or image.width <= 0.0 or image.height <= 0.0:
        raise SettingsError(f'The background image of the camera "{name}" has no pixels or no scale; check its file and its scale.')
    roll = np.array([[math.cos(angle), -math.sin(angle), 0.0], [math.sin(angle), math.cos(angle), 0.0], [0.0, 0.0, 1.0]])
    x, y = roll[:2, :2] @ image.center
    focal = (width / image.width, height / image.height)
    return Lens("PINHOLE", (width, height), focal, (0.5 * width - focal[0] * x, 0.5 * height + focal[1] * y)), roll


def _read_frame(data: bpy.types.Camera, scene: bpy.types.Scene) -> tuple[_Rectangle, float]:
    """Return what a perspective camera renders, and the side that its sensor spans."""
    render = scene.render
    aspect = render.resolution_x * render.pixel_aspect_x / (render.resolution_y * render.pixel_aspect_y)
    spans_width = aspect >= 1.0 if data.sensor_fit == "AUTO" else data.sensor_fit == "HORIZONTAL"
    side = (data.sensor_height if data.sensor_fit == "VERTICAL" else data.sensor_width) / data.lens
    width, height = (side, side / aspect) if spans_width else (side * aspect, side)
    return _Rectangle(width, height, side * np.array([data.shift_x, data.shift_y])), side


def _place_background(background: bpy.types.CameraBackgroundImage, frame: _Rectangle, side: float) -> tuple[_Rectangle, float]:
    """Return where a camera view shows a background image, before it is rotated around its center, and the angle clockwise in radians.

    Blender draws it in the plane where the sensor spans a length of 1, which is the unit of its offset; the factors of the offset keep the
    look of old files.
    """
    image = background.image
    aspect = image.size[0] * image.display_aspect[0] / max(image.size[1] * image.display_aspect[1], 1e-12)
    frame_aspect = frame.width / frame.height
    width, height = frame.width, frame.height
    if background.frame_method != "STRETCH":
        if (aspect > frame_aspect) == (background.frame_method == "FIT"):
            height = frame.width / max(aspect, 1e-12)
        else:
            width = frame.height * aspect
    x = background.offset[0] * min(1.0, frame_aspect)
    y = background.offset[1] / (max(1.0, frame_aspect) * max(aspect, 1e-12) / frame_aspect)
    center = frame.center + side * np.array([x, y])
    return _Rectangle(width * background.scale, height * background.scale, center), background.rotation
