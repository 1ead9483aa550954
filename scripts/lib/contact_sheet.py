"""Contact sheets: images side by side in a grid of equal cells with labels, written as PNG.

Images in this module are (H, W, 3) float sRGB values in 0..1 with row 0 at the bottom, as in renders.
"""

import struct
import zlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from lib import environment

environment.import_farfield()

from farfield.addon.bridge.overlays.line_chart import LINE_HEIGHT, PAPER_GRAY, draw_text, rasterize_text
from farfield.addon.core.errors import FileError
from farfield.addon.core.files.file_access import convert_os_errors

GAP = 10
SAMPLE_BYTES = 1 << 20  # by which the filter of a PNG is chosen
LARGE_BYTES = 1 << 24  # For larger images, speed counts more than size.
SOFTWARE = b"Software\x00Farfield"  # a text in the files, by which they are recognized
MAX_HEADER_BYTES = 256


def draw_contact_sheet(
    title: str, rows: Sequence[Sequence[np.ndarray]], row_labels: Sequence[str], column_labels: Sequence[Sequence[str]]
) -> np.ndarray:
    """Return a sheet of images of one size. `rows[r][c]` is below the lines of text of column c and to the right of the label of row r."""
    height, width = rows[0][0].shape[:2]
    lines = max(len(label) for label in column_labels)
    label_masks = [rasterize_text(label, LINE_HEIGHT) for label in row_labels]
    left = max(mask.shape[1] for mask in label_masks) + 2 * GAP
    top = LINE_HEIGHT * (lines + 2) + 2 * GAP
    sheet_height = top + len(rows) * (height + GAP)
    sheet_width = max(left + len(rows[0]) * (width + GAP), rasterize_text(title, LINE_HEIGHT).shape[1] + 2 * GAP)
    sheet = np.full((sheet_height, sheet_width, 3), PAPER_GRAY)  # filled with row 0 at the top, flipped at the end
    draw_text(sheet, title, GAP, GAP)
    for column, label in enumerate(column_labels):
        for line, text in enumerate(label):
            draw_text(sheet, text, int(GAP + LINE_HEIGHT * (1.75 + line)), left + column * (width + GAP))
    for row, images in enumerate(rows):
        y = top + row * (height + GAP)
        draw_text(sheet, row_labels[row], y + (height - LINE_HEIGHT) // 2, GAP)
        for column, image in enumerate(images):
            x = left + column * (width + GAP)
            sheet[y : y + height, x : x + width] = image[::-1]
    return sheet[::-1]


def enlarge(image: np.ndarray, factor: int) -> np.ndarray:
    """Return `image` (H, W, ...) with every pixel repeated `factor` times along both axes, so that single pixels can be seen."""
    return image.repeat(factor, axis=0).repeat(factor, axis=1)


def write_png(path: Path, image: np.ndarray) -> None:
    """Write an image (H, W, 3) of sRGB values in 0..1, row 0 at the bottom, as an 8-bit PNG that `is_own_png` recognizes."""
    values = np.clip(np.rint(image[::-1] * 255.0), 0, 255).astype(np.uint8)
    height, width = values.shape[:2]
    sample = values[: max(SAMPLE_BYTES // (3 * width), 1)]
    filter_type = min(range(3), key=lambda each: len(_compress_rows(sample, each, 6)))
    data = _compress_rows(values, filter_type, 9 if values.size < LARGE_BYTES else 4)
    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    chunks = [(b"IHDR", header), (b"tEXt", SOFTWARE), (b"IDAT", data), (b"IEND", b"")]
    with path.open("wb") as file:
        file.write(b"\x89PNG\r\n\x1a\n")
        for name, content in chunks:
            file.write(struct.pack(">I", len(content)) + name + content + struct.pack(">I", zlib.crc32(name + content)))


def is_own_png(path: Path) -> bool:
    """Whether `path` is a file that `write_png` wrote. False if it does not exist or cannot be read."""
    try:
        if not path.is_file():
            return False
        with path.open("rb") as file:
            return b"tEXt" + SOFTWARE in file.read(MAX_HEADER_BYTES)
    except (OSError, ValueError):
        return False


def check_own_images(folder: Path) -> None:
    """Check that all PNG files in `folder` were written by `write_png`, so that they may be replaced.

    Raises:
        FileError: one was not, or the folder cannot be read.
    """
    with convert_os_errors(f'Cannot read "{folder}"'):
        paths = sorted(folder.glob("*.[pP][nN][gG]")) if folder.is_dir() else []
    for path in paths:
        if not is_own_png(path):
            raise FileError(f'The folder "{folder}" contains other images, such as "{path.name}"; choose an empty or a new folder.')


def _compress_rows(values: np.ndarray, filter_type: int, level: int) -> bytes:
    """Compress the rows of an image (H, W, 3) uint8 after PNG's filter 0 (none), 1 (minus the left pixel) or 2 (minus the upper pixel)."""
    previous = np.zeros_like(values)
    if filter_type == 1:
        previous[:, 1:] = values[:, :-1]
    elif filter_type == 2:
        previous[1:] = values[:-1]
    rows = (values - previous).reshape(len(values), -1)
    return zlib.compress(np.insert(rows, 0, filter_type, axis=1).tobytes(), level)
