"""Cameras of Bundler (`bundle.out`) and VisualSFM (`.nvm`).

Neither file contains the sizes of the photographs, which are needed because both measure from the center of the image.
"""

from pathlib import Path

import numpy as np

from ...errors import FileError
from ...geometry.lenses import Lens, PhotoCamera
from .reading import FLIP, ReadSize, check_rotation, read_text_lines, rotation_of_quaternion

BUNDLER_HEADER, NVM_HEADER = "# Bundle file", "NVM_V3"
LIST_NAMES = ("list.txt", "list_images.txt")
BUNDLER_LINES = 5  # A camera has focal length, k1 and k2; three rows of the rotation; translation.
NVM_VALUES = 10  # focal length, quaternion, position, distortion and a zero


def read_bundler(path: Path, read_size: ReadSize) -> list[PhotoCamera]:
    """Read the registered cameras of a Bundler file; the names of the photographs are in `list.txt` next to it, their sizes come from
    `read_size`. Raises FileError if a file cannot be read."""
    lines = [line for line in read_text_lines(path) if line.strip()]
    names = _read_names(path)
    if not lines[0].startswith(BUNDLER_HEADER):
        raise ValueError("no header")
    count = int(lines[1].split()[0])
    if count != len(names):
        raise FileError(f'"{path}" has {count} cameras, but the list of images next to it has {len(names)}; export both again.')
    cameras = []
    for index, name in enumerate(names):
        first = 2 + BUNDLER_LINES * index
        rows = [[float(value) for value in line.split()] for line in lines[first : first + BUNDLER_LINES]]
        (focal, k1, k2), rotation, translation = rows[0], np.array(rows[1:4]), np.array(rows[4])
        if focal > 0.0:  # otherwise it is not registered
            check_rotation(rotation, translation)
            if np.linalg.det(rotation) < 0.0:
                raise ValueError("a mirrored camera")
            lens = _build_lens("RADIAL", read_size(name), focal, (k1, k2))
            cameras.append(PhotoCamera(name, lens, FLIP @ rotation, FLIP @ translation))
    return cameras


def read_nvm(path: Path, read_size: ReadSize) -> list[PhotoCamera]:
    """Read the cameras of the first model of an NVM file. Its distortion leads from measured to undistorted positions. The sizes of the
    photographs come from `read_size`. Raises FileError if the file cannot be read."""
    lines = [line for line in read_text_lines(path) if line.strip()]
    if not lines[0].startswith(NVM_HEADER) or "R9T" in lines[0]:
        raise ValueError("another version")
    count = int(lines[1])
    if count > len(lines) - 2:
        raise ValueError("fewer lines than cameras")
    cameras = []
    for line in lines[2 : 2 + count]:
        name, *rest = line.rsplit(maxsplit=NVM_VALUES)
        name = name.strip().replace('"', " ")  # Spaces in names are written as quotation marks.
        focal, *numbers = (float(value) for value in rest)
        rotation = rotation_of_quaternion(tuple(numbers[:4]), path)
        lens = _build_lens("INVERSE_RADIAL", read_size(name), focal, (numbers[7],))
        cameras.append(PhotoCamera(name, lens, rotation, -rotation @ np.array(numbers[4:7])))
    return cameras


def _build_lens(model: str, size: tuple[int, int], focal: float, coefficients: tuple[float, ...]) -> Lens:
    return Lens(model, tuple(size), (focal, focal), (0.5 * size[0], 0.5 * size[1]), coefficients)


def _read_names(path: Path) -> list[str]:
    found = next((path.with_name(name) for name in LIST_NAMES if path.with_name(name).is_file()), None)
    if found is None:
        raise FileError(f'There is no {LIST_NAMES[0]} next to "{path}", which names the photographs of Bundler; put it there.')
    return [_strip_focal(line) for line in read_text_lines(found) if line.strip()]


def _strip_focal(line: str) -> str:
    """Return the name in a line `name`, or `name 0 focal length`."""
    parts = line.strip().rsplit(maxsplit=2)
    return parts[0] if len(parts) == 3 and parts[1] == "0" else line.strip()
