"""Blender images with a hole, for the tests of the operator."""

import bpy
import numpy as np

HEIGHT, WIDTH = 24, 32
HOLE = (slice(8, 14), slice(10, 18))
FAST = {"split": "diffusion"}


def ramp(height=HEIGHT, width=WIDTH):
    """Opaque RGBA values (H, W, 4) of 8 bits whose colors rise from left to right and from bottom to top; they are their own diffusion."""
    rows, columns = np.mgrid[:height, :width].astype(np.float32)
    colors = np.stack([columns / width, rows / height, (columns + rows) / (width + height)], axis=2) * 0.6 + 0.2
    return np.dstack([np.round(colors * 255.0) / np.float32(255.0), np.ones((height, width), np.float32)])


def hole(height=HEIGHT, width=WIDTH):
    """A mask (H, W) bool with one hole."""
    mask = np.zeros((height, width), bool)
    mask[HOLE] = True
    return mask


def new_image(name, pixels, color_space="sRGB", is_float=False, alpha_mode="STRAIGHT"):
    """A generated image with the stored values (H, W, 4)."""
    height, width = pixels.shape[:2]
    image = bpy.data.images.new(name, width, height, alpha=True, float_buffer=is_float, is_data=color_space == "Non-Color")
    image.colorspace_settings.name = color_space
    image.alpha_mode = alpha_mode
    image.pixels.foreach_set(np.ascontiguousarray(pixels, np.float32).ravel())
    image.update()
    return image


def new_mask(name="mask", mask=None):
    """A mask image that is white in the hole."""
    mask = hole() if mask is None else mask
    return new_image(name, np.dstack([mask.astype(np.float32)] * 3 + [np.ones(mask.shape, np.float32)]), "Non-Color")


def read(image):
    """The stored values (H, W, C) of an image."""
    values = np.empty(image.size[0] * image.size[1] * image.channels, np.float32)
    image.pixels.foreach_get(values)
    return values.reshape(image.size[1], image.size[0], image.channels)


def restore(image, mask_image="mask", **settings):
    """Restore an image by name; returns the new image."""
    before = set(bpy.data.images)
    assert bpy.ops.farfield.restore_image(image=image, mask_image=mask_image, **(FAST | settings)) == {"FINISHED"}
    (created,) = set(bpy.data.images) - before
    return created
