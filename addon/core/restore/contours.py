"""Contours that a hole interrupts: ends of edges at its boundary are matched in pairs and joined by smooth curves.

Two ends belong together if a curve of little bending joins them, with similar colors on both sides: tangents and colors across the hole, as
in Masnou and Morel, "Level Lines Based Disocclusion", 1998.
"""

from typing import NamedTuple

import numpy as np
from scipy.ndimage import distance_transform_edt, gaussian_filter, map_coordinates

from ..imaging.edges import find_edges

SIGMA = 1.5  # pixels
WEAK, STRONG = 0.008, 0.02  # gradients of edges, per pixel
NEAREST, FARTHEST = 2.5, 18.0  # pixels from the hole between which edges are followed
SEED_RANGE = 2.0  # pixels behind the nearest ones from which edges are followed
MIN_FACING = 0.2  # cosine between an edge and the direction to the hole
MIN_LENGTH = 8  # pixels of an edge
MAX_OFFSET = 1.5  # pixels between an edge and its parabola
MIN_FITTED = 0.6  # fraction of the pixels that fit
SIDE = 2.5  # pixels from an edge to the colors on both sides
MIN_CONTRAST = 0.04  # between the sides
MIN_CLARITY = 1.5  # contrast between the sides, relative to the deviation along each
MAX_COST = 1.0
MAX_TURN = 2.6  # radians
MIN_CHORD = 2.0  # pixels
TURN_WEIGHT, SPIRAL_WEIGHT, CURVATURE_WEIGHT = 0.1, 0.6, 0.15  # weights of squared angles, relative to the difference of colors
MAX_CURVATURE_TERM = 4.0
MIN_INSIDE = 0.7  # fraction of a curve that is in the hole
STEPS = 4  # samples of a curve per pixel


class End(NamedTuple):
    """The end of an edge at a hole.

    Attributes:
        point: (2,) row and column.
        tangent: (2,) unit, into the hole.
        curvature: in radians per pixel, positive from the first axis to the second.
        colors: (2, C) on the side of the normal (-tangent[1], tangent[0]), and on the other one.
    """

    point: np.ndarray
    tangent: np.ndarray
    curvature: float
    colors: np.ndarray


