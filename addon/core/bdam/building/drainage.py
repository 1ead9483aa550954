"""Where water flows on a grid of heights, and which area drains through each sample.

Each sample flows to the lowest of its eight neighbors by gradient, where diagonals have a random length so that flow on even ground does
not follow the axes of the grid (Rho8: Fairfield and Leymarie, Drainage networks from grid digital elevation models, 1991). Depressions are
routed over their lowest passes along a minimum spanning tree of basins (Cordonnier, Bovy and Braun, A versatile, linear complexity
algorithm for flow routing in topographies with depressions, 2019); the flow inside of a basin is reversed from its pass to its pit. Water
leaves at the border of the known samples.

Heights are NaN where they are unknown. Positions are those in the flat array.
"""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage
from scipy.sparse import coo_array
from scipy.sparse.csgraph import breadth_first_order, minimum_spanning_tree

OFFSETS = ((-1, 0), (1, 0), (0, -1), (0, 1), (-1, -1), (-1, 1), (1, -1), (1, 1))
PAIRS = ((0, 1), (1, 0), (1, 1), (1, -1))  # Offsets that lead to every pair of neighbors once.


@dataclass(frozen=True)
class Drainage:
    """The trees of flow over a grid.

    Attributes:
        receivers: (N,) int32, the position that each sample flows to, its own for outlets and unknown samples.
        lengths: (N,) float32, the distance to it in cells.
        order: (N,) int32, all positions, receivers before the samples that flow to them.
        starts: (D + 1,) where the samples of each depth of the trees begin in `order`.
    """

    receivers: np.ndarray
    lengths: np.ndarray
    order: np.ndarray
    starts: np.ndarray

    def accumulate(self) -> np.ndarray:
        """Return the area (N,) float64 in cells that drains through each sample, its own included."""
        areas = np.ones(len(self.receivers))
        for start, stop in zip(self.starts[-2:0:-1], self.starts[:1:-1], strict=True):
            members = self.order[start:stop]
            np.add.at(areas, self.receivers[members], areas[members])
        return areas


def find_drainage(heights: np.ndarray, seed: int) -> Drainage:
    """Return the drainage of a grid (H, W). seed: of the random lengths."""
    receivers = find_receivers(heights, draw_lengths((0, 0), heights.shape, seed))
    _cross_flats(heights, receivers)
    _route_over_passes(heights, receivers)
    depths, _ = _follow(receivers)
    order = np.argsort(depths, kind="stable").astype(np.int32)
    starts = np.concatenate([[0], np.cumsum(np.bincount(depths))])
    return Drainage(receivers, measure_lengths(receivers, heights.shape[1]), order, starts)


def draw_lengths(first: tuple[int, int], shape: tuple[int, int], seed: int) -> np.ndarray:
    """Return the random lengths (H, W) float32, 1 to 2, of diagonals in a window of the grid that begins at row and column `first`."""
    rows = np.arange(first[0], first[0] + shape[0], dtype=np.uint32)[:, None] * np.uint32(0x9E3779B1)
    columns = np.arange(first[1], first[1] + shape[1], dtype=np.uint32) * np.uint32(0x85EBCA77)
    noise = rows ^ (columns + np.uint32(seed * 0x27D4EB2F % 2**32))
    for factor, shift in ((0x7FEB352D, 15), (0x846CA68B, 16)):
        noise = (noise ^ (noise >> np.uint32(shift))) * np.uint32(factor)
    return np.float32(2.0) - (noise >> np.uint32(8)).astype(np.float32) * np.float32(2.0**-24)


def find_receivers(heights: np.ndarray, diagonals: np.ndarray) -> np.ndarray:
    """Return the position (N,) int32 that each sample of a grid (H, W) float32 flows to, its own if no neighbor is lower.

    diagonals: (H, W) lengths, see `draw_lengths`.
    """
    rows, columns = heights.shape
    padded = np.pad(np.where(np.isnan(heights), np.float32(np.inf), heights), 1, constant_values=np.inf)
    center = np.where(np.isnan(heights), np.float32(-np.inf), heights)
    best = np.zeros(heights.shape, np.float32)
    receivers = np.arange(heights.size, dtype=np.int32).reshape(heights.shape)
    own = receivers.copy()
    for row, column in OFFSETS:
        gradients = center - padded[1 + row : 1 + row + rows, 1 + column : 1 + column + columns]
        if row and column:
            gradients /= diagonals
        is_better = gradients > best
        np.copyto(best, gradients, where=is_better)
        np.copyto(receivers, own + np.int32(row * columns + column), where=is_better)
    return receivers.reshape(-1)


def pair_windows(shape: tuple[int, int], row: int, column: int) -> tuple[tuple[slice, slice], tuple[slice, slice]]:
    """Return the windows of a grid whose samples are neighbors with an offset of PAIRS: of the first ones, and of the second ones."""
    rows, columns = shape
    return (
        (slice(0, rows - row), slice(max(-column, 0), columns - max(column, 0))),
        (slice(row, rows), slice(max(column, 0), columns - max(-column, 0))),
    )


def measure_lengths(receivers: np.ndarray, columns: int) -> np.ndarray:
    """Return the distance (N,) float32 to each receiver in cells, 1 for those that have none."""
    steps = np.abs(receivers - np.arange(len(receivers), dtype=np.int32))
    return np.where((steps <= 1) | (steps == columns), np.float32(1.0), np.float32(np.sqrt(2.0)))


