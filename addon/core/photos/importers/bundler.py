"""Cameras of Bundler (`bundle.out`) and VisualSFM (`.nvm`).

Neither file contains the sizes of the photographs, which are needed because both measure from the center of the image.
"""

import re
from pathlib import Path

import numpy as np

from ...errors import FileError
from ...geometry.lenses import Lens, PhotoCamera
from .camera_notes import CameraNotes
from .reading import FLIP, ReadSize, check_rotation, read_text_lines, rotation_of_quaternion

BUNDLER_VERSION = re.compile(r"#\s*Bundle file v(\S+)")
KNOWN_VERSION = "0.3"
MVE_HEADER = "drews"
NVM_HEADER, FIXED_LENS = "NVM_V3", "FixedK"
LIST_NAMES = ("list.txt", "list_images.txt")  # in the folder of the file or the one above, as Bundler has them
LIST_EXTENSIONS = (".list.txt", "_list.txt", ".lst", ".txt")  # in place of that of the file: those of COLMAP, RealityCapture and others
BUNDLER_LINES = 5  # A camera has focal length, k1 and k2; three rows of the rotation; translation.
NVM_VALUES = 10  # focal length, quaternion, position, distortion and a zero


def read_bundler(path: Path, read_size: ReadSize, _notes: CameraNotes) -> list[PhotoCamera]:
    """Read the registered cameras of a Bundler file; the names of the photographs are in a list next to it, their sizes come from
    `read_size`. Raises FileError if a file cannot be read, or has another version."""
    lines = [line.strip() for line in read_text_lines(path) if line.strip()]
    _check_bundler_version(lines[0], path)
    lines = [line for line in lines if not line.startswith("#")]
    count = int(lines[0].split()[0])
    names = _read_names(path)
    if count != len(names):
        raise FileError(f'"{path}" has {count} cameras, but the list of images next to it has {len(names)}; export both again.')
    cameras = []
    for index, name in enumerate(names):
        first = 1 + BUNDLER_LINES * index
        rows = [[float(value) for value in line.split()] for line in lines[first : first + BUNDLER_LINES]]
        (focal, k1, k2), rotation, translation = rows[0], np.array(rows[1:4]), np.array(rows[4])
        if focal > 0.0:  # otherwise it is not registered
            check_rotation(rotation, translation)
            if np.linalg.det(rotation) < 0.0:
                raise ValueError("a mirrored camera")
            lens = _build_lens("RADIAL", read_size(name), focal, (k1, k2))
            cameras.append(PhotoCamera(name, lens, FLIP @ rotation, FLIP @ translation))
    return cameras


def _check_bundler_version(line: str, path: Path) -> None:
    """Raise FileError if the first line of a file says that it has another version than the known one."""
    found = BUNDLER_VERSION.match(line)
    if found and found[1] != KNOWN_VERSION:
        raise FileError(f'"{path}" has version {found[1]} of the format of Bundler, and Farfield reads {KNOWN_VERSION}; export it as that.')
    if line.startswith(MVE_HEADER):
        raise FileError(f'"{path}" is a file of MVE and not of Bundler; export the cameras in another format.')


def read_nvm(path: Path, read_size: ReadSize, _notes: CameraNotes) -> list[PhotoCamera]:
    """Read the cameras of the first model of an NVM file. Its distortion leads from measured to undistorted positions. The sizes of the
    photographs come from `read_size`. Raises FileError if the file cannot be read, or has another version."""
    lines = [line for line in read_text_lines(path) if line.strip()]
    header = lines[0].split()
    if header[0] != NVM_HEADER:
        raise FileError(f'"{path}" begins with "{header[0]:.20}" instead of {NVM_HEADER}; save it with VisualSFM as .nvm.')
    fixed = [float(value) for value in header[2:7]] if header[1:2] == [FIXED_LENS] else None  # fx, cx, fy, cy and distortion
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
        if fixed is not None:
            fx, cx, fy, cy = fixed[:4]
            lens = Lens(lens.model, lens.size, (fx, fy), (cx, cy), (numbers[7] or (fixed[4] if len(fixed) > 4 else 0.0),))
        cameras.append(PhotoCamera(name, lens, rotation, -rotation @ np.array(numbers[4:7])))
    return cameras


def _build_lens(model: str, size: tuple[int, int], focal: float, coefficients: tuple[float, ...]) -> Lens:
    return Lens(model, tuple(size), (focal, focal), (0.5 * size[0], 0.5 * size[1]), coefficients)


def _read_names(path: Path) -> list[str]:
    """Return the names in the list of photographs of a Bundler file. Raises FileError if there is no list."""
    stem = path.name.removesuffix(path.suffix).removesuffix(".bundle")
    candidates = [path.with_name(stem + extension) for extension in LIST_EXTENSIONS]
    candidates += [folder / name for folder in (path.parent, path.parent.parent) for name in LIST_NAMES]
    found = next((candidate for candidate in candidates if candidate.is_file()), None)
    others = sorted(path.parent.glob("*.lst"))  # RealityCapture
    if found is None and len(others) == 1:
        found = others[0]
    if found is None:
        raise FileError(f'There is no {LIST_NAMES[0]} next to "{path}", which names the photographs of Bundler; put it there.')
    return [_strip_focal(line) for line in read_text_lines(found) if line.strip()]


def _strip_focal(line: str) -> str:
    """Return the name in a line `name`, or `name 0 focal length`."""
    parts = line.strip().rsplit(maxsplit=2)
    return parts[0] if len(parts) == 3 and parts[1] == "0" else line.strip()
