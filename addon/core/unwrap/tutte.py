"""A first layout without flipped triangles: the border on a convex outline, every vertex within at a weighted mean of its neighbours
(Tutte 1963; mean value weights, Floater 2003), made better by the reweighting of Yoshizawa, Belyaev and Seidel (2004)."""

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from .rest_shapes import rest_shapes
from .stretch_energy import stretches

ROUNDS = 10  # of reweighting, at most
SMALLEST = 1e-6  # of its size on the surface: what a triangle may come out as
LEAST_WEIGHT = 1e-6  # of the largest: mean value weights may vanish where a triangle has no area


def convex_layout(vertices: np.ndarray, triangles: np.ndarray, border: np.ndarray, outline: np.ndarray) -> np.ndarray | None:
    """A layout (V, 2) of a disk with its `border` (B,) at `outline` (B, 2), convex and counter-clockwise; None where parts of it come out
    too small for numbers to hold, such as long closed ends.

    vertices: (V, 3); those of no triangle stay at 0.
    """
    weights = _mean_values(vertices, triangles)
    shapes = rest_shapes(vertices[triangles])
    best, least = None, np.inf
    for _ in range(ROUNDS):
        layout = _solved(weights, border, outline)
        squared = np.full(len(triangles), np.inf) if layout is None else stretches(shapes, triangles, layout)
        stretch = float(shapes.areas @ squared)
        if not stretch < least or squared.max() > SMALLEST**-2:
            break
        best, least = layout, stretch
        around = np.bincount(triangles.ravel(), np.repeat(shapes.areas * squared, 3), len(vertices))
        area = np.bincount(triangles.ravel(), np.repeat(shapes.areas, 3), len(vertices))
        weights = weights @ sparse.diags_array(1.0 / np.sqrt(np.maximum(around, 1e-300) / np.maximum(area, 1e-300)))
    return best


def circle(lengths: np.ndarray) -> np.ndarray:
    """Places (B, 2) around a circle of area 1, counter-clockwise, as far from each other as `lengths` (B,) say."""
    angles = 2.0 * np.pi * _along(lengths)
    return np.stack([np.cos(angles), np.sin(angles)], axis=1) / np.sqrt(np.pi)


def square(lengths: np.ndarray, bulge: float) -> np.ndarray:
    """Places (B, 2) around a square of area 1, counter-clockwise; four of them are its corners, at those that come nearest to quarters.

    bulge: how far its sides are bent outwards in their middles, for triangles all of whose corners lie on one side.
    """
    along = _along(lengths)
    places = np.interp(along, np.append(along[_corners(along)], 1.0), np.arange(5.0))
    side, share = np.divmod(np.minimum(places, np.nextafter(4.0, 0.0)), 1.0)
    towards = np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]])
    begins = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    side = side.astype(int)
    outwards = 4.0 * bulge * share * (1.0 - share)
    return begins[side] + share[:, None] * towards[side] - outwards[:, None] * towards[(side + 1) % 4]


def _corners(along: np.ndarray) -> np.ndarray:
    """Four different places of `along` (B,), the first of them 0, near to 0, 1/4, 1/2 and 3/4. B is 4 or more."""
    found = [0]
    for quarter in (1, 2, 3):
        nearest = int(np.abs(along - 0.25 * quarter).argmin())
        found.append(min(max(nearest, found[-1] + 1), len(along) - (4 - quarter)))
    return np.array(found)


def _along(lengths: np.ndarray) -> np.ndarray:
    """Where around a loop its vertices are, from 0 to 1; those with no distance between them are given a little."""
    lengths = np.maximum(lengths, 1e-3 * lengths.mean()) if lengths.any() else np.ones(len(lengths))
    return np.concatenate([[0.0], np.cumsum(lengths)[:-1]]) / lengths.sum()


def _mean_values(vertices: np.ndarray, triangles: np.ndarray) -> sparse.csr_array:
    """Mean value weights (V, V): of each row's vertex for its neighbours, all above 0."""
    rows, columns, values = [], [], []
    for corner in range(3):
        own, first, second = (triangles[:, (corner + turn) % 3] for turn in range(3))
        along, up = vertices[first] - vertices[own], vertices[second] - vertices[own]
        near, far = (_lengths(each) for each in (along, up))
        sine = np.linalg.norm(np.cross(along, up), axis=1)
        half = sine / np.maximum(near * far + np.einsum("ti,ti->t", along, up), 1e-6 * near * far)
        rows += [own, own]
        columns += [first, second]
        values += [half / near, half / far]
    joined = np.concatenate(values)
    joined = np.maximum(joined, LEAST_WEIGHT * np.median(joined) or 1.0)
    return sparse.csr_array((joined, (np.concatenate(rows), np.concatenate(columns))), shape=(len(vertices),) * 2)


def _lengths(vectors: np.ndarray) -> np.ndarray:
    """Lengths (T,) of `vectors` (T, 3), above 0 in any case."""
    lengths = np.linalg.norm(vectors, axis=1)
    return np.maximum(lengths, 1e-6 * lengths.mean() or 1.0)


def _solved(weights: sparse.csr_array, border: np.ndarray, outline: np.ndarray) -> np.ndarray | None:
    """The layout (V, 2) in which all but the border are at the means of their neighbours by `weights` (V, V); None where these do not tell
    them apart."""
    layout = np.zeros((weights.shape[0], 2))
    layout[border] = outline
    totals = weights.sum(axis=1)
    inner = totals > 0.0
    inner[border] = False
    inner = np.flatnonzero(inner)
    if len(inner):
        means = sparse.diags_array(1.0 / totals[inner]) @ weights[inner]
        system = sparse.eye_array(len(inner), format="csc") - means[:, inner].tocsc()
        try:
            layout[inner] = splu(system.tocsc()).solve(means[:, border] @ outline)
        except RuntimeError:  # singular
            return None
    return layout
