"""World files: the position of an image on a map in six lines of text beside it (Esri, World files for raster datasets).

The lines are A, D, B, E, C and F of x = A * column + B * row + C and y = D * column + E * row + F, at the centers of pixels counted from
(0, 0) in the upper left corner. The coordinate reference system is not declared.
"""

import math
from pathlib import Path

from ...errors import FileError
from ...files.file_access import convert_os_errors
from ...files.height_maps import are_valid_sizes

MAX_BYTES = 1024


def find_world_file(image: Path) -> Path | None:
    """Return the world file of an image, None if there is none: the first and last letter of its file name extension with a w, the whole
    extension with a w, or .wld."""
    letters = image.suffix[1:]
    if not letters:
        return None
    names = (f"{letters[0]}{letters[-1]}w", f"{letters}w", "wld")
    candidates = (image.with_suffix(f".{name}") for ending in names for name in (ending, ending.lower(), ending.upper()))
    return next((path for path in candidates if path.is_file()), None)


def read_world_file(path: Path) -> tuple[float, float, float, float, float, float]:
    """Return (a, b, c, d, e, f) of a world file in the order of `GeoReference.affine`: x = a * column + b * row + c, y = d * column +
    e * row + f.

    Raises:
        FileError: it cannot be read, or does not contain six numbers.
    """
    with convert_os_errors(f'"{path}" cannot be read'), path.open("rb") as file:
        words = file.read(MAX_BYTES).replace(b",", b".").split()
    try:
        a, d, b, e, c, f = (float(word) for word in words[:6])
    except ValueError as error:
        raise FileError(f'"{path}" is no world file: it must contain six numbers, one per line.') from error
    is_valid = all(math.isfinite(number) for number in (a, b, c, d, e, f))
    if not is_valid or not are_valid_sizes((math.hypot(a, d), math.hypot(b, e))):
        raise FileError(f'"{path}" is no world file: its pixels have no size; export it again.')
    return a, b, c, d, e, f