def _follow(receivers: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the number of steps (N,) int32 from each sample to the end of its path, and the position (N,) int32 of that end."""
    depths, ends = (receivers != np.arange(len(receivers))).astype(np.int32), receivers
    while True:
        further = ends[ends]
        if np.array_equal(further, ends):
            return depths, ends
        depths = depths + depths[ends]
        ends = further


def _cross_flats(heights: np.ndarray, receivers: np.ndarray) -> None:
    """Change receivers (N,) in place so that water crosses flats, each sample of which would be a basin otherwise: to where their rim is
    lower, or else to their first sample on the border of the known ones, or else to their first sample."""
    is_known = ~np.isnan(heights)
    is_open = (receivers == np.arange(len(receivers))).reshape(heights.shape) & is_known
    is_near = ndimage.binary_dilation(is_open, np.ones((3, 3), bool))
    _flood_flats(heights, receivers, is_open, np.flatnonzero(is_known & is_near & ~is_open))
    labels, _ = ndimage.label(is_open, np.ones((3, 3), bool))
    for candidates in (_find_border(is_known), is_known):
        positions = np.flatnonzero(candidates & is_open)
        first = positions[np.unique(labels.reshape(-1)[positions], return_index=True)[1]]
        is_open.reshape(-1)[first] = False
        _flood_flats(heights, receivers, is_open, first)


def _flood_flats(heights: np.ndarray, receivers: np.ndarray, is_open: np.ndarray, front: np.ndarray) -> None:
    """Let open samples (H, W) flow to neighbors of the same height that are not open, beginning with `front` (F,). Both arrays change."""
    rows, columns = heights.shape
    flat, is_open = heights.reshape(-1), is_open.reshape(-1)
    while len(front):
        reached = []
        for row, column in OFFSETS:
            y, x = front // columns + row, front % columns + column
            members = np.flatnonzero((y >= 0) & (y < rows) & (x >= 0) & (x < columns))
            neighbors = (y * columns + x)[members]
            is_next = is_open[neighbors] & (flat[neighbors] == flat[front[members]])
            neighbors = neighbors[is_next]
            receivers[neighbors] = front[members[is_next]]
            is_open[neighbors] = False
            reached.append(neighbors)
        front = np.concatenate(reached)


def _find_border(is_known: np.ndarray) -> np.ndarray:
    """Return a mask (H, W) of known samples next to unknown ones or to the border of the grid."""
    return is_known & ~ndimage.binary_erosion(is_known, np.ones((3, 3), bool))


def _route_over_passes(heights: np.ndarray, receivers: np.ndarray) -> None:
    """Change receivers (N,) in place so that all basins drain to the border of the known samples over their lowest passes."""
    ends = _follow(receivers)[1]
    is_known = ~np.isnan(heights)
    pits = np.flatnonzero((receivers == np.arange(len(receivers))) & is_known.reshape(-1))
    basins = np.zeros(heights.size, np.int32)  # Basin 0 is outside.
    basins[pits] = np.arange(1, len(pits) + 1, dtype=np.int32)
    basins = basins[ends]
    own, others = _find_passes(heights, basins, is_known)
    levels = np.maximum(heights.reshape(-1)[own], heights.reshape(-1)[others])
    # A pass leads outside where it ends in the sample itself.
    pairs = np.sort(np.stack([basins[own], np.where(own == others, 0, basins[others])]), axis=0)
    by_pair = np.lexsort((levels, pairs[1], pairs[0]))
    lowest = by_pair[np.append(True, (np.diff(pairs[:, by_pair]) != 0).any(axis=0))[: len(by_pair)]]
    lowest = lowest[np.argsort(levels[lowest], kind="stable")]
    ranks, count = np.arange(1.0, len(lowest) + 1.0), len(pits) + 1
    graph = coo_array((ranks, (pairs[0, lowest], pairs[1, lowest])), shape=(count, count)).tocsr()
    tree = minimum_spanning_tree(graph)
    _, previous = breadth_first_order(tree, 0, directed=False)
    edges = tree.tocoo()
    number = lowest[edges.data.astype(np.int64) - 1]
    is_child_first = previous[edges.row] == edges.col
    child = np.where(is_child_first, edges.row, edges.col)
    is_own = basins[own[number]] == child
    current, target = np.where(is_own, own[number], others[number]), np.where(is_own, others[number], own[number])
    _reverse_paths(receivers, current, target)


def _find_passes(heights: np.ndarray, basins: np.ndarray, is_known: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return positions (P,) of neighbors in different basins; for samples on the border of the known ones, twice their own."""
    positions = np.arange(heights.size, dtype=np.int32).reshape(heights.shape)
    by_sample = basins.reshape(heights.shape)
    border = positions[_find_border(is_known)]
    own, others = [border], [border]
    for row, column in PAIRS:
        first, second = pair_windows(heights.shape, row, column)
        is_pass = (by_sample[first] != by_sample[second]) & (by_sample[first] > 0) & (by_sample[second] > 0)
        own.append(positions[first][is_pass])
        others.append(positions[second][is_pass])
    return np.concatenate(own), np.concatenate(others)


def _reverse_paths(receivers: np.ndarray, current: np.ndarray, target: np.ndarray) -> None:
    """Make the samples `current` (B,), one of each basin, flow to `target` (B,), and the paths from them to their pits flow backwards."""
    while len(current):
        following = receivers[current]
        receivers[current] = target
        goes_on = following != current
        current, target = following[goes_on], current[goes_on]
