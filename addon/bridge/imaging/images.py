"""Conversion between arrays and Blender images, UDIM images of several files, and checks for missing image files."""

import os
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

import bpy
import numpy as np

from ...core.errors import FileError
from ...core.files.complete_files import is_complete_png
from ...core.files.file_access import error_reason
from ...core.files.filenames import safe_filename
from ...core.files.height_maps import check_size
from ..blender import error_sentence
from ..geometry.meshes import Source
from ..shading.node_builder import nodes_in
from .image_files import check_openexr, read_image_size

INDEPENDENT_ALPHA = {"CHANNEL_PACKED", "NONE"}  # modes in which colors are not weighted by alpha
EXTENSIONS = {False: "png", True: "exr"}  # lossless, by whether the pixels are floats
FILE_FORMATS = {False: "PNG", True: "OPEN_EXR"}
BLENDER_CHANNELS = 4  # channels of an image in memory, whatever its file has; not for OpenEXR


def create_image(name: str, pixels: np.ndarray, is_data: bool, half_floats: bool = False) -> bpy.types.Image:
    """Create a packed image of `pixels` (H, W, 4), row 0 at the bottom, with 8 bits per channel or half floats.

    is_data: store the values unchanged; otherwise the colors are sRGB-encoded values. Alpha is straight and independent of the colors
    ("channel packed"), so that colors under zero alpha survive and Cycles and EEVEE read the same values.
    """
    height, width = pixels.shape[:2]
    image = bpy.data.images.new(name, width, height, alpha=True, float_buffer=half_floats, is_data=is_data)
    # Before the pixels: setting it afterwards would erase them.
    image.colorspace_settings.name = "Non-Color" if is_data else "sRGB"
    image.alpha_mode = "CHANNEL_PACKED"
    if half_floats:
        image.use_half_precision, image.file_format = True, "OPEN_EXR"
    image.pixels.foreach_set(np.ascontiguousarray(pixels, np.float32).ravel())
    image.update()
    image.pack()
    return image


def lossless_alpha_mode(alpha_mode: str, is_float: bool) -> str:
    """Return the alpha mode with which Blender loads exactly the values that it stored, for an image that is shown with `alpha_mode`."""
    if alpha_mode in INDEPENDENT_ALPHA:
        return alpha_mode
    return "PREMUL" if is_float else "STRAIGHT"


def read_pixels(image: bpy.types.Image) -> np.ndarray:
    """Return the pixels (H, W, 4) float32 of an image, or of its first tile, row 0 at the bottom. Gray becomes RGB, and missing alpha 1."""
    width, height = image.size
    channels = image.channels
    pixels = np.empty(width * height * channels, np.float32)
    image.pixels.foreach_get(pixels)
    pixels = pixels.reshape(height, width, channels)
    if channels == 4:
        return pixels
    colors = pixels[..., :3] if channels == 3 else pixels[..., :1].repeat(3, axis=2)
    alpha = pixels[..., 1:] if channels == 2 else np.ones((height, width, 1), np.float32)
    return np.concatenate([colors, alpha], axis=2)


def find_path(image: bpy.types.Image) -> str:
    """Return the absolute path of an image, relative to its library if it is linked; empty without a file."""
    return bpy.path.abspath(image.filepath, library=image.library)


def check_pixels(image: bpy.types.Image) -> None:
    """Raise FileError if an image has no pixels, for instance because its file is missing, or its packed file is damaged."""
    if not all(image.size) and image.packed_files:
        raise FileError(f'The packed image "{image.name}" is damaged and cannot be read; replace it, or remove it from the material.')
    if not all(image.size):
        raise FileError(
            f'The image "{image.name}" is missing or empty ("{find_path(image)}"); find its file, or remove it from the material.'
        )


def save_image(image: bpy.types.Image, path: Path) -> None:
    """Write an image to `path` in its file format.

    Raises:
        FileError: the file cannot be written.
    """
    try:
        image.filepath_raw = str(path)
        image.save()
        if image.file_format == "PNG" and not is_complete_png(path):  # Blender reports no failed write
            raise FileError(f'Cannot write "{path}": the image is truncated, because the disk or your quota is full; free some space.')
    except RuntimeError as error:  # raised by Blender
        reason = error_sentence(error)
        raise FileError(f'Cannot write "{path}": {reason}.') from error
    except OSError as error:
        raise FileError(f'Cannot write "{path}": {error_reason(error)}.') from error


def packed_bytes(image: bpy.types.Image) -> int:
    """Return the size of a packed image in the .blend file, in bytes."""
    return sum(packed.packed_file.size for packed in image.packed_files)


