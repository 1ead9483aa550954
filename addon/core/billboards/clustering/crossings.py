"""Crossing quads: a rod on one quad would disappear where this is seen edge-on.

A second quad through the axis of the rod shows it from there. It costs two triangles, so it is added only where much of the silhouette of
the source would be lost. Rods here are whatever is about as thick as wide, and fits both quads within the error: columns, legs, stones.
"""

from dataclasses import replace

import numpy as np

from ...geometry.transforms import frame_from_normal
from ...imaging.raster import draw_ids, rasterize
from ..cloud import RECTANGLE
from ..primitives import Primitives
from .patches import Covering, Patch
from .rectangles import compute_bounds, enclosing_rectangle, rectangle_area

MIN_THICKNESS = 0.5  # Of a rod over its width.
MIN_LOSS = 0.02  # Of the silhouette of the source from one side; less is not worth the triangles.
MIN_PATCH_LOSS = 0.25  # Of the pixels that a quad should cover.
TILTS = (-0.7, 0.0, 0.7)  # Along a rod, over the distance: rods in a row hide each other from the side.
MIN_COSINE = 0.9  # Between directions that are measured together.
MAX_DIRECTIONS = 4
PIXELS_PER_ERROR = 2.0
MAX_PIXELS = 512  # Along the longest side.


def add_crossings(primitives: Primitives, sheets: np.ndarray, covering: Covering, error: float) -> Covering:
    """Return `covering` with crossing quads where the source would lose much of its silhouette.

    Args:
        primitives: Triangles.
        sheets: (P,) bool from `Components`. Leaves get no crossing quads.
        covering: Of the primitives.
        error: A length.
    """
    patches = list(covering.patches)
    rods = {
        index: _compute_edge(patch)
        for index, patch in enumerate(patches)
        if not sheets[patch.drawn].any() and _is_rod(primitives, patch, error)
    }
    for _ in range(MAX_DIRECTIONS):
        if not rods:
            break
        largest = max(rods, key=lambda index: rectangle_area(patches[index].rectangle))
        direction = rods[largest]
        near = [index for index, edge in rods.items() if abs(edge @ direction) >= MIN_COSINE]
        along = np.cross(patches[largest].normal, direction)
        views = [direction + tilt * along for tilt in TILTS]
        counts = sum(_count_lost_pixels(primitives, replace(covering, patches=patches), view, error) for view in views)
        chosen = [index for index in near if counts[index, 0] > MIN_PATCH_LOSS * counts[index, 1]]
        if counts[chosen, 0].sum() > MIN_LOSS * counts[:, 1].sum():
            _cross(primitives, patches, chosen, near, error)
        for index in near:
            del rods[index]
    return replace(covering, patches=patches)


def _is_rod(primitives: Primitives, patch: Patch, error: float) -> bool:
    """Return whether a crossing quad of `patch` would show it within `error`, and be wide enough."""
    width = _measure_sides(patch).min()
    if patch.is_fixed or width > 2.0 * error:
        return False
    heights = primitives.positions[patch.drawn] @ patch.normal
    return bool(np.ptp(heights) >= MIN_THICKNESS * width)


def _measure_sides(patch: Patch) -> np.ndarray:
    """Return the lengths (2,) of the sides of `patch` along its axes."""
    return np.ptp(patch.rectangle.reshape(2, 2), axis=1)


def _compute_edge(patch: Patch) -> np.ndarray:
    """Return the direction (3,) in the plane of `patch` across its longer side."""
    return patch.axes[1 - _measure_sides(patch).argmax()]


def _count_lost_pixels(primitives: Primitives, covering: Covering, direction: np.ndarray, error: float) -> np.ndarray:
    """Return in how many pixels each patch should be seen from `direction` (3,), but no patch is, and in how many altogether: (Q, 2)."""
    axes = frame_from_normal(direction / np.linalg.norm(direction))
    positions = primitives.positions @ axes.T
    low, high = positions.min(axis=(0, 1)), positions.max(axis=(0, 1))
    pixel = max(error / PIXELS_PER_ERROR, float((high - low)[:2].max()) / MAX_PIXELS)
    size = tuple(int(side) + 1 for side in np.ceil((high - low)[:2] / pixel))
    owners = draw_ids((positions[..., :2] - low[:2]) / pixel, -positions[..., 2], size)[0].ravel()
    is_covered = np.zeros(len(owners), bool)
    flat = [_flatten(primitives, patch) @ axes[:2].T for patch in covering.patches]
    for _, pixels, _ in rasterize((np.concatenate(flat) - low[:2]) / pixel, size):
        is_covered[pixels] = True
    shown = covering.owner[owners[owners >= 0]]
    is_lost = ~is_covered[owners >= 0]
    count = len(covering.patches)
    return np.stack([np.bincount(shown[is_lost], minlength=count), np.bincount(shown, minlength=count)], axis=1)


def _flatten(primitives: Primitives, patch: Patch) -> np.ndarray:
    """Return the corners (K, 3, 3) of what `patch` draws where it shows them. Charts follow the surface."""
    corners = primitives.positions[patch.drawn]
    if patch.chart is not None:
        return corners
    return corners - (corners @ patch.normal - patch.offset)[..., None] * patch.normal


def _cross(primitives: Primitives, patches: list[Patch], chosen: list[int], near: list[int], error: float) -> None:
    """Add one crossing quad for each rod among the patches `chosen`, with its other half if that is among the patches `near`."""
    for first in chosen:
        patch = patches[first]
        if patch.is_crossed:
            continue
        normal = _compute_edge(patch)
        along = np.cross(patch.normal, normal)
        axes = np.stack([along, np.cross(normal, along)])
        heights = primitives.positions[patch.drawn] @ normal
        offset = 0.5 * (float(heights.min()) + float(heights.max()))
        rectangle = enclosing_rectangle(compute_bounds(primitives.positions[patch.drawn], axes))
        limits = rectangle + error * np.array([-1.0, 1.0, -1.0, 1.0])
        crossed = [index for index in near if _is_within(primitives, patches[index], normal, offset, axes, limits, error)]
        drawn = np.unique(np.concatenate([patches[index].drawn for index in crossed]))
        rectangle = enclosing_rectangle(compute_bounds(primitives.positions[drawn], axes))
        patches.append(Patch(normal, offset, axes, rectangle, drawn, drawn, outline=RECTANGLE, is_crossed=True))
        for index in crossed:
            patches[index] = replace(patches[index], is_crossed=True)


def _is_within(
    primitives: Primitives, patch: Patch, normal: np.ndarray, offset: float, axes: np.ndarray, limits: np.ndarray, error: float
) -> bool:
    """Return whether a plane shows all that `patch` draws within `error` and within the rectangle `limits` (4,)."""
    positions = primitives.positions[patch.drawn]
    bounds = enclosing_rectangle(compute_bounds(positions, axes))
    is_inside = (bounds[0::2] >= limits[0::2]).all() and (bounds[1::2] <= limits[1::2]).all()
    return bool(is_inside and np.abs(positions @ normal - offset).max() <= error)
