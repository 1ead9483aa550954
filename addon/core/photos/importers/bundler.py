"""Cameras of Bundler (`bundle.out`) and VisualSFM (`.nvm`).

Neither file contains the sizes of the photographs, which are needed because both measure from the center of the image.
"""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from ...errors import FileError
from ...geometry.lenses import Lens, PhotoCamera
from .rotations import is_rotation, rotation_of_quaternion
from .text_files import read_text_lines

BUNDLER_EXTENSION, NVM_EXTENSION = ".out", ".nvm"
BUNDLER_HEADER, NVM_HEADER = "# Bundle file", "NVM_V3"
LIST_NAMES = ("list.txt", "list_images.txt")
BUNDLER_LINES = 5  # of a camera: focal length and k1, k2; three rows of the rotation; translation
NVM_VALUES = 10  # focal length, quaternion, position, distortion and a zero
FLIP = np.diag([1.0, -1.0, -1.0])  # from camera space with y up and looking along -z

ReadSize = Callable[[str], tuple[int, int]]


def read_bundler(path: Path, read_size: ReadSize) -> list[PhotoCamera]:
    """Read the registered cameras of a Bundler file; the names of the photographs are in `list.txt` next to it.

    read_size: returns width and height of a photograph.

    Raises:
        FileError: a file cannot be read or is damaged, or there is no registered camera.
    """
    lines = [line for line in read_text_lines(path) if line.strip()]
    names = _read_names(path)
    try:
        if not lines[0].startswith(BUNDLER_HEADER):
            raise ValueError("no header")
        count = int(lines[1].split()[0])
        if count != len(names):
            raise FileError(f'"{path}" has {count} cameras, but the list of images next to it has {len(names)}; export both again.')
        poses = []
        for index, name in enumerate(names):
            first = 2 + BUNDLER_LINES * index
            rows = [[float(value) for value in line.split()] for line in lines[first : first + BUNDLER_LINES]]
            (focal, k1, k2), rotation, translation = rows[0], np.array(rows[1:4]), np.array(rows[4])
            if focal > 0.0:  # otherwise it is not registered
                if not is_rotation(rotation) or np.linalg.det(rotation) < 0.0:
                    raise ValueError("no rotation")
                poses.append((name, focal, (k1, k2), FLIP @ rotation, FLIP @ translation))
    except (ValueError, IndexError, OverflowError) as error:
        raise FileError(f'The cameras in "{path}" are damaged or truncated; export them again.') from error
    return _build_cameras(path, "RADIAL", poses, read_size)


def read_nvm(path: Path, read_size: ReadSize) -> list[PhotoCamera]:
    """Read the cameras of the first model of an NVM file. Its distortion leads from measured to undistorted positions.

    read_size: returns width and height of a photograph.

    Raises:
        FileError: the file cannot be read or is damaged, or there is no registered camera.
    """
    lines = [line for line in read_text_lines(path) if line.strip()]
    poses = []
    try:
        if not lines[0].startswith(NVM_HEADER) or "R9T" in lines[0]:
            raise ValueError("another version")
        count = int(lines[1])
        if count > len(lines) - 2:
            raise ValueError("fewer lines than cameras")
        for line in lines[2 : 2 + count]:
            name, *rest = line.rsplit(maxsplit=NVM_VALUES)
            focal, *numbers = (float(value) for value in rest)
            rotation = rotation_of_quaternion(tuple(numbers[:4]), path)
            # Spaces in names are written as quotation marks.
            poses.append((name.strip().replace('"', " "), focal, (numbers[7],), rotation, -rotation @ np.array(numbers[4:7])))
    except (ValueError, IndexError, OverflowError) as error:
        raise FileError(f'The cameras in "{path}" are damaged or truncated; export them again.') from error
    return _build_cameras(path, "INVERSE_RADIAL", poses, read_size)


def _build_cameras(path: Path, model: str, poses: list[tuple], read_size: ReadSize) -> list[PhotoCamera]:
    if not poses:
        raise FileError(f'There is no registered camera in "{path}"; align the photographs first.')
    cameras = []
    for name, focal, coefficients, rotation, translation in poses:
        width, height = read_size(name)
        lens = Lens(model, (width, height), (focal, focal), (0.5 * width, 0.5 * height), coefficients)
        cameras.append(PhotoCamera(name, lens, rotation, translation))
    return cameras


def _read_names(path: Path) -> list[str]:
    found = next((path.with_name(name) for name in LIST_NAMES if path.with_name(name).is_file()), None)
    if found is None:
        raise FileError(f'There is no {LIST_NAMES[0]} next to "{path}", which names the photographs of Bundler; put it there.')
    return [_strip_focal(line) for line in read_text_lines(found) if line.strip()]


def _strip_focal(line: str) -> str:
    """Return the name in a line `name`, or `name 0 focal length`."""
    parts = line.strip().rsplit(maxsplit=2)
    return parts[0] if len(parts) == 3 and parts[1] == "0" else line.strip()
