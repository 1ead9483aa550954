"""Planes of patches through most of the area that they show, as far as their error allows.

The minimax plane lies midway between the outermost points: the quad of a roof with a bevel is tilted and lies below the roof, so that it
does not meet the walls. A plane through the roof itself leaves the bevel within the error as well.
"""

from dataclasses import replace

import numpy as np

from ...arrays import TINY
from ..primitives import Primitives
from .patches import Patch, best_facing_patch
from .planes import PlaneBounds
from .rectangles import compute_bounds, enclosing_rectangle, is_inside

FRACTIONS = np.linspace(1.0, 0.0, 9)  # Of the way from the minimax normal to that of least squares, in the order of the attempts.
MAX_RATIO = 0.8  # Of the root-mean-square distances after and before: a curved surface, such as a column, stays on its minimax plane.
ROUNDING = 1e-9  # Relative tolerance of distances, and that of cosines.


def refit_planes(primitives: Primitives, patches: list[Patch], bounds: PlaneBounds) -> list[Patch]:
    """Return the patches with planes closer to the area that they draw.

    What no other patch faces more directly stays within the error of the plane, and its normals within the bounds if they were. Other
    primitives are drawn where they are still within the error.
    """
    owner = best_facing_patch(primitives, patches)
    return [
        _refit(primitives, patch, patch.drawn[owner[patch.drawn] == index], bounds.error, bounds.min_cosine)
        for index, patch in enumerate(patches)
    ]


def _refit(primitives: Primitives, patch: Patch, required: np.ndarray, error: float, min_cosine: float) -> Patch:
    if len(required) == 0:
        return patch
    normals, positions = primitives.normals[required], primitives.positions[required]
    facing = normals @ patch.normal
    center, spread = _measure_area(primitives, required, np.abs(facing))

    def mean_square(normal: np.ndarray, offset: float) -> float:
        return float(normal @ spread @ normal + (center @ normal - offset) ** 2)

    target = np.linalg.eigh(spread)[1][:, 0]
    target *= np.copysign(1.0, target @ patch.normal)
    turned = normals[facing >= min_cosine]
    for fraction in FRACTIONS:
        normal = (1.0 - fraction) * patch.normal + fraction * target
        normal /= np.linalg.norm(normal)
        heights = positions @ normal
        low, high = float(heights.max()) - error, float(heights.min()) + error
        if low <= high and (turned @ normal >= min_cosine - ROUNDING).all():
            offset = float(np.clip(center @ normal, low, high))
            is_better = mean_square(normal, offset) < MAX_RATIO**2 * mean_square(patch.normal, patch.offset)
            return _move(primitives, patch, normal, offset, error) if is_better else patch
    return patch


def _measure_area(primitives: Primitives, drawn: np.ndarray, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the center (3,) and the covariance (3, 3) of the area of primitives, weighted by `weights` (K,)."""
    weights = primitives.areas[drawn] * weights + TINY
    weights /= weights.sum()
    centers = primitives.positions[drawn].mean(axis=1)
    center = weights @ centers
    offsets = centers - center
    return center, np.einsum("k,kij->ij", weights, primitives.covariances[drawn]) + (weights[:, None] * offsets).T @ offsets


def _move(primitives: Primitives, patch: Patch, normal: np.ndarray, offset: float, error: float) -> Patch:
    """Return `patch` in another plane, with its rectangle in the same place, around all that it enclosed before."""
    first = patch.axes[0] - (patch.axes[0] @ normal) * normal
    first /= np.linalg.norm(first)
    axes = np.stack([first, np.cross(normal, first)])
    old = patch.rectangle.reshape(2, 2)
    center = axes @ (old.mean(axis=1) @ patch.axes + patch.offset * patch.normal)
    rectangle = (center[:, None] + 0.5 * np.ptp(old, axis=1)[:, None] * [-1.0, 1.0]).ravel()
    bounds = PlaneBounds(error * (1.0 + ROUNDING))
    drawn, region = (
        indices[bounds.contain(primitives.positions[indices], primitives.normals[indices], normal, offset)]
        for indices in (patch.drawn, patch.region)
    )
    positions = primitives.positions[drawn]
    enclosed = is_inside(compute_bounds(positions, patch.axes), patch.rectangle)
    if enclosed.any():
        rectangle = enclosing_rectangle(np.stack([rectangle, *compute_bounds(positions[enclosed], axes)]))
    return replace(patch, normal=normal, offset=offset, axes=axes, rectangle=rectangle, drawn=drawn, region=region)
