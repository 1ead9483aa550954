"""Vertices of a layout moved one by one, while their neighbours stay: the polygons around them, and where in these they belong."""

import numpy as np

from .rest_shapes import rest_shapes

HALVINGS = 30
SUFFICIENT = 1e-4  # of what the slope promises (Armijo)


class Polygons:
    """The polygons of a layout around N vertices, of which no two are neighbours, as P edges counter-clockwise, polygon by polygon.

    vertices: (V, 3) float64, on the surface. weights: as in StretchEnergy, but (V,) by vertex.
    """

    def __init__(self, layout: np.ndarray, owners: np.ndarray, stars: np.ndarray, vertices: np.ndarray, weights: np.ndarray) -> None:
        """owners: (N,), the vertices. stars: (N, S, 2), as `stars_of` gives them."""
        self.polygon, slot = np.nonzero(stars[:, :, 0] >= 0)
        self.edges = stars[self.polygon, slot]
        self._starts = np.searchsorted(self.polygon, np.arange(len(owners)))
        self.first, self.second = layout[self.edges[:, 0]], layout[self.edges[:, 1]]
        numbers = np.column_stack([owners[self.polygon], self.edges])
        self.corners = vertices[numbers]
        shapes = rest_shapes(self.corners)
        self._areas = shapes.areas
        self._weights = weights[numbers].mean(axis=1)
        gradients = shapes.gradients.transpose(2, 1, 0)
        self._own = gradients[:, 0]
        self._fixed = np.einsum("ei,ej->eij", self.first, gradients[:, 1]) + np.einsum("ei,ej->eij", self.second, gradients[:, 2])

    def relaxed(self, places: np.ndarray, steps: int) -> np.ndarray:
        """Places (N, 2) of less energy, by Newton steps of each vertex by itself."""
        value = self._value(places)
        for _ in range(steps):
            slope, bend = self._slope_and_bend(places)
            move = -_solved(bend, slope)
            promised = -np.einsum("ni,ni->n", slope, move)
            step = np.ones(len(places))
            for _ in range(HALVINGS):
                moved = places + step[:, None] * move
                reached = self._value(moved)
                worse = ~(reached <= value - SUFFICIENT * step * promised)
                if not worse.any():
                    break
                step[worse] *= 0.5
            better = reached < value
            places, value = np.where(better[:, None], moved, places), np.where(better, reached, value)
        return places

    def total(self, values: np.ndarray) -> np.ndarray:
        """Sums (N, ...) over each polygon of `values` (P, ...)."""
        return np.add.reduceat(values, self._starts)

    def doubled(self, places: np.ndarray) -> np.ndarray:
        """Twice the areas (P,) of the triangles from `places` (N, 2) to the edges."""
        first, second = self.first - places[self.polygon], self.second - places[self.polygon]
        return first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]

    def inward(self) -> np.ndarray:
        """Unit normals (P, 2) of the edges, to the left."""
        along = self.second - self.first
        normals = np.stack([-along[:, 1], along[:, 0]], axis=1)
        return normals / np.maximum(np.hypot(*along.T), 1e-300)[:, None]

    def room(self, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """How far (N,) the nearest line through an edge is from `places` (N, 2), below 0 on its outer side; which edge (N,) that is."""
        away = np.einsum("ei,ei->e", places[self.polygon] - self.first, self.inward())
        order = np.lexsort((away, self.polygon))
        nearest = order[self._starts]
        return away[nearest], nearest

    def _jacobians(self, places: np.ndarray) -> np.ndarray:
        return np.einsum("ei,ej->eij", places[self.polygon], self._own) + self._fixed

    def _value(self, places: np.ndarray) -> np.ndarray:
        """The energy (N,) of the triangles around each vertex; infinite where one is flipped."""
        jacobians = self._jacobians(places)
        area = jacobians[:, 0, 0] * jacobians[:, 1, 1] - jacobians[:, 0, 1] * jacobians[:, 1, 0]
        squares = np.einsum("eij,eij->e", jacobians, jacobians)
        upright = area > 0.0
        stretch = 0.5 * self._weights * squares / np.where(upright, area, 1.0) ** 2
        return self.total(np.where(upright, self._areas * (stretch + area), np.inf))

    def _slope_and_bend(self, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Slope (N, 2) and bend (N, 2, 2) of `_value` by the places."""
        jacobians = self._jacobians(places)
        (a, b), (c, d) = jacobians[:, 0].T, jacobians[:, 1].T
        area = (a * d - b * c)[:, None]
        squares = np.einsum("eij,eij->e", jacobians, jacobians)[:, None]
        across = np.stack([d * self._own[:, 0] - c * self._own[:, 1], a * self._own[:, 1] - b * self._own[:, 0]], axis=1)
        along = np.einsum("eij,ej->ei", jacobians, self._own)
        scale = (self._areas * self._weights)[:, None]
        slope = scale * (along / area**2 - squares * across / area**3) + self._areas[:, None] * across
        mixed = np.einsum("ei,ej->eij", along, across)
        length = np.einsum("ei,ei->e", self._own, self._own)[:, None, None]
        scale, area, squares = scale[:, :, None], area[:, :, None], squares[:, :, None]
        bend = length * np.eye(2) / area**2 - 2.0 * (mixed + mixed.transpose(0, 2, 1)) / area**3
        bend = scale * (bend + 3.0 * squares * np.einsum("ei,ej->eij", across, across) / area**4)
        return self.total(slope), self.total(bend)


def _solved(bend: np.ndarray, slope: np.ndarray) -> np.ndarray:
    """x (N, 2) with |bend| x = slope, where `bend` (N, 2, 2) has its eigenvalues made positive."""
    values, vectors = np.linalg.eigh(bend)
    values = np.maximum(np.abs(values), 1e-9 * np.abs(values).max(axis=1, keepdims=True) + 1e-300)
    return np.einsum("nij,nj->ni", vectors, np.einsum("nji,nj->ni", vectors, slope) / values)
