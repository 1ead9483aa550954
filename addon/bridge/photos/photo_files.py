"""Photographs and their masks read from files.

Pixels are as stored, because programs that align photographs ignore the orientation in the EXIF data. Where the size of a camera or a mask
says that its program has applied it, by an exchange of width and height, it is applied here, too.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path, PurePosixPath

import numpy as np

from ...core.errors import FileError, ImageError
from ...core.geometry.lenses import PhotoCamera
from ...core.imaging.orientation import SWAPPED, from_upright, to_upright
from ...core.photos.photographs.photograph import Photograph
from ..imaging.image_files import read_image_file, read_image_size
from .photo_folders import PhotoFolder

MIN_USABLE = 0.5  # gray level of a mask from which a pixel is usable


def read_photograph(camera: PhotoCamera, folder: PhotoFolder, masks: PhotoFolder | None = None) -> Photograph:
    """Read the photograph of `camera` and its mask, if `masks` has one. 8-bit pixels stay as they are.

    Raises:
        FileError: there is no such photograph, or a file cannot be read.
        ImageError: it is gray with alpha, its size is not that of the camera, or its mask has another size.
    """
    photograph, turn = _read(camera, folder.find_photograph(camera.name))
    mask = None if masks is None else masks.find_mask(camera.name)
    return photograph if mask is None else _apply_mask(photograph, mask, turn)


def read_photograph_file(camera: PhotoCamera, path: Path) -> Photograph:
    """Read the photograph of `camera` from a file; see `read_photograph`."""
    return _read(camera, path)[0]


def _read(camera: PhotoCamera, path: Path) -> tuple[Photograph, Callable[[np.ndarray], np.ndarray] | None]:
    """Return a photograph and what turns a mask with exchanged width and height to it, None if nothing does."""
    image = read_image_file(path)
    orientation = image.spec.get_int_attribute("Orientation", 1)
    is_8_bit = image.stored.dtype == np.uint8 and not image.storage.has_alpha
    pixels, mask = image.stored[::-1] if is_8_bit else image.pixels, None
    turn = partial(from_upright, orientation=orientation) if orientation in SWAPPED else None
    if turn is not None and camera.lens.size == pixels.shape[:2] != pixels.shape[1::-1]:
        turn = partial(to_upright, orientation=orientation)
        pixels = turn(pixels)
    if image.storage.has_alpha:
        mask = pixels[..., -1] >= 0.5
        pixels = pixels[..., :-1]
    if pixels.shape[2] == 1:
        pixels = pixels.repeat(3, axis=2)
    if pixels.shape[2] != 3:
        raise ImageError(f'"{path}" has {pixels.shape[2]} color channels; save it with one or three.')
    photograph = Photograph(camera, np.ascontiguousarray(pixels), mask)
    photograph.check()
    return photograph, turn


def size_reader(folder: PhotoFolder) -> Callable[[str], tuple[int, int]]:
    """Return a function from the name of a photograph in `folder` to its width and height, for cameras whose file does not contain them."""
    return lambda name: read_image_size(folder.find_photograph(name))


def check_mask_folder(folder: PhotoFolder, names: list[str]) -> list[str]:
    """Return those of the photographs `names` that have no mask in `folder`. Raises FileError if none has one."""
    missing = [name for name in names if folder.find_mask(name) is None]
    if len(missing) == len(names):
        raise FileError(
            f'There is no mask of a photograph in "{folder.folder}"; name the masks like the photographs, '
            f'"{PurePosixPath(names[0]).stem}.png".'
        )
    return missing


def _apply_mask(photograph: Photograph, path: Path, turn: Callable[[np.ndarray], np.ndarray] | None) -> Photograph:
    """Return the photograph without the pixels that are darker than middle gray in the mask `path`."""
    image = read_image_file(path, is_color=False)
    colors = image.pixels[..., :-1] if image.storage.has_alpha else image.pixels
    usable = colors.mean(axis=2) >= MIN_USABLE
    height, width = photograph.pixels.shape[:2]
    if turn is not None and usable.shape == (width, height) != (height, width):
        usable = turn(usable)
    if usable.shape != (height, width):
        raise ImageError(
            f'The mask "{path}" has {usable.shape[1]} x {usable.shape[0]} pixels, but its photograph {width} x {height}; '
            "save it in that size."
        )
    return replace(photograph, mask=np.ascontiguousarray(usable if photograph.mask is None else usable & photograph.mask))
