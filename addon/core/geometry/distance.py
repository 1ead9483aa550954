"""Exact distance from points to a triangle mesh, with a tree of bounding boxes (AABB tree) that all points descend level by level."""

import numpy as np
from scipy.spatial import cKDTree

from ..arrays import concatenate_ranges
from ..jobs.chunks import slices

MAX_LEAF_TRIANGLES = 2
CHUNK_POINTS = 4096  # points or tests at once: fits the cache of a CPU core
MAX_PIECES = 400_000
FIRST_PIECES = 1000  # Triangles whose distances are measured first; those of most others need not be known exactly then.
MARGIN = 1e-12  # Of bounds, relative to the coordinates, for rounding.
MIN_SQUARED_SINE = 1e-14  # Corners below make a triangle a segment: dot products cannot resolve its plane.


def closest_on_mesh(points: np.ndarray, corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the distance of every point to the nearest triangle, and the index of that triangle.

    Args:
        points: (N, 3) float64, in the space and unit of `corners`.
        corners: (T, 3, 3) float64, T at least 1; triangles without area count as segments or points.

    Returns:
        Distances (N,) float64 and triangle indices (N,) int32. Of equally near triangles, an arbitrary one.
    """
    return TriangleTree(corners).find_closest(points)


class TriangleTree:
    """Triangles `corners` (T, 3, 3) for several searches like `closest_on_mesh`."""

    def __init__(self, corners: np.ndarray) -> None:
        self.corners = corners
        self._centroids = cKDTree(corners.mean(axis=1))
        self._order = self._centroids.indices
        self._levels = _build_boxes(corners, self._order)

    def find_closest(self, points: np.ndarray, enough: np.ndarray | float = 0.0) -> tuple[np.ndarray, np.ndarray]:
        """Return the distances (N,) of `points` (N, 3) and the indices (N,) of the nearest triangles, see `closest_on_mesh`.

        enough: distances, one or (N,), up to which a triangle is near enough: it need not be the nearest one then.
        """
        distances = np.empty(len(points))
        nearest = np.empty(len(points), np.int32)
        limits = np.broadcast_to(enough, len(points)) ** 2
        for chunk in _chunks(len(points)):
            distances[chunk], nearest[chunk] = self._descend(points[chunk], limits[chunk])
        return distances, nearest

    def find_near(self, points: np.ndarray, reach: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return all pairs of one of `points` (N, 3) and a triangle at most `reach` farther from it than the nearest one: the points (P,),
        ascending, the triangles (P,) and their distances (P,)."""
        pairs, margin = [], reach + MARGIN * np.abs(self.corners).max()
        for chunk in _chunks(len(points)):
            best, _ = _upper_bounds(points[chunk], self.corners, self._centroids)
            point, triangle, squared = self._search(points[chunk], np.arange(len(best)), (np.sqrt(best) + margin) ** 2)
            distances = np.sqrt(squared)
            starts = np.flatnonzero(np.diff(point, prepend=-1))
            is_near = distances <= (np.minimum.reduceat(distances, starts) + reach)[point]
            pairs.append((point[is_near] + chunk.start, triangle[is_near], distances[is_near]))
        return tuple(np.concatenate(values) for values in zip(*pairs, strict=True))

    def _descend(self, points: np.ndarray, limits: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return what `find_closest` does, for squared distances `limits` (N,) that are near enough."""
        best, nearest = _upper_bounds(points, self.corners, self._centroids)
        point, triangle, squared = self._search(points, np.flatnonzero(best > limits), best)
        if len(point):
            first = segment_argmin(squared, np.flatnonzero(np.diff(point, prepend=-1)))
            better = first[squared[first] < best[point[first]]]
            best[point[better]], nearest[point[better]] = squared[better], triangle[better]
        return np.sqrt(best), nearest.astype(np.int32)

    def _search(self, points: np.ndarray, point: np.ndarray, bounds: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return pairs of one of the points number `point` (K,), ascending, and a triangle, with their squared distances; among them are
        all within `bounds` (N,), squared."""
        node = np.zeros(len(point), np.int64)
        columns = np.ascontiguousarray(points.T)
        for level, (low, high) in enumerate(self._levels):
            if level > 0:
                point = np.repeat(point, 2)
                node = np.repeat(2 * node, 2)
                node[1::2] += 1
            is_candidate = _squared_box_distances(columns, point, low, high, node) <= bounds.take(point)
            point, node = point.compress(is_candidate), node.compress(is_candidate)
        starts = _node_starts(len(self.corners), len(self._levels) - 1)
        sizes = starts[node + 1] - starts[node]
        point = np.repeat(point, sizes)
        triangle = self._order[concatenate_ranges(starts[node], sizes)]
        return point, triangle, squared_point_triangle_distances(points[point], self.corners[triangle]) if len(point) else np.zeros(0)


def squared_point_triangle_distances(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Return the squared distance (N,) of each of `points` (N, 3) to the triangle `corners` (N, 3, 3) of the same row."""
    return np.concatenate([closest_on_triangles(points[chunk], corners[chunk])[0] for chunk in _chunks(len(points))])


def points_farther_than(points: np.ndarray, corners: np.ndarray, distance: float) -> np.ndarray:
    """Return the ascending indices (K,) of the `points` (N, 3) farther than `distance` from every triangle of `corners` (T, 3, 3)."""
    centroids = cKDTree(corners.mean(axis=1))
    squared = np.concatenate([_upper_bounds(points[chunk], corners, centroids)[0] for chunk in _chunks(len(points))])
    undecided = np.flatnonzero(squared > distance**2)
    return undecided[closest_on_mesh(points[undecided], corners)[0] > distance]


def _chunks(count: int) -> list[slice]:
    return slices(max(count, 1), CHUNK_POINTS)


def closest_barycentric(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Return barycentric coordinates (N, 3), none negative, of the closest point on each of `corners` (N, 3, 3) to its row of `points`."""
    _, b, c = closest_on_triangles(points, corners)
    return np.stack([1.0 - b - c, b, c], axis=1)


def closest_on_triangles(points: np.ndarray, corners: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the squared distance (N,) of each of `points` (N, 3) to its row of `corners` (N, 3, 3), and the barycentric coordinates (N,)
    of the closest point for the second and third corner.

    The closest point is found from dot products; its distance is then computed from the vector, without cancellation.
    """
    origin, *others = (np.ascontiguousarray(values.T) for values in (corners[:, 0], corners[:, 1], corners[:, 2], points))
    ab, ac, ap = (values - origin for values in others)
    bb, bc, cc, bp, cp = (_dot(first, second) for first, second in ((ab, ab), (ab, ac), (ac, ac), (ab, ap), (ac, ap)))
    opposite = bb + cc - 2.0 * bc
    zero = np.zeros(len(points))
    on_ab, on_ac = _segment_fraction(bp, bb), _segment_fraction(cp, cc)
    on_bc = _segment_fraction(cp - bp - bc + bb, opposite)
    best_b, best_c, best = on_ab, zero, on_ab * (on_ab * bb - 2.0 * bp)
    for b, c in ((zero, on_ac), (1.0 - on_bc, on_bc)):
        value = b * (b * bb + 2.0 * c * bc - 2.0 * bp) + c * (c * cc - 2.0 * cp)
        is_nearer = value < best
        best_b, best_c, best = np.where(is_nearer, b, best_b), np.where(is_nearer, c, best_c), np.where(is_nearer, value, best)
    area_squared = bb * cc - bc * bc
    scaled_b, scaled_c = cc * bp - bc * cp, bb * cp - bc * bp
    is_degenerate = area_squared <= MIN_SQUARED_SINE * bb * cc
    is_inside = (scaled_b >= 0.0) & (scaled_c >= 0.0) & (scaled_b + scaled_c <= area_squared) & ~is_degenerate
    scale = np.where(is_degenerate, 1.0, area_squared)
    best_b, best_c = np.where(is_inside, scaled_b / scale, best_b), np.where(is_inside, scaled_c / scale, best_c)
    offset = ap - best_b * ab - best_c * ac
    return _dot(offset, offset), best_b, best_c


def _dot(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return the dot products (N,) of vectors (3, N), column by column: NumPy reduces short axes slowly."""
    products = first[0] * second[0]
    products += first[2] * second[2]
    products += first[1] * second[1]
    return products


def _segment_fraction(dot: np.ndarray, length_squared: np.ndarray) -> np.ndarray:
    return np.clip(dot / np.where(length_squared > 0.0, length_squared, 1.0), 0.0, 1.0)


def segment_argmin(values: np.ndarray, starts: np.ndarray) -> np.ndarray:
    """Return the index (G,) of the first minimum of `values` (N,) in each of the segments that begin at `starts` (G,), ascending; no
    segment is empty."""
    segment = np.repeat(np.arange(len(starts)), np.diff(np.append(starts, len(values))))
    minima = np.flatnonzero(values == np.minimum.reduceat(values, starts)[segment])
    return minima[np.flatnonzero(np.diff(segment[minima], prepend=-1))]


def plane_barycentric(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Return barycentric coordinates (N, 3) of each point's projection onto the plane of its triangle: negative outside, all -1 for a
    triangle without area."""
    ab, ac, ap = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0], points - corners[:, 0]
    normal = np.cross(ab, ac)
    length_squared = np.einsum("ij,ij->i", normal, normal)
    scale = np.where(length_squared > 0.0, length_squared, 1.0)
    b = np.einsum("ij,ij->i", np.cross(ap, ac), normal) / scale
    c = np.einsum("ij,ij->i", np.cross(ab, ap), normal) / scale
    coordinates = np.stack([1.0 - b - c, b, c], axis=1)
    coordinates[length_squared == 0.0] = -1.0
    return coordinates


def bound_hausdorff(
    corners: np.ndarray, target: TriangleTree, tolerance: float, minimum: float = 0.0, max_pieces: int = MAX_PIECES, precision: float = 0.0
) -> tuple[float, float]:
    """Return bounds of the largest distance of any point of triangles (T, 3, 3) to those of `target`: one that a point has or `minimum` if
    that is more, and one that none exceeds.

    The distance to one triangle is convex, so over a whole face it is largest at a corner: this bounds a face from above, and its corners
    bound it from below. Faces whose bounds differ are subdivided until they agree up to `tolerance`, or up to the fraction `precision` of
    the distance if that is more, or until there would be more than `max_pieces`.
    """
    some = corners[:: max(len(corners) // FIRST_PIECES, 1)]
    largest, pieces = max(minimum, float(target.find_closest(some.mean(axis=1), minimum)[0].max(initial=0.0))), corners
    while True:
        margin = max(tolerance, precision * largest)
        lower, upper = _distance_bounds(pieces, target, largest + margin, margin)
        largest = max(largest, float(lower.max()))
        margin = max(tolerance, precision * largest)
        is_open = upper > largest + margin
        if not is_open.any():
            return largest, largest + margin
        if 4 * is_open.sum() > max_pieces:
            return largest, float(upper.max())
        pieces = _subdivide(pieces[is_open])


def faces_farther_than(corners: np.ndarray, target: np.ndarray, distance: float, tolerance: float) -> np.ndarray:
    """Return which of the triangles (T, 3, 3) have a point farther than `distance` from the triangles `target` (K, 3, 3): (T,) bool.

    None of them is missed. Triangles within `tolerance` of the distance may be included; so may any that are undecided when there are too
    many pieces, see `bound_hausdorff`.
    """
    is_farther = np.zeros(len(corners), bool)
    pieces, face, tree = corners, np.arange(len(corners)), TriangleTree(target)
    while len(pieces):
        lower, upper = _distance_bounds(pieces, tree, distance, tolerance)
        is_farther[face[lower > distance - tolerance]] = True
        is_open = (upper > distance) & ~is_farther[face]
        if 4 * is_open.sum() > MAX_PIECES:
            is_farther[face[is_open]] = True
            break
        pieces, face = _subdivide(pieces[is_open]), np.tile(face[is_open], 4)
    return is_farther


def _distance_bounds(pieces: np.ndarray, target: TriangleTree, threshold: float, tolerance: float) -> tuple[np.ndarray, np.ndarray]:
    """Return lower and upper bounds (P,) of the largest distance of any point of each of `pieces` (P, 3, 3); loose below `threshold`: up to
    `threshold` - `tolerance`, lower bounds are 0."""
    enough = max(threshold - tolerance, 0.0)
    lower, nearest = target.find_closest(pieces.mean(axis=1), enough)
    # The triangle nearest to the centroid decides most faces; only the others need those nearest to their corners.
    upper = _max_corner_distances(pieces, target.corners[nearest])
    undecided = np.flatnonzero(upper > threshold)
    if len(undecided):
        distances, nearest = target.find_closest(pieces[undecided].reshape(-1, 3), enough)
        lower[undecided] = np.maximum(lower[undecided], distances.reshape(-1, 3).max(axis=1))
        for candidates in nearest.reshape(-1, 3).T:
            upper[undecided] = np.minimum(upper[undecided], _max_corner_distances(pieces[undecided], target.corners[candidates]))
    lower[lower <= enough] = 0.0
    return lower, upper


def _max_corner_distances(pieces: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Return the largest distance (P,) of the corners of each of `pieces` (P, 3, 3) to the triangle (P, 3, 3) of the same row."""
    squared = squared_point_triangle_distances(pieces.reshape(-1, 3), np.repeat(triangles, 3, axis=0))
    return np.sqrt(squared.reshape(-1, 3).max(axis=1))


def _subdivide(corners: np.ndarray) -> np.ndarray:
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    ab, bc, ca = 0.5 * (a + b), 0.5 * (b + c), 0.5 * (c + a)
    return np.concatenate([np.stack(piece, axis=1) for piece in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))])


def _build_boxes(corners: np.ndarray, order: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return the boxes (3, 2^l) low and high of every level l. Node k of 2^l contains the triangles number k T / 2^l to (k + 1) T / 2^l in
    `order` (T,), in which those that are near each other follow each other, as in the halves of a k-d tree."""
    count = len(corners)
    depth = max(0, int(np.log2(count / MAX_LEAF_TRIANGLES))) if count > MAX_LEAF_TRIANGLES else 0
    starts = _node_starts(count, depth)[:-1]
    first, second, third = (np.ascontiguousarray(corners[order, corner].T) for corner in range(3))  # NumPy reduces short axes slowly
    levels = [tuple(bound.reduceat(bound(bound(first, second), third), starts, axis=1) for bound in (np.minimum, np.maximum))]
    for _ in range(depth):
        low, high = levels[-1]
        levels.append((np.minimum(low[:, ::2], low[:, 1::2]), np.maximum(high[:, ::2], high[:, 1::2])))
    return levels[::-1]


def _node_starts(count: int, level: int) -> np.ndarray:
    """Return where the nodes of one level start in the order (2^level + 1,), the end included; the next level bisects them."""
    return (np.arange(2**level + 1, dtype=np.int64) * count) >> level


def _upper_bounds(points, corners, centroids) -> tuple[np.ndarray, np.ndarray]:
    """Return squared distances (N,) and indices (N,) of the best of the few triangles with the nearest centroids."""
    count = min(3, len(corners))
    _, triangles = centroids.query(points, k=count)
    triangles = np.asarray(triangles).reshape(len(points), count)
    repeated = np.repeat(points, count, axis=0)
    squared = squared_point_triangle_distances(repeated, corners[triangles.ravel()]).reshape(len(points), count)
    best = squared.argmin(axis=1)
    rows = np.arange(len(points))
    return squared[rows, best], triangles[rows, best]


def _squared_box_distances(points: np.ndarray, point: np.ndarray, low: np.ndarray, high: np.ndarray, node: np.ndarray) -> np.ndarray:
    """Return the squared distances (K,) of `points` (3, N) number `point` (K,) to the boxes `low`, `high` (3, B) number `node` (K,)."""
    squared = np.zeros(len(point))
    for coordinates, lowest, highest in zip(points, low, high, strict=True):
        positions = coordinates.take(point)
        outside = np.maximum(lowest.take(node) - positions, positions - highest.take(node))
        np.maximum(outside, 0.0, out=outside)
        outside *= outside
        squared += outside
    return squared
