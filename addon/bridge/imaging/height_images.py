"""Images as heights: gray values as stored, read by Blender."""

from pathlib import Path

import bpy
import numpy as np

from ...core.errors import FileError
from ...core.files.height_maps import check_size


def read_gray_image(path: Path) -> np.ndarray:
    """Return the mean of the first three channels as stored, (H, W) float32, row 0 at the bottom, without color management.

    Call it on Blender's main thread.

    Raises:
        FileError: Blender cannot read it.
    """
    try:
        image = bpy.data.images.load(str(path))
    except RuntimeError as error:
        raise FileError(f'"{path}" cannot be read: {str(error).strip().rstrip(".")}.') from error
    try:
        image.colorspace_settings.name = "Non-Color"
        image.alpha_mode = "CHANNEL_PACKED"  # other modes lose colors under zero alpha
        (width, height), channels = image.size, image.channels
        if width * height * channels == 0:
            raise FileError(f'"{path}" cannot be read as an image; Blender finds no pixels in it.')
        check_size(path, width * height * channels, 4)
        pixels = np.empty(width * height * channels, np.float32)
        image.pixels.foreach_get(pixels)
    finally:
        bpy.data.images.remove(image)
    pixels = pixels.reshape(height, width, channels)
    return pixels[..., 0].copy() if channels < 3 else pixels[..., :3].mean(axis=2)
