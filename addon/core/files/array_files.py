"""NumPy arrays in .npy files."""

import tokenize
from pathlib import Path

import numpy as np

from ..errors import FileError

# Of headers that are no Python literals, and of sizes that the file does not have.
NUMPY_ERRORS = (EOFError, OverflowError, SyntaxError, TypeError, ValueError, tokenize.TokenError)


def map_array(path: Path) -> np.ndarray:
    """Return the array of a .npy file, mapped, so that a header with a false size costs no memory.

    Raises:
        FileError: the file is truncated or damaged, is an archive, or contains Python objects.
    """
    try:
        mapped = np.load(path, mmap_mode="r", allow_pickle=False)
        if not isinstance(mapped, np.ndarray):
            raise FileError(f'"{path}" is an archive, not a single array; save the array with numpy.save.')
    except NUMPY_ERRORS as error:
        raise FileError(f'"{path}" cannot be read as a NumPy array: it is truncated, damaged or not an array of numbers.') from error
    return mapped
