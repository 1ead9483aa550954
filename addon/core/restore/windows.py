"""Holes of an image, and the part of the image around each that its restoration uses, so that cost follows the holes."""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import binary_dilation, find_objects, label
from scipy.sparse import coo_matrix, csgraph

MIN_MARGIN = 48  # pixels around a hole
MARGIN_FRACTION = 0.75  # the same relative to the longer side of the hole, if that is more
MAX_GAP = 6  # pixels between parts of the mask that are restored together
MIN_SOURCE_PIXELS = 40_000  # in a window; parts of the rest of the image are added to smaller ones
MAX_AREAS = 4  # such parts
MAX_GROUP_PIXELS = 1_000_000  # in windows that are restored together


@dataclass(frozen=True)
class Window:
    """A part of an image: its rows (R,) and columns (S,), which may continue at the opposite border, and its pixels to fill (R, S) bool.

    wrap: whether the window covers the whole image along rows and columns, so that its opposite borders are neighbors.
    """

    rows: np.ndarray
    columns: np.ndarray
    hole: np.ndarray
    wrap: tuple[bool, bool]

    @property
    def area(self) -> tuple[np.ndarray, np.ndarray]:
        """The index of the window's pixels in arrays of the image."""
        return np.ix_(self.rows, self.columns)


def find_windows(mask: np.ndarray, tileable: bool) -> list[Window]:
    """Return a window for every hole of `mask` (H, W) bool. Parts closer together than MAX_GAP are one hole.

    tileable: holes and windows continue across the borders of the image.
    """
    joined = _join(mask, tileable)
    labels, count = label(joined, structure=np.ones((3, 3), bool))
    if tileable:
        labels = _join_labels_across_borders(labels, count)
    windows = []
    for number, found in enumerate(find_objects(labels), start=1):
        spans = []
        for axis in (0, 1):
            used = (labels[found] == number).any(axis=1 - axis)
            spans.append(_span(np.flatnonzero(used) + found[axis].start, mask.shape[axis], tileable))
        extent = max(stop - start for start, stop in spans)
        margin = max(MIN_MARGIN, int(MARGIN_FRACTION * extent))
        axes, wrap = [], []
        for (start, stop), size in zip(spans, mask.shape, strict=True):
            indices, wraps = _grow(start, stop, margin, size, tileable)
            axes.append(indices)
            wrap.append(wraps)
        area = np.ix_(*axes)
        windows.append(Window(*axes, (labels[area] == number) & mask[area], tuple(wrap)))
    return windows


def group_windows(windows: list[Window]) -> list[list[Window]]:
    """Return `windows` in groups that are restored together: of similar width, and bounded in their number of pixels."""
    groups: list[list[Window]] = []
    pixels = 0
    for window in sorted(windows, key=lambda each: (len(each.columns), int(each.rows[0]), int(each.columns[0]))):
        pixels += len(window.rows) * len(window.columns)
        if not groups or pixels > MAX_GROUP_PIXELS:
            groups.append([])
            pixels = len(window.rows) * len(window.columns)
        groups[-1].append(window)
    return groups


def choose_areas(shape: tuple[int, int], width: int, source_pixels: int, generator: np.random.Generator) -> list[tuple[slice, slice]]:
    """Return rows and columns of further parts of an image of this `shape` to copy from, up to `width` pixels wide, if a group of windows
    has few `source_pixels`."""
    if source_pixels >= MIN_SOURCE_PIXELS:
        return []
    columns = min(width, shape[1])
    rows = min(max(MIN_MARGIN, -(-MIN_SOURCE_PIXELS // (MAX_AREAS * columns))), shape[0])
    areas = []
    for _ in range(MAX_AREAS):
        top, left = generator.integers(0, shape[0] - rows + 1), generator.integers(0, shape[1] - columns + 1)
        areas.append((slice(top, top + rows), slice(left, left + columns)))
    return areas


def _join(mask: np.ndarray, tileable: bool) -> np.ndarray:
    """Return `mask` grown so that parts with small gaps touch."""
    radius = MAX_GAP // 2
    if not tileable:
        return binary_dilation(mask, iterations=radius)
    padded = np.pad(mask, radius, mode="wrap")
    return binary_dilation(padded, iterations=radius)[radius:-radius, radius:-radius]


def _join_labels_across_borders(labels: np.ndarray, count: int) -> np.ndarray:
    """Return `labels` (H, W), of which there are `count`, with one number for parts that touch across opposite borders."""
    borders = [(first, np.roll(last, step)) for first, last in (labels[[0, -1]], labels.T[[0, -1]]) for step in (-1, 0, 1)]
    first, last = np.concatenate(borders, axis=1)
    touches = (first > 0) & (last > 0)
    links = coo_matrix((touches[touches], (first[touches], last[touches])), shape=(count + 1, count + 1))
    return csgraph.connected_components(links, directed=False)[1][labels]


def _span(used: np.ndarray, size: int, tileable: bool) -> tuple[int, int]:
    """Return start and stop of the shortest range that contains the indices `used`; stop may exceed `size` in a tileable image."""
    start, stop = int(used[0]), int(used[-1]) + 1
    if not tileable or len(used) == 1:
        return start, stop
    gaps = np.diff(np.append(used, used[0] + size))
    largest = int(gaps.argmax())
    start = int(used[(largest + 1) % len(used)])
    return start, start + size - int(gaps[largest]) + 1


def _grow(start: int, stop: int, margin: int, size: int, tileable: bool) -> tuple[np.ndarray, bool]:
    """Return the indices of a range with a margin, and whether it covers a whole tileable axis."""
    if not tileable:
        return np.arange(max(0, start - margin), min(size, stop + margin)), False
    if stop - start + 2 * margin >= size:
        return np.arange(size), True
    return np.arange(start - margin, stop + margin) % size, False