def join_contours(image: np.ndarray, hole: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Return the pixels (H, W) bool of curves that join contours of `image` (H, W, C) across the `hole` (H, W) bool.

    known: (H, W) bool, pixels that are not missing. The missing ones of `image` are filled smoothly.
    """
    ends = _find_ends(image, hole, known)
    costs = {(i, j): cost for i in range(len(ends)) for j in range(i) if (cost := _compare(ends[i], ends[j])) <= MAX_COST}
    curves, is_joined = np.zeros(hole.shape, bool), np.zeros(len(ends), bool)
    for first, second in sorted(costs, key=costs.get):
        points = np.rint(_draw(ends[first], ends[second])).astype(int)
        points = points[((points >= 0) & (points < hole.shape)).all(axis=1)]
        rows, columns = points.T
        inside = np.count_nonzero(hole[rows, columns])
        if is_joined[first] or is_joined[second] or curves[rows, columns].any() or inside < MIN_INSIDE * len(points) - 4 * NEAREST * STEPS:
            continue
        is_joined[[first, second]] = True
        curves[rows, columns] = True
    return curves


def _find_ends(image: np.ndarray, hole: np.ndarray, known: np.ndarray) -> list[End]:
    """Find the edges that reach the hole, by their pixels at some distance from it."""
    distance = distance_transform_edt(~hole)
    nearest = distance_transform_edt(~known, return_distances=False, return_indices=True)
    colors = image[..., :3][tuple(nearest)]  # A smooth fill would distort edges near the hole.
    edges, gradient = _find_color_edges(colors)
    is_near = edges & (distance >= NEAREST) & (distance <= FARTHEST) & (distance_transform_edt(known) >= NEAREST)
    points, distances = np.argwhere(is_near), distance[is_near]
    normals = gradient[is_near] / np.maximum(np.linalg.norm(gradient[is_near], axis=1), 1e-12)[:, None]
    inward = -np.stack(np.gradient(distance), axis=-1)[is_near]
    tangents = np.stack([-normals[:, 1], normals[:, 0]], axis=1)
    facing = np.einsum("pi,pi->p", tangents, inward)
    tangents *= np.where(facing < 0.0, -1.0, 1.0)[:, None]
    smooth = gaussian_filter(colors, (0.7, 0.7, 0.0))
    ends, is_used = [], np.zeros(len(points), bool)
    for seed in np.argsort(distances, kind="stable"):
        if distances[seed] > NEAREST + SEED_RANGE:
            break
        if is_used[seed] or abs(facing[seed]) < MIN_FACING:
            continue
        offsets = points - points[seed]
        along, across = -offsets @ tangents[seed], np.abs(offsets @ normals[seed])
        belongs = (along >= -1.5) & (along <= FARTHEST) & (across <= 1.5 + 0.3 * np.maximum(along, 0.0)) & (normals @ normals[seed] > 0.7)
        is_used |= belongs & (distances <= NEAREST + SEED_RANGE)
        end = _measure(points[belongs][np.argsort(along[belongs], kind="stable")], smooth, distance)
        if end is not None:
            ends.append(end)
    return ends


def _find_color_edges(colors: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the edges (H, W) bool of lightness and of differences of `colors` (H, W, C), and their gradients (H, W, 2)."""
    values = [colors.mean(axis=2)]
    if colors.shape[2] == 3:
        values += [colors[..., 0] - colors[..., 1], colors[..., 2] - colors[..., 1]]
    edges, strongest, gradient = np.zeros(colors.shape[:2], bool), np.zeros(colors.shape[:2]), np.zeros((*colors.shape[:2], 2))
    for each in values:
        found, rise = find_edges(each, SIGMA, WEAK, STRONG)
        magnitude = np.linalg.norm(rise, axis=-1)
        is_better = found & (magnitude > strongest)
        edges |= found
        strongest[is_better], gradient[is_better] = magnitude[is_better], rise[is_better]
    return edges, gradient


def _measure(points: np.ndarray, colors: np.ndarray, distance: np.ndarray) -> End | None:
    """Fit a parabola to the `points` (K, 2) of an edge, sorted from the hole outward, and measure the `colors` on its sides. Returns None
    if the edge is not clear."""
    if len(points) < MIN_LENGTH:
        return None
    center = points.mean(axis=0)
    along = np.linalg.svd(points - center, full_matrices=False)[2][0]
    along = along if (points[0] - center) @ along > 0.0 else -along
    normal = np.array([-along[1], along[0]])
    x, y = (points - center) @ along, (points - center) @ normal
    parabola = _fit_parabola(x, y) if np.ptp(x) >= MIN_LENGTH - 2 else None
    if parabola is None:
        return None
    samples = np.linspace(x.min(), x.max(), len(points))
    heights, rises = np.polyval(parabola, samples), np.polyval(np.polyder(parabola), samples)
    line = center + samples[:, None] * along + heights[:, None] * normal
    tangents = along + rises[:, None] * normal
    tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
    across = np.stack([-tangents[:, 1], tangents[:, 0]], axis=1)
    sides, spreads = [], []
    for sign in (1.0, -1.0):
        at = (line + sign * SIDE * across).T
        is_known = map_coordinates(distance, at, order=0, mode="nearest") > 1.0
        if is_known.sum() < MIN_LENGTH // 2:
            return None
        taken = np.stack(
            [map_coordinates(channel, at[:, is_known], order=1, mode="nearest") for channel in np.moveaxis(colors, 2, 0)], axis=1
        )
        sides.append(np.median(taken, axis=0))
        spreads.append(np.abs(taken - sides[-1]).mean(axis=0))
    if np.linalg.norm(sides[0] - sides[1]) < max(MIN_CONTRAST, MIN_CLARITY * np.linalg.norm(spreads[0] + spreads[1])):
        return None
    return End(line[-1], tangents[-1], float(2.0 * parabola[0] / (1.0 + rises[-1] ** 2) ** 1.5), np.array(sides))


def _fit_parabola(x: np.ndarray, y: np.ndarray) -> np.ndarray | None:
    """Return the coefficients (3,) of the parabola through most of the points, or None if it misses too many."""
    is_near = np.ones(len(x), bool)
    for _ in range(3):
        if is_near.sum() < MIN_LENGTH or is_near.mean() < MIN_FITTED:
            return None
        parabola = np.polyfit(x[is_near], y[is_near], 2 if np.ptp(x[is_near]) > MIN_LENGTH else 1)
        distances = np.abs(np.polyval(parabola, x) - y)
        is_near = distances < max(MAX_OFFSET, 1.5 * float(np.median(distances)))
    return np.pad(parabola, (3 - len(parabola), 0)) if np.median(distances) < 0.5 * MAX_OFFSET else None


def _compare(first: End, second: End) -> float:
    """Return the cost of joining two ends, infinite where no smooth curve joins them."""
    chord = second.point - first.point
    length = float(np.linalg.norm(chord))
    start, stop = _chord_angles(first, second)
    if length < MIN_CHORD or max(abs(start), abs(stop)) > 0.5 * MAX_TURN:
        return np.inf
    contrast = 0.5 * sum(float(np.linalg.norm(end.colors[0] - end.colors[1])) for end in (first, second))
    difference = 0.5 * float(np.linalg.norm(first.colors - second.colors[::-1], axis=1).sum())
    turn, expected = start + stop, 0.5 * (first.curvature - second.curvature) * length
    spiral, curvature = (start - stop) ** 2, min((turn - expected) ** 2, MAX_CURVATURE_TERM)
    return difference / contrast + TURN_WEIGHT * turn**2 + SPIRAL_WEIGHT * spiral + CURVATURE_WEIGHT * curvature


def _chord_angles(first: End, second: End) -> tuple[float, float]:
    """Return the signed angles from the tangent of the first end to the chord, and from there to the tangent that leaves the hole."""
    chord = second.point - first.point
    return _angle(chord, first.tangent), _angle(-second.tangent, chord)


def _angle(to: np.ndarray, since: np.ndarray) -> float:
    """Return the signed angle from `since` (2,) to `to` (2,)."""
    return float(np.arctan2(since[0] * to[1] - since[1] * to[0], since @ to))


def _draw(first: End, second: End) -> np.ndarray:
    """Return the points (N, 2) of a cubic Bezier curve, close to an arc where both ends are at one angle to the chord."""
    length = float(np.linalg.norm(second.point - first.point))
    angle = max(abs(sum(_chord_angles(first, second))), 1e-3)
    handle = 4.0 / 3.0 * np.tan(0.25 * angle) * length / (2.0 * np.sin(min(0.5 * angle, 0.5 * np.pi)))
    points = np.array([first.point, first.point + handle * first.tangent, second.point + handle * second.tangent, second.point])
    t = np.linspace(0.0, 1.0, int(STEPS * 1.6 * length) + 2)[:, None]
    weights = np.concatenate([(1.0 - t) ** 3, 3.0 * t * (1.0 - t) ** 2, 3.0 * t**2 * (1.0 - t), t**3], axis=1)
    return weights @ points
