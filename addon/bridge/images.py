"""Between arrays and Blender images, and whether the images of materials are there."""

from collections.abc import Iterator
from pathlib import Path

import bpy
import numpy as np

from ..core.errors import FileError
from .meshes import Source
from .node_groups import nodes_in


def data_image(name: str, pixels: np.ndarray, is_data: bool, half_floats: bool = False) -> bpy.types.Image:
    """A packed image of `pixels` (H, W, 4), row 0 at the bottom, of 8 bits a channel or of half floats.

    is_data: the numbers are kept as they are; else the colours are sRGB-encoded values. Alpha is straight and kept beside the colours
    ("channel packed"), so that colours under no alpha survive and Cycles and EEVEE read the same.
    """
    height, width = pixels.shape[:2]
    image = bpy.data.images.new(name, width, height, alpha=True, float_buffer=half_floats, is_data=is_data)
    # Before the pixels: setting it afterwards would wipe them.
    image.colorspace_settings.name = "Non-Color" if is_data else "sRGB"
    image.alpha_mode = "CHANNEL_PACKED"
    if half_floats:
        image.use_half_precision, image.file_format = True, "OPEN_EXR"
    image.pixels.foreach_set(np.ascontiguousarray(pixels, np.float32).ravel())
    image.update()
    image.pack()
    return image


def pixels_of(image: bpy.types.Image) -> np.ndarray:
    """The pixels (H, W, 4) float32 of an image, row 0 at the bottom."""
    width, height = image.size
    pixels = np.empty(width * height * 4, np.float32)
    image.pixels.foreach_get(pixels)
    return pixels.reshape(height, width, 4)


def packed_bytes(image: bpy.types.Image) -> int:
    """Bytes that a packed image takes in the .blend."""
    return sum(packed.packed_file.size for packed in image.packed_files)


def check_images(source: Source) -> None:
    """Raise FileError when a material of `source` needs an image whose file is missing; the sentence names both."""
    for material, image in missing_images(source):
        path = bpy.path.abspath(image.filepath, library=image.library)
        raise FileError(
            f'The image "{image.name}" of the material "{material.name}" is missing: there is no file "{path}". '
            "Find it with File > External Data > Find Missing Files, or take the image out of the material."
        )


def images_of(source: Source) -> list[bpy.types.Image]:
    """Every image that the materials of `source` use, once."""
    trees = [material.node_tree for material in source.materials if material.node_tree is not None]
    return list(dict.fromkeys(image for tree in trees for image in _images(tree)))


def missing_images(source: Source) -> list[tuple[bpy.types.Material, bpy.types.Image]]:
    """Materials of `source` and images they use whose file is not there; packed and generated images need none."""
    return [
        (material, image)
        for material in source.materials
        if material.node_tree is not None
        for image in _images(material.node_tree)
        if _is_missing(image)
    ]


def _images(tree: bpy.types.NodeTree) -> Iterator[bpy.types.Image]:
    return (node.image for node in nodes_in(tree) if getattr(node, "image", None) is not None)


def _is_missing(image: bpy.types.Image) -> bool:
    if image.source not in {"FILE", "TILED"} or image.packed_files:
        return False
    path = bpy.path.abspath(image.filepath, library=image.library)
    tiles = [tile.number for tile in image.tiles] if image.source == "TILED" else [0]
    return any(not Path(path.replace("<UDIM>", str(tile)).replace("<UVTILE>", _uv_tile(tile))).is_file() for tile in tiles)


def _uv_tile(number: int) -> str:
    column, row = (number - 1001) % 10, (number - 1001) // 10
    return f"u{column + 1}_v{row + 1}"
