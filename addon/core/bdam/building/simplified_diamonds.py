"""Simplification of diamonds to half of their vertices, and their division into the two patches of a level (BDAM, section 5.1)."""

import numpy as np

from ...arrays import concatenate_ranges, gather, to_starts
from ..height_meshes import sum_gradients
from ..simplification.collapse_costs import FREE, HORIZONTAL, LOCKED, VERTICAL
from ..simplification.collapsed_fans import RemovedSamples
from ..simplification.decimation import MeshBatch, simplify
from ..tree import Tree
from .diamond_meshes import DiamondMeshes, classify_vertices, triangulate_field, weld_patches
from .height_grid import HeightGrid, split_rows
from .patch_set import PatchSet
from .vertical_errors import Measurement, measure_triangles

# The next level measures so many samples of a triangle: without any, errors grow unseen, and all of them would take too long.
MAX_SAMPLES_PER_TRIANGLE = 6
CLIFF_RATIO = 2.0  # A sample is at a cliff if it is so many times as far from its neighbors as the error of its diamond.
NEARBY = 2  # samples around one that tell whether it is at a cliff
BAND_PARTS = 8  # Bands have so many times fewer samples than others, since these are copied.
OPPOSITE = [(row, column) for row in range(NEARBY + 1) for column in range(-NEARBY, NEARBY + 1) if (row, column) > (0, 0)]
MAX_MEASURED_SAMPLES = 1 << 14  # Samples are measured in such chunks, so that they do not decide how much memory workers need.
# More than half of the vertices stay if the error would grow by more than this factor from one level to the next, as along cliffs. Diamonds
# are halved in any case if they have more than MAX_VERTICES times the square of the cells of a leaf; half as many are usual.
MAX_ERROR_GROWTH, MAX_VERTICES = 2.5, 4
GRID_COLLAPSE_FRACTION = 0.6  # The first collapses of a grid remove this fraction of the vertices that are to be removed.


