"""The outline of a mask as line segments."""

import numpy as np

MAX_EDGES = 1_000_000  # between pixels; of masks with more, such as noise, a coarser outline is drawn


def find_segments(mask: np.ndarray) -> np.ndarray:
    """Return the outline of `mask` (H, W) bool as line segments (N, 2, 2) float32 with ends x, y, where the image is the unit square.

    Edges of pixels along one line are one segment. The outline runs along the border of the image where masked pixels touch it.
    """
    height, width = mask.shape
    padded = np.pad(mask, 1)
    rows, columns = np.nonzero(padded[1:, 1:-1] != padded[:-1, 1:-1])  # horizontal edges
    edge_rows, edge_columns = np.nonzero(padded[1:-1, 1:] != padded[1:-1, :-1])  # vertical edges
    if len(rows) + len(edge_rows) > MAX_EDGES:
        even = np.pad(mask, ((0, height % 2), (0, width % 2)))
        halved = even[0::2, 0::2] | even[1::2, 0::2] | even[0::2, 1::2] | even[1::2, 1::2]
        return np.minimum(find_segments(halved) * np.float32([even.shape[1] / width, even.shape[0] / height]), np.float32(1.0))
    segments = np.concatenate([_join(rows, columns), _join(edge_columns, edge_rows)[:, :, ::-1]])
    return (segments / [width, height]).astype(np.float32)


def _join(lines: np.ndarray, positions: np.ndarray) -> np.ndarray:
    """Join edges from `positions` to `positions` + 1 on `lines` (N,) where they touch: segments (R, 2, 2) with ends position, line."""
    order = np.lexsort((positions, lines))
    lines, positions = lines[order], positions[order]
    is_start = np.ones(len(lines), bool)
    is_start[1:] = (np.diff(lines) != 0) | (np.diff(positions) != 1)
    is_end = np.append(is_start[1:], True)[: len(lines)]
    starts = np.column_stack([positions[is_start], lines[is_start]])
    return np.stack([starts, np.column_stack([positions[is_end] + 1, lines[is_end]])], axis=1)