def check_images(source: Source) -> None:
    """Raise FileError when a material of `source` uses an image whose file is missing; the message names both."""
    for material, image in find_missing_images(source):
        path = find_path(image)
        raise FileError(
            f'The image "{image.name}" of the material "{material.name}" is missing: there is no file "{path}". '
            "Find it with File > External Data > Find Missing Files, or remove the image from the material."
        )


def find_images(materials: Iterable[bpy.types.Material]) -> list[bpy.types.Image]:
    """Return every image that `materials` use, once."""
    trees = [material.node_tree for material in materials if material.node_tree is not None]
    return list(dict.fromkeys(image for tree in trees for image in _images_in(tree)))


def find_missing_images(source: Source) -> list[tuple[bpy.types.Material, bpy.types.Image]]:
    """Return the materials of `source` and their images whose file is missing; packed and generated images need no file."""
    return [
        (material, image)
        for material in source.materials
        if material.node_tree is not None
        for image in _images_in(material.node_tree)
        if _is_missing(image)
    ]


def tile_paths(image: bpy.types.Image) -> list[str]:
    """Return the paths of the files of an image: one per UDIM tile, in their order, or a single one."""
    path = find_path(image)
    tiles = [tile.number for tile in image.tiles] if image.source == "TILED" else [0]
    return [path.replace("<UDIM>", str(tile)).replace("<UVTILE>", _uv_tile(tile)) for tile in tiles]


def _images_in(tree: bpy.types.NodeTree) -> Iterator[bpy.types.Image]:
    return (node.image for node in nodes_in(tree) if getattr(node, "image", None) is not None)


def _is_missing(image: bpy.types.Image) -> bool:
    if image.source not in {"FILE", "TILED"} or image.packed_files:
        return False
    return not all(os.path.isfile(path) for path in tile_paths(image))  # noqa: PTH113 - Path.is_file raises for forbidden folders and long names


def _uv_tile(udim: int) -> str:
    """Return the UVTILE name of a UDIM tile number: `u1_v1` for 1001."""
    column, row = (udim - 1001) % 10, (udim - 1001) // 10
    return f"u{column + 1}_v{row + 1}"


def load_image(path: Path) -> bpy.types.Image:
    """Return a new image that shows a file. Raises FileError."""
    try:
        return bpy.data.images.load(str(path))
    except RuntimeError as error:  # raised by Blender
        raise FileError(f'"{path}" cannot be loaded; check that the file is a complete image.') from error


def save_pixels(pixels: np.ndarray, path: Path, *, is_float: bool) -> None:
    """Write stored values (H, W, 4) to a PNG or, with `is_float`, an OpenEXR file, without loss. Raises FileError."""
    height, width = pixels.shape[:2]
    image = bpy.data.images.new("frame", width, height, alpha=True, float_buffer=is_float, is_data=True)
    try:
        # Blender writes the values of data as they are; those of colors pass through the color space and back.
        image.pixels.foreach_set(np.ascontiguousarray(pixels, np.float32).ravel())
        image.update()
        image.file_format = FILE_FORMATS[is_float]
        save_image(image, path)
    finally:
        bpy.data.images.remove(image)


def open_tiles(name: str, paths: Mapping[int, Path], color_space: str, alpha_mode: str) -> bpy.types.Image:
    """Return a new tiled image of files by the numbers of their tiles, which are part of their names. `pack_tiles` loads them."""
    first = min(paths)
    image = load_image(paths[first])
    image.name = name
    image.colorspace_settings.name = color_space
    image.alpha_mode = alpha_mode
    image.source = "TILED"
    image.filepath_raw = str(paths[first].with_name(paths[first].name.replace(str(first), "<UDIM>")))
    image.tiles[0].number = first
    present = {tile.number for tile in image.tiles}
    for number in sorted(set(paths) - present):
        image.tiles.new(number)
    return image


def pack_tiles(image: bpy.types.Image, extension: str) -> None:
    """Load the files of a tiled image and pack them."""
    image.reload()
    image.pack()
    image.filepath_raw = f"//{safe_filename(image.name)}.<UDIM>.{extension}"  # where Unpack writes to


def read_gray_image(path: Path) -> np.ndarray:
    """Return heights (H, W) float32, row 0 at the bottom: the mean of the first three channels as stored, without color management.

    Call it on Blender's main thread.

    Raises:
        FileError: Blender cannot read it.
    """
    _check_header(path)
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
    with np.errstate(all="ignore"):  # values that are not finite
        return pixels[..., 0].copy() if channels < 3 else pixels[..., :3].mean(axis=2)


def _check_header(path: Path) -> None:
    """Raise FileError if an image that can be read without Blender declares more pixels than fit into memory, or would end the process."""
    check_openexr(path)
    try:
        width, height = read_image_size(path)
    except FileError:
        return  # Blender may know the format.
    check_size(path, width * height * (1 if path.suffix.lower() == ".exr" else BLENDER_CHANNELS), 4)
