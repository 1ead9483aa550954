"""Normals of a surface as seen at a scale: bolts, grooves and noise below it do not change them."""

from dataclasses import replace

import numpy as np
from scipy.sparse import csr_array
from scipy.spatial import cKDTree

from ..arrays import TINY, group_rows
from .primitives import Primitives

CELL_FRACTION = 0.5  # Samples in one cell of this fraction of the radius are merged if their normals are in one octant.
SAMPLE_SPACING = 1.0  # Of samples on a large face, in radii.
SAMPLES_PER_PRIMITIVE, MIN_SAMPLE_LIMIT = 8, 20_000  # Maximum number of samples, per primitive, or this many if that is more.
MIN_COHERENCE = 0.5  # Length of the mean normal of a neighborhood, below which its sides cancel out, as on a thin plate.
UP = np.array([0.36, 0.48, 0.8])  # The side of plates that have two equal ones: any direction that is unlikely to lie in a plate.
MIN_FLATNESS = 0.6  # Fraction of one axis in the squared normals of a neighborhood that count as a plate.


def normals_at_scale(primitives: Primitives, radius: float, error: float) -> np.ndarray:
    """Compute the unit normal (P, 3) of the surface within `radius`, a length, of each primitive.

    It is the mean over the area, nearer parts weighing more. Where the sides of a plate cancel out, it is the normal of the plate, on the
    side that prevails; where nothing prevails, as in a tangle, it is the primitive's own.
    """
    if radius <= 0.0:
        return primitives.normals
    owner, positions, areas = _sample(primitives, radius)
    normals = primitives.normals[owner]
    cells, representative = _merge(positions, normals, areas, radius)
    moments = _blur(*cells, radius)[representative] * areas[:, None]
    sums = np.stack([np.bincount(owner, column, len(primitives)) for column in moments.T], axis=1)
    chosen = _choose_normals(primitives.normals, sums)
    thickness = np.ptp(np.einsum("pci,pi->pc", primitives.positions, chosen), axis=1)
    return np.where((thickness <= 2.0 * error)[:, None], chosen, primitives.normals)


def at_scale(primitives: Primitives, radius: float, error: float) -> Primitives:
    """Return `primitives` with their `normals_at_scale`."""
    return replace(primitives, normals=normals_at_scale(primitives, radius, error)) if radius > 0.0 else primitives


def _sample(primitives: Primitives, radius: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Sample the primitives: owner (S,), positions (S, 3) and areas (S,). Large triangles have several samples, others their centroid."""
    count = len(primitives)
    corners = primitives.positions
    steps = np.ones(count, np.int64)
    if corners.shape[1] == 3:
        longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
        steps = np.maximum(np.ceil(longest / (SAMPLE_SPACING * radius)), 1.0)
        steps = np.minimum(steps, _limit_steps(steps)).astype(np.int64)
    owners, positions = [], []
    for step in np.unique(steps):
        members = np.flatnonzero(steps == step)
        weights = _barycentric_centroids(int(step)) if corners.shape[1] == 3 else np.full((1, corners.shape[1]), 1.0 / corners.shape[1])
        owners.append(np.repeat(members, len(weights)))
        positions.append(np.einsum("sc,pci->psi", weights, corners[members]).reshape(-1, 3))
    owner = np.concatenate(owners)
    return owner, np.concatenate(positions), primitives.areas[owner] / (steps[owner] ** 2)


def _limit_steps(steps: np.ndarray) -> float:
    """Return the number of steps at which larger `steps` (P,) end so that the samples, its squares, stay within their limit."""
    limit = max(SAMPLES_PER_PRIMITIVE * len(steps), MIN_SAMPLE_LIMIT)
    squares = np.sort(steps) ** 2
    sums = np.cumsum(squares)
    totals = sums + squares * np.arange(len(steps) - 1, -1, -1)
    fitting = int(np.searchsorted(totals, limit, side="right"))
    if fitting == len(steps):
        return np.inf
    return float(np.floor(np.sqrt((limit - (sums[fitting - 1] if fitting else 0.0)) / (len(steps) - fitting))))


def _barycentric_centroids(steps: int) -> np.ndarray:
    """Return the barycentric coordinates (steps^2, 3) of the centroids of the triangles that equal steps along the edges make."""
    i, j = np.meshgrid(np.arange(steps), np.arange(steps), indexing="ij")
    upright = np.stack([i, j], axis=-1)[i + j < steps] + 1.0 / 3.0
    inverted = np.stack([i, j], axis=-1)[i + j < steps - 1] + 2.0 / 3.0
    first = np.concatenate([upright, inverted]) / steps
    return np.column_stack([first, 1.0 - first.sum(axis=1)])


def _merge(
    positions: np.ndarray, normals: np.ndarray, areas: np.ndarray, radius: float
) -> tuple[tuple[np.ndarray, np.ndarray], np.ndarray]:
    """Merge samples of one cell and octant: positions (C, 3) and moments (C, 10) of the merged ones, and the one of each sample (S,).

    The moments are the sums over the area of the normal, of its products, and of 1.
    """
    cells = np.floor((positions - positions.min(axis=0)) / (CELL_FRACTION * radius)).astype(np.int64)
    keys = np.column_stack([cells, (normals >= 0.0) @ np.array([1, 2, 4])])
    representative = group_rows(keys)
    count = int(representative.max()) + 1
    x, y, z = normals.T
    columns = np.stack([x, y, z, x * x, y * y, z * z, x * y, y * z, z * x, np.ones(len(x))], axis=1) * areas[:, None]
    moments = np.stack([np.bincount(representative, column, count) for column in columns.T], axis=1)
    weighted = np.stack([np.bincount(representative, column, count) for column in (positions * areas[:, None]).T], axis=1)
    return (weighted / moments[:, -1:], moments), representative


def _blur(positions: np.ndarray, moments: np.ndarray, radius: float) -> np.ndarray:
    """Return the moments (C, 10) over the neighborhood of each of `positions` (C, 3), per weighted area."""
    first, second = cKDTree(positions).query_pairs(radius, output_type="ndarray").T
    offsets = positions[first] - positions[second]
    weights = 1.0 - np.einsum("pi,pi->p", offsets, offsets) / radius**2
    near = csr_array((weights, (first, second)), shape=(len(positions), len(positions)))
    blurred = moments + near @ moments + near.T @ moments
    return blurred / blurred[:, -1:]


def _choose_normals(own: np.ndarray, sums: np.ndarray) -> np.ndarray:
    """Return the normal (P, 3) of each neighborhood with moments `sums` (P, 10), see `normals_at_scale`."""
    total = np.maximum(sums[:, 9], TINY)
    means = sums[:, :3] / total[:, None]
    coherence = np.linalg.norm(means, axis=1)
    tensors = sums[:, [3, 6, 8, 6, 4, 7, 8, 7, 5]].reshape(-1, 3, 3) / total[:, None, None]
    eigenvalues, axes = np.linalg.eigh(tensors)
    axis = axes[:, :, 2]
    plates = axis * np.where(axis @ UP < 0.0, -1.0, 1.0)[:, None]
    is_plate = (coherence < MIN_COHERENCE) & (eigenvalues[:, 2] >= MIN_FLATNESS)
    chosen = np.where(is_plate[:, None], plates, means / np.maximum(coherence, TINY)[:, None])
    return np.where(((coherence < MIN_COHERENCE) & ~is_plate)[:, None], own, chosen)
