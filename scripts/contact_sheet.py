"""Pictures side by side with words: a grid of equal cells, labelled, written as PNG.

Pictures here are (H, W, 3) float sRGB values in 0..1 with row 0 at the bottom, as renders come.
"""

import struct
import zlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from lettering import text_mask

PAPER = 0.93
INK = 0.12
GAP = 10
LINE = 20  # height of a line of text


def contact_sheet(
    title: str, rows: Sequence[Sequence[np.ndarray]], row_labels: Sequence[str], column_labels: Sequence[Sequence[str]]
) -> np.ndarray:
    """A sheet of pictures of one size: `rows[r][c]` under its column's lines of text, beside its row's label, below the title."""
    height, width = rows[0][0].shape[:2]
    lines = max(len(label) for label in column_labels)
    words = [text_mask(label, LINE) for label in row_labels]
    left = max(word.shape[1] for word in words) + 2 * GAP
    top = LINE * (lines + 2) + 2 * GAP
    sheet_height = top + len(rows) * (height + GAP)
    sheet_width = max(left + len(rows[0]) * (width + GAP), text_mask(title, LINE).shape[1] + 2 * GAP)
    sheet = np.full((sheet_height, sheet_width, 3), PAPER)  # filled from the top here, turned at the end
    write_words(sheet, title, GAP, GAP)
    for column, label in enumerate(column_labels):
        for line, text in enumerate(label):
            write_words(sheet, text, int(GAP + LINE * (1.75 + line)), left + column * (width + GAP))
    for row, pictures in enumerate(rows):
        y = top + row * (height + GAP)
        write_words(sheet, row_labels[row], y + (height - LINE) // 2, GAP)
        for column, picture in enumerate(pictures):
            x = left + column * (width + GAP)
            sheet[y : y + height, x : x + width] = picture[::-1]
    return sheet[::-1]


def enlarged(picture: np.ndarray, factor: int) -> np.ndarray:
    """`picture` (H, W, ...) with every pixel repeated `factor` times in both directions, so that single pixels can be seen."""
    return picture.repeat(factor, axis=0).repeat(factor, axis=1)


def write_png(path: Path, picture: np.ndarray) -> None:
    """Write an (H, W, 3) picture of sRGB values in 0..1, row 0 at the bottom, as an 8-bit PNG."""
    codes = np.clip(np.rint(picture[::-1] * 255.0), 0, 255).astype(np.uint8)
    height, width = codes.shape[:2]
    filtered = np.concatenate([np.zeros((height, 1), np.uint8), codes.reshape(height, -1)], axis=1)
    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    blocks = [(b"IHDR", header), (b"IDAT", zlib.compress(filtered.tobytes(), 9)), (b"IEND", b"")]
    with path.open("wb") as file:
        file.write(b"\x89PNG\r\n\x1a\n")
        for name, content in blocks:
            file.write(struct.pack(">I", len(content)) + name + content + struct.pack(">I", zlib.crc32(name + content)))


def write_words(sheet: np.ndarray, text: str, y: int, x: int, colour: float | tuple[float, float, float] = INK) -> None:
    """Write `text` into `sheet`, row 0 at the top, with its upper left corner at (x, y); what does not fit is cut off."""
    mask = text_mask(text, LINE)[: sheet.shape[0] - y, : sheet.shape[1] - x]
    place = sheet[y : y + mask.shape[0], x : x + mask.shape[1]]
    place += mask[..., None] * (np.asarray(colour) - place)
