"""Cameras from pairs of points in a text file `.pairs`: each line has the place of a point in world space, its position in pixels from the
upper left corner of a photograph, and the name of the photograph. Lines that begin with # are comments.
"""

from pathlib import Path

import numpy as np

from ...errors import FileError
from ...geometry.lenses import PhotoCamera
from ..registration.registration import register
from .camera_notes import CameraNotes
from .reading import ReadSize, read_text_lines

NUMBERS = 5  # x, y, z, column and row


def read_pairs(path: Path, read_size: ReadSize, _notes: CameraNotes) -> list[PhotoCamera]:
    """Register all photographs in a file, in the order in which they appear.

    read_size: returns width and height of a photograph.

    Raises:
        FileError: the file cannot be read, a line is damaged, or a pair does not fit to the others.
        GeometryError: a photograph cannot be registered, see `register`.
    """
    cameras = []
    for name, (lines, values) in _read_groups(path).items():
        numbers, size = np.array(values), read_size(name)
        positions = np.stack([numbers[:, 3], size[1] - numbers[:, 4]], axis=1)
        registration = register(name, numbers[:, :3], positions, size)
        if registration.is_wrong.any():
            index = int(np.flatnonzero(registration.is_wrong)[0])
            distance = float(np.linalg.norm(registration.residuals[index]))
            raise FileError(
                f'Line {lines[index]} of "{path}" does not fit to the other pairs of "{name}": {distance:.0f} pixels away; '
                "correct or remove it."
            )
        cameras.append(registration.camera)
    if not cameras:
        raise FileError(f'There is no pair of points in "{path}"; write lines with x, y, z, column, row and the name of the photograph.')
    return cameras


def _read_groups(path: Path) -> dict[str, tuple[list[int], list[list[float]]]]:
    """Return the line numbers and the numbers of the pairs of each photograph."""
    groups: dict[str, tuple[list[int], list[list[float]]]] = {}
    for number, line in enumerate(read_text_lines(path), start=1):
        parts = line.split(maxsplit=NUMBERS)
        if not parts or parts[0].startswith("#"):
            continue
        try:
            values, name = [float(part) for part in parts[:NUMBERS]], parts[NUMBERS].strip()
        except (ValueError, IndexError) as error:
            raise FileError(
                f'Line {number} of "{path}" is not a pair of points; write x, y, z, column, row and the name of the photograph.'
            ) from error
        lines, pairs = groups.setdefault(name, ([], []))
        lines.append(number)
        pairs.append(values)
    return groups
