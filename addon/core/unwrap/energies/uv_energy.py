"""The total energy of a UV map: stretch, and optionally barriers for the shape of triangles and for the boundary."""

from collections.abc import Callable

import numpy as np
from scipy import sparse

from .assembly import Assembly, assemble
from .boundary_barrier import BoundaryBarrier
from .shape_barrier import ShapeBarrier
from .stretch_energy import StretchEnergy


class UvEnergy:
    """Implements `newton.Energy`.

    assembly: of the triangles of `stretch`. boundary: None where the boundary is fixed. relax_worst_vertices: see `newton.Energy`.
    """

    def __init__(
        self,
        assembly: Assembly,
        stretch: StretchEnergy,
        shapes: list[ShapeBarrier],
        boundary: BoundaryBarrier | None,
        relax_worst_vertices: Callable[[np.ndarray], np.ndarray],
    ) -> None:
        self._assembly, self._stretch, self._shapes, self._boundary = assembly, stretch, shapes, boundary
        self.relax_worst_vertices = relax_worst_vertices

    def value(self, uv: np.ndarray) -> float:
        """Return the energy; infinite where triangles are flipped or too thin, or where the boundary intersects itself."""
        total = self._stretch.value(uv)
        for barrier in (*self._shapes, self._boundary):
            if barrier is not None and np.isfinite(total):
                total += barrier.value(uv)
        return total

    def lower_bound(self) -> float:
        """Return a lower bound of the energy of all uv."""
        return self._stretch.lower_bound()

    def max_step(self, uv: np.ndarray, displacement: np.ndarray) -> float:
        """Return the multiple of `displacement` (V, 2) at which a triangle has no area left, or the boundary touches itself."""
        max_step = self._stretch.max_step(uv, displacement)
        return max_step if self._boundary is None else min(max_step, self._boundary.max_step(uv, displacement))

    def gradient(self, uv: np.ndarray) -> np.ndarray:
        """Return the gradient (N,)."""
        by_triangle = self._stretch.gradients(uv)
        for shape in self._shapes:
            np.add.at(by_triangle, *shape.gradients(uv))
        gradient = self._assembly.gradient(by_triangle)
        if self._boundary is not None:
            vertices, gradients = self._boundary.gradients(uv)
            gradient += assemble(self._assembly.dof_indices(vertices), gradients, self._assembly.size)
        return gradient

    def hessian(self, uv: np.ndarray) -> sparse.csc_array:
        """Return the Hessian (N, N), positive semidefinite."""
        by_triangle = self._stretch.hessians(uv)
        for shape in self._shapes:
            np.add.at(by_triangle, *shape.hessians(uv))
        hessian = self._assembly.hessian(by_triangle)
        if self._boundary is not None:
            vertices, hessians = self._boundary.hessians(uv)
            hessian = hessian + assemble(self._assembly.dof_indices(vertices), hessians, self._assembly.size)
        return hessian

    def displacement(self, direction: np.ndarray) -> np.ndarray:
        """Return the displacement (V, 2) of all vertices from a `direction` (N,)."""
        return self._assembly.displacement(direction)
