"""Images to restore and their masks: checks, and the pixels of single images, UDIM tiles and the frames of sequences."""

import re
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import bpy
import numpy as np

from ...core.errors import FarfieldError, FileError, ImageError
from ...core.files.file_access import check_readable, convert_os_errors, is_file
from ..blender import error_sentence
from ..imaging.color_spaces import find_scene_linear_space
from ..imaging.images import EXTENSIONS, FILE_FORMATS, find_path, load_image, lossless_alpha_mode, read_pixels, tile_paths

NUMBERED_FILE = re.compile(r"(.*?)(\d+)(\D*)$", re.DOTALL)  # the last number of a name, as Blender reads image sequences


def find_image(name: str, setting: str) -> bpy.types.Image:
    """Return the image with this name, which the setting with the label `setting` names; of a local and a linked one, the local one. Raises
    ImageError if there is none."""
    named = [image for image in bpy.data.images if image.name == name]
    if not named:
        raise ImageError(f'There is no image "{name}"; choose another one as {setting}.')
    return min(named, key=lambda image: image.library is not None)


def check_image(image: bpy.types.Image) -> None:
    """Raise ImageError or FileError, with one sentence, unless the pixels of `image` can be read."""
    if image.source == "MOVIE":
        raise ImageError(f'"{image.name}" is a movie; render it as an image sequence and restore that.')
    if image.source == "VIEWER":
        raise ImageError(f'"{image.name}" is a result of rendering; save it with Image > Save As and open the saved file.')
    if image.type == "MULTILAYER":
        raise ImageError(f'"{image.name}" is a multilayer file; save the layer as an image of its own and open that.')
    if image.is_multiview:
        raise ImageError(f'"{image.name}" has several views; open each view as an image of its own.')
    if image.source == "SEQUENCE":
        list_frames(image)
    elif 0 in image.size:
        path = find_path(image)
        if image.packed_files or not path:
            raise ImageError(f'"{image.name}" has no pixels; reload it or choose another image.')
        if "<" not in path:  # the path of a tiled image stands for several files
            check_readable(Path(path))
        raise FileError(f'"{image.name}" cannot be loaded from "{path}"; check that the file is a complete image.')


def tile_sizes(image: bpy.types.Image) -> dict[int, tuple[int, int]]:
    """Return the width and the height of every UDIM tile by number; an image without tiles has the number 0."""
    return {tile.number: tuple(tile.size) for tile in image.tiles} if image.source == "TILED" else {0: tuple(image.size)}


def find_obstacle(image: bpy.types.Image, other: bpy.types.Image) -> str:
    """Return why `other` cannot be restored together with `image`, in a few words; an empty string if it can."""
    if other.source in {"MOVIE", "SEQUENCE"}:
        return "movie" if other.source == "MOVIE" else "image sequence"
    if other.library is not None:
        return "linked"
    try:
        check_image(other)
    except FarfieldError:
        return "cannot be read"
    sizes, other_sizes = tile_sizes(image), tile_sizes(other)
    if sizes.keys() != other_sizes.keys():
        return "other tiles"
    return "" if sizes == other_sizes else "other size"


def list_frames(image: bpy.types.Image) -> dict[int, Path]:
    """Return the files of an image sequence by frame number, in order. Raises FileError if there are none, or the folder cannot be read."""
    path = Path(find_path(image))
    match = NUMBERED_FILE.match(path.name)
    if match is None:
        raise FileError(f'The file "{path}" of the sequence "{image.name}" has no number in its name; rename the frames.')
    head, _, tail = match.groups()
    pattern = re.compile(f"{re.escape(head)}(\\d+){re.escape(tail)}")
    with convert_os_errors(f'Cannot read the frames of "{image.name}" in "{path.parent}"'):
        found = {int(number[1]): file for file in path.parent.iterdir() if (number := pattern.fullmatch(file.name))}
    if not found:
        raise FileError(f'The sequence "{image.name}" has no files like "{path}"; check its path.')
    return dict(sorted(found.items()))


@contextmanager
def load_frame(image: bpy.types.Image, path: Path) -> Iterator[bpy.types.Image]:
    """Yield a temporary image of one file of a sequence or a tiled image, with its color space and alpha mode. Raises FileError if the file
    is not a complete image."""
    check_readable(path)
    frame = load_image(path)
    try:
        frame.colorspace_settings.name = image.colorspace_settings.name
        frame.alpha_mode = image.alpha_mode
        if 0 in frame.size:
            raise FileError(f'"{path}" cannot be loaded; check that the file is a complete image.')
        yield frame
    finally:
        bpy.data.images.remove(frame)


def read_tiles(image: bpy.types.Image) -> dict[int, np.ndarray]:
    """Return the stored values (H, W, 4) of every UDIM tile by number; those of an image without tiles have the number 0.

    `Image.pixels` holds the first tile only. The others are read from their files; if the tiles are packed, generated or have unsaved
    strokes, Blender saves them to temporary files without loss.

    Raises:
        FileError: a tile cannot be loaded or saved.
    """
    if image.source != "TILED":
        return {0: read_pixels(image)}
    numbers = [tile.number for tile in image.tiles]
    files = {number: Path(path) for number, path in zip(numbers, tile_paths(image), strict=True)}
    if not image.is_dirty and not image.packed_files and all(is_file(path) for path in files.values()):
        return {number: _read_file(image, path) for number, path in files.items()}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, f"tile.<UDIM>.{EXTENSIONS[image.is_float]}")
        _save_tiles(image, path)
        return {number: _read_tile(image, path.with_name(path.name.replace("<UDIM>", str(number))), number) for number in numbers}


def _save_tiles(image: bpy.types.Image, path: Path) -> None:
    """Save all tiles in the lossless format of `path`. Raises FileError."""
    # Unsaved strokes are not part of a copy; without them the copy is what gets another file format for a moment.
    saved = image if image.is_dirty and image.library is None else image.copy()
    file_format = saved.file_format
    try:
        saved.file_format = FILE_FORMATS[image.is_float]
        saved.save(filepath=str(path), save_copy=True)
    except RuntimeError as error:  # raised by Blender
        reason = error_sentence(error)
        raise FileError(f'The tiles of "{image.name}" cannot be read: {reason}; check that all their files exist.') from error
    finally:
        if saved is image:
            saved.file_format = file_format
        else:
            bpy.data.images.remove(saved)


def _read_tile(image: bpy.types.Image, path: Path, number: int) -> np.ndarray:
    if not path.exists():
        raise FileError(f'Tile {number} of "{image.name}" cannot be loaded; check that its file exists.')
    tile = load_image(path)
    try:
        tile.colorspace_settings.name = default_color_space(image)
        tile.alpha_mode = lossless_alpha_mode(image.alpha_mode, image.is_float)
        return read_pixels(tile)
    finally:
        bpy.data.images.remove(tile)


def _read_file(image: bpy.types.Image, path: Path) -> np.ndarray:
    with load_frame(image, path) as tile:
        return read_pixels(tile)


def default_color_space(image: bpy.types.Image) -> str:
    """Return the color space in which files hold the stored values of `image`: scene-linear for colors as floats, otherwise its own."""
    if not image.is_float or image.colorspace_settings.is_data:
        return image.colorspace_settings.name
    return find_scene_linear_space()
