"""Quads of flat input, without decimation.

The vertex fit of a decimation is unstable normal to a flat mesh: samples outside its boundary pull along directions whose normal component
is rounding, and only the damping opposes them. The steps amplify this rounding to a fraction of the error, and the number of quads would
depend on it. A flat surface needs no simplification, because all triangles of one plane share a quad anyway.
"""

import numpy as np

from ...geometry.transforms import frames_from_normals
from ..clustering.patches import Covering, Patch, group_by_label
from ..clustering.planes import PlaneBounds, fit_planes
from ..clustering.rectangles import compute_bounds, enclosing_rectangle, min_area_axes, rectangle_area
from ..components import Components
from ..primitives import Primitives
from .triangle_patches import FLAT_TOLERANCE


def cover_flat_surfaces(
    primitives: Primitives, components: Components, bounds: PlaneBounds, quad_cost: float
) -> tuple[np.ndarray, Covering]:
    """Cover connected surfaces with one quad each if all `primitives` are in one plane, within FLAT_TOLERANCE of the error.

    Front and back faces need separate quads. Surfaces for which one quad would waste too much area, and loose parts, which could share one,
    are not covered. `quad_cost`: of one more quad, in mean areas of a triangle.

    Returns:
        The indices (K,) of the covered primitives, none if the input is not flat, and the covering of these, in their numbering.
    """
    plane = fit_planes(primitives, [np.arange(len(primitives))])
    normal, offset = plane.normals[0], float(plane.offsets[0])
    cosines = primitives.normals @ normal
    flat_bounds = PlaneBounds(FLAT_TOLERANCE * bounds.error)
    is_flat = flat_bounds.contain(primitives.positions, primitives.normals, normal, offset) & (np.abs(cosines) >= bounds.min_cosine)
    indices: list[np.ndarray] = []
    patches: list[Patch] = []
    surfaces = _find_surfaces(components, cosines > 0.0) if is_flat.all() else []
    for members in surfaces:
        sign = 1.0 if cosines[members[0]] > 0.0 else -1.0
        first = sum(len(other) for other in indices)
        patch = _build_patch(primitives.positions[members], sign * normal, sign * offset, np.arange(first, first + len(members)))
        areas = primitives.areas[members]
        if rectangle_area(patch.rectangle) <= areas.sum() + quad_cost * areas.mean() * (len(members) - 1):
            indices.append(members)
            patches.append(patch)
    owner = np.repeat(np.arange(len(patches), dtype=np.int32), [len(members) for members in indices])
    return np.concatenate([np.empty(0, np.int64), *indices]), Covering(patches, owner)


def _find_surfaces(components: Components, is_front: np.ndarray) -> list[np.ndarray]:
    """Return the primitives of each connected surface, without loose parts, front and back faces separately."""
    labels = np.unique(2 * components.labels + is_front, return_inverse=True)[1].reshape(-1)
    return [members for members in group_by_label(labels) if not components.loose[members].any()]


def _build_patch(positions: np.ndarray, normal: np.ndarray, offset: float, drawn: np.ndarray) -> Patch:
    """Build the patch with the smallest rectangle around the primitives `drawn` with corner `positions` (K, 3, 3)."""
    frame = frames_from_normals(normal[None])[0, :2]
    axes = min_area_axes(positions.reshape(-1, 3) @ frame.T) @ frame
    return Patch(normal, offset, axes, enclosing_rectangle(compute_bounds(positions, axes)), drawn, drawn)
