"""Colors of images in the color space in which Blender renders, scene-linear."""

import bpy
import numpy as np

from ...compat import set_file_format
from ...core.files.temporary_folders import temporary_folder
from ...core.imaging.colors import decode_signed_srgb
from .images import load_image, read_pixels

SRGB = "sRGB"  # Blender's name of the color space that most images have


def find_scene_linear_space() -> str:
    """Return the name of the scene-linear color space, "Linear Rec.709" unless the user chose another one."""
    image = bpy.data.images.new("linear", 1, 1, float_buffer=True)
    try:
        return image.colorspace_settings.name
    finally:
        bpy.data.images.remove(image)


def read_linear_pixels(image: bpy.types.Image) -> np.ndarray:
    """Return the pixels (H, W, 4) float32 of an image, or of its first tile, row 0 at the bottom, with the colors that renders see.

    Values of data images stay as they are, alpha is that of `read_pixels`.
    """
    pixels, space = read_pixels(image), image.colorspace_settings
    if image.is_float or space.is_data:  # Blender converts the pixels of float images when it reads them
        return pixels
    return np.concatenate([convert_to_linear(pixels[..., :3], space.name), pixels[..., 3:]], axis=2)


def convert_to_linear(colors: np.ndarray, space: str) -> np.ndarray:
    """Return the scene-linear colors (H, W, 3) float32 of the values `colors` (H, W, 3) of an image with 8 bits in a color space."""
    if space == find_scene_linear_space():  # tested first: files of such images would not be converted correctly
        return colors.astype(np.float32)
    return (decode_signed_srgb(colors) if space == SRGB else _convert_by_file(colors, space)).astype(np.float32)


def _convert_by_file(colors: np.ndarray, space: str) -> np.ndarray:
    """Return scene-linear colors (H, W, 3): Blender converts none for Python, but those that it saves as OpenEXR are scene-linear."""
    height, width = colors.shape[:2]
    scene = bpy.data.scenes.new("Color Conversion")
    image = bpy.data.images.new("Color Conversion", width, height, alpha=False)
    try:
        scene.view_settings.view_transform = "Raw"
        set_file_format(scene.render.image_settings, "OPEN_EXR")
        scene.render.image_settings.color_depth = "32"
        image.colorspace_settings.name = space  # before the pixels: setting it afterwards would erase them
        image.pixels.foreach_set(np.dstack([colors, np.ones((height, width), np.float32)]).astype(np.float32).ravel())
        with temporary_folder() as folder:
            path = folder / "linear.exr"
            image.save_render(str(path), scene=scene)
            converted = load_image(path)
            try:
                return read_pixels(converted)[..., :3]
            finally:
                bpy.data.images.remove(converted)
    finally:
        bpy.data.images.remove(image)
        bpy.data.scenes.remove(scene)
