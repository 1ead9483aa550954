"""What readers of height maps and voxels share: limits of size, and samples that mean "no data"."""

from pathlib import Path

import numpy as np

from ..errors import FileError

MAX_BYTES = 2**31  # Samples in memory; more would not fit next to a scene. Readers by window have no such limit.
MAX_PRINTED_BYTES = 2**50  # larger sizes come from damaged headers and may have hundreds of digits
MAX_SAMPLES = 1 << 20  # along each side of a map that is read by window
HEIGHT_BYTES = 4  # A height in memory has them, whatever its type in the file.
CHUNK_SAMPLES = 1 << 20  # samples that are converted at once, so that temporary arrays stay small
NO_DATA_MAGNITUDE = 1e30  # some programs write numbers this large for unknown values without declaring it
NO_DATA_INT16 = (-32768, -32767)  # SRTM and DTED write these for unknown elevations, often without declaring it
NUMERIC_KINDS = "buif"  # NumPy kinds of numbers that can be sampled


def is_valid(values: np.ndarray) -> np.ndarray:
    """Return a mask of the values that are finite and not so large that they mean "no data"."""
    return np.abs(values) < NO_DATA_MAGNITUDE if values.dtype.kind == "f" else np.ones(values.shape, bool)


def find_missing(values: np.ndarray, no_data: float | None) -> np.ndarray:
    """Return a mask of the heights, of any shape, that are unknown.

    These are the number `no_data` that the file declares, numbers that are not finite or larger than any height, and -32768 of int16; also
    -32767 of int16 if nothing is declared.
    """
    missing = ~is_valid(values)
    if no_data is not None and abs(no_data) < NO_DATA_MAGNITUDE:  # False for NaN
        missing |= values == no_data
    if values.dtype == np.int16:
        for number in NO_DATA_INT16[: 2 if no_data is None else 1]:
            missing |= values == number
    return missing


def are_valid_sizes(sizes: tuple[float, ...]) -> bool:
    """Return whether numbers from a header can be pixel or voxel sizes. Many programs write zeros there."""
    return all(1e-9 < size < 1e9 for size in sizes)


def check_size(path: Path, count: int, bytes_per_sample: int) -> None:
    """Raise FileError when the file `path` has no samples, or more than fit into memory.

    bytes_per_sample: of what the reader makes of the samples, 4 or more where it makes floats of them.
    """
    if count <= 0:
        raise FileError(f'"{path}" contains no samples.')
    byte_count = count * bytes_per_sample
    if byte_count > MAX_BYTES:
        size = f"{byte_count / 2**30:,.1f}" if byte_count < MAX_PRINTED_BYTES else f"over {MAX_PRINTED_BYTES // 2**30:,}"
        limit = f"{MAX_BYTES / 2**30:g} GiB"
        raise FileError(f'"{path}" needs {size} GiB of memory for its samples; the maximum is {limit}, so reduce its size.')


def to_native_byte_order(path: Path, values: np.ndarray) -> np.ndarray:
    """Return `values` of a file in the byte order of this machine.

    Raises:
        FileError: they are not numbers that can be sampled.
    """
    check_numeric(path, values.dtype)
    return np.asarray(values, values.dtype.newbyteorder("="))


def check_numeric(path: Path, dtype: np.dtype) -> None:
    """Raise FileError when samples of the file `path` are not numbers that can be sampled."""
    if dtype.kind not in NUMERIC_KINDS:
        raise FileError(f'"{path}" contains samples of type {dtype}; only booleans, integers and real numbers are supported.')
