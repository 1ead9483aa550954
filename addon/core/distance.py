"""Exact distance from points to a triangle mesh: a hierarchy of boxes, descended a level at a time by all points at once."""

import numpy as np
from scipy.spatial import cKDTree

LEAF_TRIANGLES = 4
CHUNK_POINTS = 4096  # of closest points and of tests at once: what stays in a core's cache
MAX_PIECES = 400_000
SLIVER = 1e-14  # squared sine of a corner below which a triangle is a segment: dot products could not tell its plane


def closest_on_mesh(points: np.ndarray, corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distance of every point to the nearest triangle, and which one that is.

    Args:
        points: (N, 3) float64, in the space and unit of `corners`.
        corners: (T, 3, 3) float64, T at least 1; triangles without area count as segments or points.

    Returns:
        Distances (N,) float64 and triangle indices (N,) int32. Of triangles equally near, any one.
    """
    levels, order = _box_hierarchy(corners)
    centroids = cKDTree(corners.mean(axis=1))
    distances = np.empty(len(points))
    nearest = np.empty(len(points), np.int32)
    for chunk in _chunks(len(points)):
        distances[chunk], nearest[chunk] = _descend(points[chunk], corners, levels, order, centroids)
    return distances, nearest


def point_triangle_distances(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Squared distance (N,) of each of `points` (N, 3) to the triangle `corners` (N, 3, 3) of the same row."""
    return np.concatenate([closest_points(points[rows], corners[rows])[0] for rows in _chunks(len(points))])


def points_beyond(points: np.ndarray, corners: np.ndarray, distance: float) -> np.ndarray:
    """Indices (K,) of the `points` (N, 3) that are farther than `distance` from every triangle of `corners` (T, 3, 3), ascending."""
    centroids = cKDTree(corners.mean(axis=1))
    squared = np.concatenate([_first_guess(points[rows], corners, centroids)[0] for rows in _chunks(len(points))])
    unsure = np.flatnonzero(squared > distance**2)
    return unsure[closest_on_mesh(points[unsure], corners)[0] > distance]


def _chunks(count: int) -> list[slice]:
    return [slice(start, start + CHUNK_POINTS) for start in range(0, max(count, 1), CHUNK_POINTS)]


def closest_weights(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Barycentric weights (N, 3), none below zero, of the point of each of `corners` (N, 3, 3) closest to its row of `points` (N, 3)."""
    _, along_b, along_c = closest_points(points, corners)
    return np.stack([1.0 - along_b - along_c, along_b, along_c], axis=1)


def closest_points(points: np.ndarray, corners: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Squared distance (N,) of each of `points` (N, 3) to its row of `corners` (N, 3, 3), and the weights (N,) of the second and third
    corner at the closest point.

    Which point is closest is told from dot products alone; its distance is then taken from the vector, where nothing cancels.
    """
    ab, ac, ap = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0], points - corners[:, 0]
    bb, bc, cc, bp, cp = (np.einsum("ij,ij->i", first, second) for first, second in ((ab, ab), (ab, ac), (ac, ac), (ab, ap), (ac, ap)))
    opposite = bb + cc - 2.0 * bc
    zero = np.zeros(len(points))
    on_ab, on_ac = _share(bp, bb), _share(cp, cc)
    on_bc = _share(cp - bp - bc + bb, opposite)
    best_b, best_c, best = on_ab, zero, on_ab * (on_ab * bb - 2.0 * bp)
    for along_b, along_c in ((zero, on_ac), (1.0 - on_bc, on_bc)):
        value = along_b * (along_b * bb + 2.0 * along_c * bc - 2.0 * bp) + along_c * (along_c * cc - 2.0 * cp)
        nearer = value < best
        best_b, best_c, best = np.where(nearer, along_b, best_b), np.where(nearer, along_c, best_c), np.where(nearer, value, best)
    area_squared = bb * cc - bc * bc
    over_b, over_c = cc * bp - bc * cp, bb * cp - bc * bp
    flat = area_squared <= SLIVER * bb * cc
    inside = (over_b >= 0.0) & (over_c >= 0.0) & (over_b + over_c <= area_squared) & ~flat
    scale = np.where(flat, 1.0, area_squared)
    best_b, best_c = np.where(inside, over_b / scale, best_b), np.where(inside, over_c / scale, best_c)
    rest = ap - best_b[:, None] * ab - best_c[:, None] * ac
    return np.einsum("ij,ij->i", rest, rest), best_b, best_c


def _share(along: np.ndarray, length_squared: np.ndarray) -> np.ndarray:
    return np.clip(along / np.where(length_squared > 0.0, length_squared, 1.0), 0.0, 1.0)


def first_least(values: np.ndarray, starts: np.ndarray) -> np.ndarray:
    """Index (G,) of the first least of `values` (N,) in each of the ranges that begin at `starts` (G,), ascending; none is empty."""
    group = np.repeat(np.arange(len(starts)), np.diff(np.append(starts, len(values))))
    least = np.flatnonzero(values == np.minimum.reduceat(values, starts)[group])
    return least[np.flatnonzero(np.diff(group[least], prepend=-1))]


def plane_weights(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Barycentric weights (N, 3) of each point's foot on the plane of its triangle; below zero outside, -1 all over where no area is."""
    ab, ac, ap = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0], points - corners[:, 0]
    normal = np.cross(ab, ac)
    length_squared = np.einsum("ij,ij->i", normal, normal)
    scale = np.where(length_squared > 0.0, length_squared, 1.0)
    along_b = np.einsum("ij,ij->i", np.cross(ap, ac), normal) / scale
    along_c = np.einsum("ij,ij->i", np.cross(ab, ap), normal) / scale
    weights = np.stack([1.0 - along_b - along_c, along_b, along_c], axis=1)
    weights[length_squared == 0.0] = -1.0
    return weights


def one_sided_distance(corners: np.ndarray, target: np.ndarray, tolerance: float, least: float = 0.0) -> float:
    """Largest distance of any point of triangles (T, 3, 3) to the triangles `target` (K, 3, 3), too large by `tolerance` at most.

    The distance to one triangle is convex, so over a whole face it is largest at a corner: that bounds a face from above, and its corners
    bound it from below. Faces for which the bounds differ are cut in four until they do not, or until there are too many pieces: then the
    result is still a bound, but a looser one. Below `least` nothing is told apart, and the result is not less than that.
    """
    largest, pieces = least, corners
    while True:
        below, above = _distance_bounds(pieces, target, largest + tolerance)
        largest = max(largest, float(below.max()))
        still_open = above > largest + tolerance
        if not still_open.any():
            return largest + tolerance
        if 4 * still_open.sum() > MAX_PIECES:
            return float(above.max())
        pieces = _cut_in_four(pieces[still_open])


def faces_beyond(corners: np.ndarray, target: np.ndarray, distance: float, tolerance: float) -> np.ndarray:
    """Which of the triangles (T, 3, 3) have a point farther than `distance` from the triangles `target` (K, 3, 3): (T,) bool.

    None of them is missed. One that comes within `tolerance` of the distance may be named as well; and so may any that is still open when
    there are too many pieces, see `one_sided_distance`.
    """
    beyond = np.zeros(len(corners), bool)
    pieces, face = corners, np.arange(len(corners))
    while len(pieces):
        below, above = _distance_bounds(pieces, target, distance)
        beyond[face[below > distance - tolerance]] = True
        still_open = (above > distance) & ~beyond[face]
        if 4 * still_open.sum() > MAX_PIECES:
            beyond[face[still_open]] = True
            break
        pieces, face = _cut_in_four(pieces[still_open]), np.tile(face[still_open], 4)
    return beyond


def _distance_bounds(pieces: np.ndarray, target: np.ndarray, enough: float) -> tuple[np.ndarray, np.ndarray]:
    """Bounds (P,) from below and above of the largest distance of any point of each of `pieces` (P, 3, 3); loose where below `enough`."""
    below, nearest = closest_on_mesh(pieces.mean(axis=1), target)
    # The triangle nearest to the middle settles most faces; only the others ask for those nearest to their corners.
    above = _farthest_corner(pieces, target[nearest])
    unsure = np.flatnonzero(above > enough)
    if len(unsure):
        distances, nearest = closest_on_mesh(pieces[unsure].reshape(-1, 3), target)
        below[unsure] = np.maximum(below[unsure], distances.reshape(-1, 3).max(axis=1))
        for choice in nearest.reshape(-1, 3).T:
            above[unsure] = np.minimum(above[unsure], _farthest_corner(pieces[unsure], target[choice]))
    return below, above


def _farthest_corner(pieces: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Largest distance (P,) of the corners of each of `pieces` (P, 3, 3) to the triangle (P, 3, 3) of the same row."""
    squared = point_triangle_distances(pieces.reshape(-1, 3), np.repeat(triangles, 3, axis=0))
    return np.sqrt(squared.reshape(-1, 3).max(axis=1))


def _cut_in_four(corners: np.ndarray) -> np.ndarray:
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    ab, bc, ca = 0.5 * (a + b), 0.5 * (b + c), 0.5 * (c + a)
    return np.concatenate([np.stack(piece, axis=1) for piece in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))])


def _box_hierarchy(corners: np.ndarray) -> tuple[list[tuple[np.ndarray, np.ndarray]], np.ndarray]:
    """Boxes (2^l, 3) low and high of every level l, and the order (T,); node k of 2^l holds its positions k T / 2^l to (k + 1) T / 2^l."""
    count = len(corners)
    depth = max(0, int(np.log2(count / LEAF_TRIANGLES))) if count > LEAF_TRIANGLES else 0
    low, high, centers = corners.min(axis=1), corners.max(axis=1), corners.mean(axis=1)
    order = np.arange(count)
    for level in range(depth):
        starts = _starts(count, level)
        node = np.repeat(np.arange(2**level), np.diff(starts))
        ordered = centers[order]
        extent = np.maximum.reduceat(ordered, starts[:-1]) - np.minimum.reduceat(ordered, starts[:-1])
        widest = extent.argmax(axis=1)[node]
        order = order[np.lexsort((ordered[np.arange(count), widest], node))]
    levels = []
    for level in range(depth + 1):
        starts = _starts(count, level)[:-1]
        levels.append((np.minimum.reduceat(low[order], starts), np.maximum.reduceat(high[order], starts)))
    return levels, order


def _starts(count: int, level: int) -> np.ndarray:
    """(2^level + 1,) first positions of the nodes of one level; those of the next level lie between them."""
    return (np.arange(2**level + 1, dtype=np.int64) * count) >> level


def _descend(points, corners, levels, order, centroids) -> tuple[np.ndarray, np.ndarray]:
    best, nearest = _first_guess(points, corners, centroids)
    point = np.arange(len(points))
    node = np.zeros(len(points), np.int64)
    for level, (low, high) in enumerate(levels):
        if level > 0:
            point = np.repeat(point, 2)
            node = np.stack([2 * node, 2 * node + 1], axis=1).ravel()
        near = _box_squared(points[point], low[node], high[node]) < best[point]
        point, node = point[near], node[near]
    starts = _starts(len(corners), len(levels) - 1)
    sizes = starts[node + 1] - starts[node]
    point = np.repeat(point, sizes)
    within = np.arange(len(point)) - np.repeat(np.cumsum(sizes) - sizes, sizes)
    triangle = order[np.repeat(starts[node], sizes) + within]
    if len(point):
        squared = point_triangle_distances(points[point], corners[triangle])
        first = first_least(squared, np.flatnonzero(np.diff(point, prepend=-1)))
        better = first[squared[first] < best[point[first]]]
        best[point[better]], nearest[point[better]] = squared[better], triangle[better]
    return np.sqrt(best), nearest.astype(np.int32)


def _first_guess(points, corners, centroids) -> tuple[np.ndarray, np.ndarray]:
    """Squared distances (N,) and indices (N,) of the best of the few triangles whose centroids are nearest: bounds from above."""
    candidates = min(3, len(corners))
    _, triangles = centroids.query(points, k=candidates)
    triangles = np.asarray(triangles).reshape(len(points), candidates)
    repeated = np.repeat(points, candidates, axis=0)
    squared = point_triangle_distances(repeated, corners[triangles.ravel()]).reshape(len(points), candidates)
    chosen = squared.argmin(axis=1)
    rows = np.arange(len(points))
    return squared[rows, chosen], triangles[rows, chosen]


def _box_squared(points: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    outside = np.maximum(np.maximum(low - points, points - high), 0.0)
    return np.einsum("ij,ij->i", outside, outside)
