"""Divides the minimization on a level into subproblems: all vertices at once, or patches of a large level one after the other.

The time and memory to factorize the Hessian of all vertices of a large level would grow out of proportion. Coarser levels have already
moved distant parts into place.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ..energies.boundary_barrier import BoundaryBarrier
from ..energies.rest_shapes import RestShapes
from ..energies.shape_barrier import ShapeBarrier, min_height_to_base
from ..energies.stretch_energy import Expansion, StretchEnergy
from ..energies.uv_energy import Assembly, UvEnergy
from .relaxation import relax_worst_vertices

MAX_DIRECT_VERTICES = 20_000  # Levels with more are divided into patches.
MAX_PATCH_VERTICES = 8_000
ODD_SWEEP_SPLIT = 0.36  # Fraction of the vertices in the first cut of every other sweep, so that patch boundaries differ.
UPDATE_RINGS = 8  # So many rings of triangles around changed ones are updated with them.
FLOOR_FRACTION = 0.95  # A triangle below the quality limit may not fall below this fraction of its ratio in a subproblem.


@dataclass(frozen=True)
class LevelTriangles:
    """Triangles of a level of a chart, with what their energy depends on.

    Attributes:
        vertices: (V, 3) float64, on the surface.
        triangles: (T, 3) int32, indices into `vertices`.
        shapes: Rest shapes of the triangles.
        weights: (T,) importance of the triangles.
        vertex_weights: (V,) the same, per vertex.
        boundary: (B, 2) edges.
        is_free: (V,) bool, vertices that may move.
        activation_distance: Distance in the UV map at which the boundary barrier sets in.
        expansion: How expansion counts in the energy.
    """

    vertices: np.ndarray
    triangles: np.ndarray
    shapes: RestShapes
    weights: np.ndarray
    vertex_weights: np.ndarray
    boundary: np.ndarray
    is_free: np.ndarray
    activation_distance: float
    expansion: Expansion


class MultigridLevel(LevelTriangles):
    """A level with all its triangles. Its vertices are those of the whole chart."""

    def subproblems(self, uv: np.ndarray, sweep: int, is_changed: np.ndarray) -> Iterator[tuple[float, "Subproblem | None"]]:
        """Yield the subproblems to solve where the energy has changed, each with the fraction of the level that was done before.

        A small level has one: the surroundings of the changed triangles. A large level has its patches with changed triangles. None is
        yielded for each step towards the first patch.

        Args:
            uv: (V, 2).
            sweep: odd and even sweeps have different patch boundaries.
            is_changed: (T,) bool.
        """
        free = np.flatnonzero(self.is_free)
        if len(free) <= MAX_DIRECT_VERTICES:
            is_active = self.is_free & self._surroundings(is_changed)
            if is_active.any():
                yield 0.0, self._subproblem(is_active, np.flatnonzero(is_active[self.triangles].any(axis=1)))
            return
        patches = []
        for patch in _divide_into_patches(uv[free], ODD_SWEEP_SPLIT if sweep % 2 else 0.5):
            patches.append(patch)
            yield 0.0, None
        owner = np.full(len(self.is_free), -1)
        for index, patch in enumerate(patches):
            owner[free[patch]] = index
        owners = owner[self.triangles].ravel()
        corners = np.argsort(owners, kind="stable")
        starts = np.searchsorted(owners[corners], np.arange(len(patches) + 1))
        yield 0.0, None
        for index in range(len(patches)):
            triangle_indices = np.unique(corners[starts[index] : starts[index + 1]] // 3)
            if is_changed[triangle_indices].any():
                yield index / len(patches), self._subproblem(owner == index, triangle_indices)

    def _surroundings(self, is_changed: np.ndarray) -> np.ndarray:
        """Return the vertices (V,) bool within `UPDATE_RINGS` of the changed triangles (T,) bool."""
        is_near = np.zeros(len(self.is_free), bool)
        is_near[self.triangles[is_changed]] = True
        for _ in range(UPDATE_RINGS if not is_changed.all() else 0):
            is_near[self.triangles[is_near[self.triangles].any(axis=1)]] = True
        return is_near

    def _subproblem(self, is_free: np.ndarray, triangle_indices: np.ndarray) -> "Subproblem":
        """Return the subproblem of the triangles at the vertices `is_free` (V,) bool, `triangle_indices` (K,)."""
        boundary = self.boundary if is_free[self.boundary].any() else self.boundary[:0]
        is_used = np.zeros(len(is_free), bool)
        is_used[self.triangles[triangle_indices]] = True
        is_used[boundary] = True
        vertex_indices = np.flatnonzero(is_used)
        new_index = np.cumsum(is_used) - 1
        is_relaxation_fixed = ~is_free
        is_relaxation_fixed[self.boundary] = True
        return Subproblem(
            vertex_indices=vertex_indices,
            triangle_indices=triangle_indices,
            vertices=self.vertices[vertex_indices],
            triangles=new_index[self.triangles[triangle_indices]].astype(np.int32),
            shapes=RestShapes(self.shapes.areas[triangle_indices], np.ascontiguousarray(self.shapes.gradients[:, :, triangle_indices])),
            weights=self.weights[triangle_indices],
            vertex_weights=self.vertex_weights[vertex_indices],
            boundary=new_index[boundary],
            is_free=is_free[vertex_indices],
            is_relaxation_fixed=is_relaxation_fixed[vertex_indices],
            activation_distance=self.activation_distance,
            expansion=self.expansion,
        )


@dataclass(frozen=True)
class Subproblem(LevelTriangles):
    """K triangles of a level and the N vertices of these triangles and of the boundary, with their own indices.

    vertex_indices (N,): in the chart. triangle_indices (K,): in the level. is_relaxation_fixed (N,) bool: vertices that are not relaxed
    on their own.
    """

    vertex_indices: np.ndarray
    triangle_indices: np.ndarray
    is_relaxation_fixed: np.ndarray

    def energy(self, uv: np.ndarray, min_quality: float, penalties: np.ndarray) -> UvEnergy:
        """Return the energy to minimize from `uv` (N, 2).

        Triangles above `min_quality` stay above it. Others do not get much worse, and are pulled up with the strength `penalties` (K,).
        """
        barriers = []
        if min_quality > 0.0:
            weights = self.shapes.areas * np.sqrt(self.weights)  # Half of the stretch energy without stretch.
            ratios = min_height_to_base(uv[self.triangles])
            floors = np.where(ratios > min_quality, min_quality, FLOOR_FRACTION * ratios)
            barriers.append(ShapeBarrier(self.triangles, np.arange(len(self.triangle_indices)), weights, floors, False))
            poor = np.flatnonzero((ratios < min_quality) & (penalties > 0.0))
            if len(poor):
                limits = np.full(len(poor), min_quality)
                barriers.append(ShapeBarrier(self.triangles[poor], poor, (weights * penalties)[poor], limits, True))
        return UvEnergy(
            Assembly(self.triangles, self.is_free),
            StretchEnergy(self.triangles, self.shapes, self.weights, self.expansion),
            barriers,
            BoundaryBarrier(self.boundary, self.activation_distance) if len(self.boundary) else None,
            self.relax_worst_vertices,
        )

    def relax_worst_vertices(self, uv: np.ndarray) -> np.ndarray:
        """Return uv (N, 2) with fewer strongly distorted triangles."""
        fixed = self.is_relaxation_fixed
        return relax_worst_vertices(uv, self.triangles, self.vertices, self.shapes, self.vertex_weights, fixed, self.expansion.symmetry)


def _divide_into_patches(positions: np.ndarray, first_fraction: float) -> Iterator[np.ndarray]:
    """Yield the patches of `positions` (N, 2) as index arrays.

    Each cut divides the longer side of the bounding box; the first at the fraction `first_fraction` of its points, all others in half.
    """
    stack = [(np.arange(len(positions)), first_fraction)]
    while stack:
        members, fraction = stack.pop()
        if len(members) <= MAX_PATCH_VERTICES:
            yield members
            continue
        axis = int(np.ptp(positions[members], axis=0).argmax())
        order = members[np.argsort(positions[members, axis], kind="stable")]
        cut = int(fraction * len(order))
        stack += [(order[cut:], 0.5), (order[:cut], 0.5)]
