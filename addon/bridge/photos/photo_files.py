"""Photographs and their masks read from files."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from ...core.errors import FileError, ImageError
from ...core.geometry.lenses import PhotoCamera
from ...core.photos.photographs.photograph import Photograph
from ..imaging.image_files import EXTENSIONS, read_image_file, read_image_size

MIN_USABLE = 0.5  # gray level of a mask from which a pixel is usable


def read_photograph(camera: PhotoCamera, folder: Path) -> Photograph:
    """Read the photograph of `camera` in `folder`, where its name may have another extension. 8-bit pixels stay as they are. Raises
    FileError if there is no such file, or it cannot be read, and ImageError if it is gray with alpha, or its size is not that of the
    camera."""
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
    """Return the path of the photograph `name` in `folder`, where it may lie without its folders or have another extension. Raises
    FileError if there is no such file."""
    found = _find_file(folder, name, lambda path: [path, *(path.with_suffix(extension) for extension in EXTENSIONS)])
    if found is None:
        raise FileError(
            f'There is no photograph "{name}" in "{folder}"; name the folder with the images that the cameras were computed from.'
        )
    return found


def _find_file(folder: Path, name: str, find_candidates: Callable[[Path], list[Path]]) -> Path | None:
    """Return the first candidate for the path of `name` in `folder`, with or without its folders, that is a file."""
    paths = (folder / name, folder / Path(name).name)
    return next((candidate for path in paths for candidate in find_candidates(path) if candidate.is_file()), None)


def find_mask(folder: Path, name: str) -> Path | None:
    """Return the mask `NAME.jpg.png` or `NAME.png` of the photograph `name`, which may lie without its folders, None if there is none."""
    return _find_file(folder, name, lambda path: [path.with_name(f"{path.name}.png"), path.with_suffix(".png")])


def check_mask_folder(folder: Path, names: list[str]) -> None:
    """Check that `folder` holds a mask of at least one of the photographs `names`. Raises FileError."""
    if not any(find_mask(folder, name) for name in names):
        raise FileError(
            f'There is no mask of a photograph in "{folder}"; name the masks like the photographs, "{Path(names[0]).stem}.png".'
        )


def apply_mask_file(photograph: Photograph, folder: Path) -> Photograph:
    """Return the photograph without the pixels that are darker than middle gray in its mask in `folder`; as it is if it has no mask there.
    Raises FileError if the mask cannot be read, and ImageError if it has another size than the photograph."""
    path = find_mask(folder, photograph.camera.name)
    if path is None:
        return photograph
    image = read_image_file(path, is_color=False)
    colors = image.pixels[..., :-1] if image.storage.has_alpha else image.pixels
    usable = colors.mean(axis=2) >= MIN_USABLE
    height, width = photograph.pixels.shape[:2]
    if usable.shape != (height, width):
        raise ImageError(
            f'The mask "{path}" has {usable.shape[1]} x {usable.shape[0]} pixels, but its photograph {width} x {height}; '
            "save it in that size."
        )
    return replace(photograph, mask=np.ascontiguousarray(usable if photograph.mask is None else usable & photograph.mask))
