"""Masks of photographs in files beside them."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from ...core.errors import FileError, ImageError
from ...core.photos.photographs import Photograph
from ..imaging.image_files import read_image_file

MIN_USABLE = 0.5  # of the gray level


def find_mask(folder: Path, name: str) -> Path | None:
    """Return the mask `NAME.jpg.png` or `NAME.png` of the photograph `name`, which may lie without its folders, None if there is none."""
    for path in (folder / name, folder / Path(name).name):
        for candidate in (path.with_name(f"{path.name}.png"), path.with_suffix(".png")):
            if candidate.is_file():
                return candidate
    return None


def check_mask_folder(folder: Path, names: list[str]) -> None:
    """Check that `folder` holds a mask of at least one of the photographs `names`. Raises FileError."""
    if not any(find_mask(folder, name) for name in names):
        raise FileError(
            f'There is no mask of a photograph in "{folder}"; name the masks like the photographs, "{Path(names[0]).stem}.png".'
        )


def apply_mask_file(photograph: Photograph, folder: Path) -> Photograph:
    """Return the photograph without the pixels that are darker than middle gray in its mask in `folder`; as it is if it has no mask there.

    Raises:
        FileError: the mask cannot be read.
        ImageError: it has another size than the photograph.
    """
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