def simplify_diamonds(
    tree: Tree, level: int, triangles: np.ndarray, diamonds: np.ndarray, children: PatchSet | None, grid: HeightGrid
) -> PatchSet:
    """Build the patches of some diamonds of a level.

    Args:
        triangles: (N,) int64, bintree indices of the triangles of this level. diamonds: (D, 2) positions in `triangles`, see
            `Tree.find_diamonds`. children: the patches of the next level that lie in these diamonds; None for the finest diamonds, which
            are triangulated from the field.

    Returns:
        Patches in ascending order of their indices.
    """
    corners = tree.triangle_corners(level, triangles)
    pairs = np.where(diamonds < 0, diamonds[:, :1], diamonds)
    if children is None:
        meshes = triangulate_field(tree, (corners[diamonds[:, 0], 0] + corners[diamonds[:, 0], 1]) // 2, grid)
    else:
        diamond_of = np.full(len(triangles), -1, np.int64)
        for column in range(2):
            diamond_of[pairs[:, column]] = np.arange(len(diamonds))
        of_children = diamond_of[np.searchsorted(triangles, children.indices >> 1)]
        meshes = weld_patches(tree, children, of_children)
    lines, sides = classify_vertices(tree, meshes, corners[pairs[:, 0]])
    counts = np.bincount(meshes.domains, minlength=len(diamonds))
    excess, limits = counts // 2, np.full(len(diamonds), np.inf, np.float32)
    if children is not None:
        errors = np.zeros(len(diamonds), np.float32)
        np.maximum.at(errors, of_children, children.errors)
        is_limited = counts <= MAX_VERTICES * tree.leaf_cells**2
        limits[is_limited] = MAX_ERROR_GROWTH * np.maximum(errors[is_limited], 1.0)
    first = choose_grid_collapses(meshes, lines, excess) if children is None else None
    batch = _to_batch(meshes, lines, int(np.ptp(corners[0], axis=0).max()))
    simplified, removed = simplify(batch, excess, limits, first)
    if children is None and _is_complete(meshes, grid):
        measured = _measure_removed(batch, simplified, removed)
    else:
        corner_points = np.stack([meshes.x.take(simplified), meshes.y.take(simplified)], axis=2)
        measured = measure_triangles(corner_points, meshes.z.take(simplified), grid)
    samples = _choose_samples(batch, simplified, removed, measured, grid)
    return _divide(meshes, sides, simplified, samples, triangles, pairs, measured)


def _is_complete(meshes: DiamondMeshes, grid: HeightGrid) -> bool:
    """Return whether all samples of the smallest rectangle around some diamonds are known."""
    rows, columns = (slice(int(axis.min()), int(axis.max()) + 1) for axis in (meshes.y, meshes.x))
    return all(bool(grid.read(band, columns)[1].all()) for band in split_rows(rows.start, rows.stop, columns.stop - columns.start))


def _measure_removed(batch: MeshBatch, triangles: np.ndarray, removed: RemovedSamples) -> Measurement:
    """Measure the finest diamonds, all of whose samples are vertices or were just removed, and known.

    A sample on an edge counts for one of its two triangles; edges between diamonds have no samples yet.
    """
    errors = np.zeros(len(triangles), np.float32)
    np.maximum.at(errors, removed.triangles, _measure_samples(batch, triangles, removed).astype(np.float32))
    return Measurement(errors, np.zeros(len(triangles), bool))


def _choose_samples(
    batch: MeshBatch, triangles: np.ndarray, removed: RemovedSamples, measured: Measurement, grid: HeightGrid
) -> RemovedSamples:
    """Return the samples that the next level measures: of each triangle the one with the largest distance, a few random ones, and all at
    cliffs, which are far from the ground as soon as an edge moves past them."""
    counts = np.bincount(removed.triangles, minlength=len(triangles))
    is_crowded = gather(counts, removed.triangles) > MAX_SAMPLES_PER_TRIANGLE
    crowded = RemovedSamples(removed.vertices.compress(is_crowded), removed.triangles.compress(is_crowded))
    distances = _measure_samples(batch, triangles, crowded)
    largest = np.zeros(len(triangles))
    np.maximum.at(largest, crowded.triangles, distances)
    noise = (crowded.vertices.astype(np.uint32) * np.uint32(2654435761)).astype(np.uint64) >> np.uint64(1)
    noise[distances == gather(largest, crowded.triangles)] = 0
    order = np.argsort(crowded.triangles.astype(np.uint64) << np.uint64(32) | noise, kind="stable")
    counts[counts <= MAX_SAMPLES_PER_TRIANGLE] = 0
    ranks = concatenate_ranges(0, counts)
    x, y = batch.x[crowded.vertices], batch.y[crowded.vertices]
    domains = batch.domains[triangles[:, 0]]
    errors = np.zeros(int(domains.max(initial=0)) + 1, np.float32)
    np.maximum.at(errors, domains, measured.errors)
    is_at_cliff = measure_second_differences(x, y, grid) > CLIFF_RATIO * np.maximum(errors, 1.0)[domains[crowded.triangles]]
    is_kept = ranks < MAX_SAMPLES_PER_TRIANGLE
    is_kept |= gather(is_at_cliff, order)
    kept = gather(np.flatnonzero(is_crowded), order.compress(is_kept))
    chosen = np.concatenate([np.flatnonzero(~is_crowded), kept])
    return RemovedSamples(gather(removed.vertices, chosen), gather(removed.triangles, chosen))


def measure_second_differences(x: np.ndarray, y: np.ndarray, grid: HeightGrid) -> np.ndarray:
    """Return how far samples (N,) are from the mean of two opposite neighbors, the largest of all pairs, (N,) float32 in steps."""
    differences = np.zeros(len(x), np.float32)
    if not len(x):
        return differences
    left, right = max(int(x.min()) - NEARBY, 0), min(int(x.max()) + NEARBY + 1, grid.columns)
    for band in split_rows(int(y.min()), int(y.max()) + 1, BAND_PARTS * (right - left)):
        members = np.flatnonzero((y >= band.start) & (y < band.stop))
        first = max(band.start - NEARBY, 0)
        heights, _ = grid.read(slice(first, min(band.stop + NEARBY, grid.rows)), slice(left, right))
        heights = np.pad(heights, NEARBY, mode="edge")
        places = (y[members] - first + NEARBY) * heights.shape[1] + x[members] - left + NEARBY
        flat, largest = heights.reshape(-1), np.zeros(len(members), np.int64)
        own = 2 * flat[places].astype(np.int64)
        for row, column in OPPOSITE:
            offset = row * heights.shape[1] + column
            np.maximum(largest, np.abs(own - flat[places + offset] - flat[places - offset]), out=largest)
        differences[members] = np.float32(0.5) * largest
    return differences


def _measure_samples(batch: MeshBatch, triangles: np.ndarray, removed: RemovedSamples) -> np.ndarray:
    """Return the vertical distances (S,) float64 of samples from the triangles that contain them."""
    distances = np.empty(len(removed.vertices))
    for start in range(0, len(distances), MAX_MEASURED_SAMPLES):
        part = slice(start, start + MAX_MEASURED_SAMPLES)
        x, y, z = (gather(values, removed.vertices[part]).astype(np.float64) for values in (batch.x, batch.y, batch.z))
        corners = triangles.take(removed.triangles[part], axis=0).T.astype(np.intp)
        (x0, x1, x2), (y0, y1, y2), (z0, z1, z2) = (gather(values, corners).astype(np.float64) for values in (batch.x, batch.y, batch.z))
        area = (x1 - x0) * (y2 - y0) - (y1 - y0) * (x2 - x0)
        second, third = ((x - x0) * (y2 - y0) - (y - y0) * (x2 - x0)) / area, ((x1 - x0) * (y - y0) - (y1 - y0) * (x - x0)) / area
        distances[part] = np.abs(z0 + second * (z1 - z0) + third * (z2 - z0) - z)
    return distances


def _to_batch(meshes: DiamondMeshes, lines: np.ndarray, extent: int) -> MeshBatch:
    x, y, z = (np.concatenate([values, meshes.samples[:, axis]]) for axis, values in enumerate((meshes.x, meshes.y, meshes.z)))
    return MeshBatch(x, y, z.astype(np.float32), lines, meshes.domains, meshes.triangles, meshes.sample_triangles, extent)


def _divide(
    meshes: DiamondMeshes,
    sides: np.ndarray,
    simplified: np.ndarray,
    samples: RemovedSamples,
    indices: np.ndarray,
    pairs: np.ndarray,
    measured: Measurement,
) -> PatchSet:
    """Divide simplified diamonds along their hypotenuses, and find the gradients there."""
    of_triangle = meshes.domains[simplified[:, 0]]
    side = (sides.take(simplified).sum(axis=1) < 0).astype(np.int64)
    patches = pairs[of_triangle, side]
    errors = np.zeros(len(indices), np.float32)
    np.maximum.at(errors, patches, measured.errors)
    gradients = _add_gradients(meshes, simplified, np.isnan(meshes.gradients[:, 0]) & (sides == 0))
    patch_count = len(indices)
    is_used = np.zeros((2, len(meshes.x)), bool)
    is_used[side[:, None], simplified] = True
    vertex_sides, vertices = np.nonzero(is_used)
    patches_of_vertices = pairs[meshes.domains[vertices], vertex_sides]
    vertex_order = np.argsort(patches_of_vertices, kind="stable")
    vertices, vertex_sides = vertices[vertex_order], vertex_sides[vertex_order]
    vertex_counts = np.bincount(patches_of_vertices, minlength=patch_count)
    local = np.empty(is_used.shape, np.int32)
    local[vertex_sides, vertices] = concatenate_ranges(0, vertex_counts)

    order = np.argsort(patches, kind="stable")
    triangle_counts = np.bincount(patches, minlength=patch_count)
    local_triangles = local[side[:, None], simplified][order]
    present = np.flatnonzero(triangle_counts)
    vertex_counts, triangle_counts = vertex_counts[present], triangle_counts[present]
    triangle_starts = to_starts(triangle_counts)
    rank = np.empty(len(order), np.int64)
    rank[order] = np.arange(len(order))
    sample_order = np.argsort(rank[samples.triangles], kind="stable")
    sample_triangles = rank[samples.triangles[sample_order]]
    all_points = np.concatenate([np.stack([meshes.x, meshes.y, meshes.z], axis=1), meshes.samples])
    sample_starts = np.searchsorted(sample_triangles, triangle_starts)
    return PatchSet(
        indices[present],
        errors[present],
        to_starts(vertex_counts),
        triangle_starts,
        meshes.x[vertices],
        meshes.y[vertices],
        meshes.z[vertices],
        gradients[vertices],
        local_triangles,
        measured.is_hole[order],
        sample_starts.astype(np.int64),
        all_points[samples.vertices[sample_order]],
        (sample_triangles - np.repeat(triangle_starts[:-1], np.diff(sample_starts))).astype(np.int32),
    )


def _add_gradients(meshes: DiamondMeshes, triangles: np.ndarray, is_missing: np.ndarray) -> np.ndarray:
    """Return the gradients (V, 2) float32 with those of the vertices `is_missing` (V,), if triangles use them: means of the gradients of
    their triangles weighted by area."""
    triangles = triangles[is_missing.take(triangles).any(axis=1)]
    sums = sum_gradients(np.stack([meshes.x, meshes.y, meshes.z]).astype(np.float64), triangles.T.astype(np.intp, order="C"))
    sums = [values[is_missing] for values in sums]
    gradients = meshes.gradients.copy()
    gradients[is_missing] = np.stack(sums[:2], axis=1) / np.maximum(sums[2], 1.0)[:, None]
    return gradients


def choose_grid_collapses(meshes: DiamondMeshes, lines: np.ndarray, excess: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Choose the first collapses of a regular grid: the cheapest samples that have four neighbors.

    Samples with an odd sum of coordinates share no triangle, so their costs are found at once and any number of them can be removed.

    Args:
        meshes: all samples of diamonds. lines: (V,) int8, constraints. excess: (D,) int, how many vertices to remove from each diamond.

    Returns:
        Vertices (N,) int32 and the neighbors (N,) int32 to collapse them onto.
    """
    odd = np.flatnonzero(((meshes.x + meshes.y) % 2 == 1) & (lines != LOCKED)).astype(np.int32)
    x_low, x_high, y_low, y_high = _find_neighbors(meshes, odd)
    z = meshes.z.astype(np.float32)
    across = np.abs(z[odd] - 0.5 * (z[x_low] + z[x_high]))
    along = np.abs(z[odd] - 0.5 * (z[y_low] + z[y_high]))
    across[((lines[odd] != FREE) & (lines[odd] != HORIZONTAL)) | (x_low < 0) | (x_high < 0)] = np.inf
    along[((lines[odd] != FREE) & (lines[odd] != VERTICAL)) | (y_low < 0) | (y_high < 0)] = np.inf
    costs = np.minimum(across, along)
    # At a boundary, the target is the neighbor with which the counterclockwise fan of triangles begins.
    targets = np.where(across <= along, np.where(y_low < 0, x_high, x_low), np.where(x_high < 0, y_high, y_low))
    domains = meshes.domains[odd]
    order = np.lexsort((costs, domains))
    counts = np.bincount(domains, minlength=len(excess))
    ranks = concatenate_ranges(0, counts)
    chosen = order[(ranks < GRID_COLLAPSE_FRACTION * excess[domains[order]]) & np.isfinite(costs[order])]
    chosen.sort()
    return odd[chosen], targets[chosen]


def _find_neighbors(meshes: DiamondMeshes, vertices: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return the vertices (N,) int32 before and after `vertices` along x and along y, -1 where there is none."""
    x, y, domains = (array.astype(np.int64) for array in (meshes.x, meshes.y, meshes.domains))
    width, height = int(x.max()) + 3, int(y.max()) + 3
    keys = (domains * height + y + 1) * width + x + 1
    order = np.argsort(keys, kind="stable")
    found = []
    for offset in (-1, 1, -width, width):
        wanted = keys[vertices] + offset
        positions = np.minimum(np.searchsorted(keys, wanted, sorter=order), len(keys) - 1)
        found.append(np.where(keys[order[positions]] == wanted, order[positions], -1).astype(np.int32))
    return tuple(found)
