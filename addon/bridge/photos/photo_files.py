"""Photographs read from files."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from ...core.errors import FileError, ImageError
from ...core.geometry.lenses import PhotoCamera
from ...core.photos.photographs import Photograph
from ..imaging.image_files import EXTENSIONS, read_image_file, read_image_size


def read_photograph(camera: PhotoCamera, folder: Path) -> Photograph:
    """Read the photograph of `camera` in `folder`, where its name may have another extension. 8-bit pixels stay as they are.

    Raises:
        FileError: there is no such file, or it cannot be read.
        ImageError: it is gray with alpha, or its size is not that of the camera.
    """
    return read_photograph_file(camera, find_photograph(folder, camera.name))


def read_photograph_file(camera: PhotoCamera, path: Path) -> Photograph:
    """Read the photograph of `camera` from a file; see `read_photograph`."""
    image = read_image_file(path)
    is_8_bit = image.stored.dtype == np.uint8 and not image.storage.has_alpha
    pixels, mask = image.stored[::-1] if is_8_bit else image.pixels, None
    if image.storage.has_alpha:
        mask = image.pixels[..., -1] >= 0.5
        pixels = pixels[..., :-1]
    if pixels.shape[2] == 1:
        pixels = pixels.repeat(3, axis=2)
    if pixels.shape[2] != 3:
        raise ImageError(f'"{path}" has {pixels.shape[2]} color channels; save it with one or three.')
    photograph = Photograph(camera, np.ascontiguousarray(pixels), mask)
    photograph.check()
    return photograph


def size_reader(folder: Path) -> Callable[[str], tuple[int, int]]:
    """Return a function from the name of a photograph in `folder` to its width and height, for cameras whose file does not contain them."""
    return lambda name: read_image_size(find_photograph(folder, name))


def find_photograph(folder: Path, name: str) -> Path:
    """Return the path of the photograph `name` in `folder`, where it may lie without its folders or have another extension.

    Raises:
        FileError: there is no such file.
    """
    for path in (folder / name, folder / Path(name).name):
        for candidate in (path, *(path.with_suffix(extension) for extension in EXTENSIONS)):
            if candidate.is_file():
                return candidate
    raise FileError(f'There is no photograph "{name}" in "{folder}"; name the folder with the images that the cameras were computed from.')
