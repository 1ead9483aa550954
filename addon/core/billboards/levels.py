"""Construction of levels of detail for any error: coverings by the selected method, then quads, atlas and the polygons of quads."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from ..jobs.progress import StageClock, Steps, subprogress
from . import methods
from .atlas import pack
from .cloud import RECTANGLE, Level
from .clustering.crossings import add_crossings
from .clustering.patches import Covering, Patch, extend_overlaps, to_quads
from .clustering.rectangles import compute_bounds
from .parts.part_meshes import Part
from .parts.selection import mesh_parts
from .primitives import Components, Primitives, find_shared_surfaces
from .settings import BillboardSettings

METHODS = {
    "clusters": methods.cover_by_clustering,
    "hough": methods.cover_by_hough,
    "decimate": methods.cover_by_decimation,
}
ROUNDING_MARGIN = 1e-4  # In errors: reserve for rounding to single precision in Blender and in files.
MAX_BACK_FRACTION = 0.25  # Of the area that a quad shows: where more faces away, it shows both sides of a plate.
MIN_HALF_SIZE = 1e-12  # In texels: replaces the half size 0 of a quad without height, a divisor.
PARTS_PROGRESS = 0.8  # Meshes of solid parts start at this fraction of the progress.
CLIP_TOLERANCE = 1e-6  # In half sizes: primitives that exceed the rectangle by less are not clipped.
CORNER_CUT_DIRECTIONS = np.linspace(0.1, 0.9, 17)  # x component of the normal of a corner cut; its y component is the rest to 1.
MIN_CUT_AREA = 16.0  # In squared errors, that is pixels at the switch distance: what a cut must save to pay for its triangle.


@dataclass(frozen=True)
class LevelBuilder:
    """Builds levels with `settings`, but with errors from the caller, as fractions of `longest_side`.

    longest_side: length of the longest bounding-box side of the complete source. clock: measures the time of every stage.
    prepared: parts of primitives, prepared to become meshes.
    """

    settings: BillboardSettings
    longest_side: float
    clock: StageClock
    prepared: list[tuple[Primitives, dict[int, Part]]] = field(default_factory=list)

    def build_coverings(
        self,
        primitives: Primitives,
        components: Components,
        relative_error: float,
        count: int,
        finished: Sequence[Covering] = (),
        reference_area: float | None = None,
    ) -> Steps[list[Covering]]:
        """Build the coverings of the `count` finest levels, finest first, with `relative_error` at the finest; see `methods`."""
        errors = [error * (1.0 - ROUNDING_MARGIN) for error in self._errors(relative_error, count)]
        method = METHODS[self.settings.method]
        steps = method(primitives, components, errors, self.settings, self.clock, finished, reference_area)
        if self.settings.method != "clusters" or self.settings.keeps_all_levels:
            return (yield from steps)
        start = len(finished)
        coverings = (yield from subprogress(steps, 0.0, PARTS_PROGRESS))[start:]
        if self.settings.meshes_parts:
            coverings = yield from subprogress(self._mesh_parts(primitives, components, coverings, errors[start:]), PARTS_PROGRESS, 1.0)
        if primitives.corners.shape[1] == 3:
            with self.clock.stage("crossings"):
                coverings = [add_crossings(primitives, components.sheets, *level) for level in zip(coverings, errors[start:], strict=True)]
        return [*finished, *coverings]

    def _mesh_parts(
        self, primitives: Primitives, components: Components, coverings: list[Covering], errors: list[float]
    ) -> Steps[list[Covering]]:
        """Replace quads of `coverings` by meshes, see `mesh_parts`."""

        def recover(indices: np.ndarray, error: float) -> Steps[Covering]:
            subset = primitives.subset(indices), components.subset(indices)
            return (yield from METHODS[self.settings.method](*subset, [error], self.settings, self.clock))[0]

        with self.clock.stage("parts"):
            return (yield from mesh_parts(primitives, components, coverings, errors, self._parts_of(primitives), recover))

    def _parts_of(self, primitives: Primitives) -> dict[int, Part]:
        """Return the parts of `primitives` that were prepared before, by label."""
        for known, parts in self.prepared:
            if known is primitives:
                return parts
        self.prepared.append((primitives, {}))
        return self.prepared[-1][1]

    def build_levels(
        self, primitives: Primitives, components: Components, coverings: Sequence[Covering], relative_error: float
    ) -> list[Level]:
        """Build the levels of `coverings`, finest first, in the space and numbering of `primitives`.

        Raises:
            SettingsError: no texture is large enough for one of them.
        """
        with self.clock.stage("pack"):
            return [
                build_level(primitives, covering, components, error, self.settings)
                for covering, error in zip(coverings, self._errors(relative_error, len(coverings)), strict=True)
            ]

    def _errors(self, relative_error: float, count: int) -> list[float]:
        """Return the errors of the `count` finest levels as lengths."""
        return [relative_error * self.longest_side * 2.0**level for level in range(count)]


def build_level(primitives: Primitives, covering: Covering, components: Components, error: float, settings: BillboardSettings) -> Level:
    """Build quads, atlas and cutouts of one level."""
    shared = find_shared_surfaces(components, covering.owner)
    covering = extend_overlaps(primitives, covering, shared, error)
    quads = to_quads(covering.patches, covering.owner)
    texel_size = settings.texel_size * error
    cutouts = [
        _compute_cutout(primitives, patch, texel_size, settings.cutout_corners, MIN_CUT_AREA * error**2) for patch in covering.patches
    ]
    joined = np.array([patch.is_crossed or (not patch.is_fixed and bool(shared[patch.drawn].any())) for patch in covering.patches])
    solid = np.array([_hides_back(primitives, components, patch, settings) for patch in covering.patches])
    charts = [patch.chart for patch in covering.patches]
    return Level(error, texel_size, quads, pack(quads.half_sizes, texel_size), cutouts, joined, solid, charts)


def _hides_back(primitives: Primitives, components: Components, patch: Patch, settings: BillboardSettings) -> bool:
    """Return whether `patch` shows only the outside of solids. One that shows both sides of a thin plate does not."""
    if not components.solid[patch.drawn].all():
        return False
    areas = primitives.areas[patch.drawn]
    is_behind = primitives.normals[patch.drawn] @ patch.normal < 0.0
    return settings.method != "clusters" or bool(areas[is_behind].sum() <= MAX_BACK_FRACTION * areas.sum())


def _compute_cutout(primitives: Primitives, patch: Patch, texel_size: float, max_corners: int, min_area: float) -> np.ndarray:
    """Compute the polygon that `patch` is cut to, in -1..1 of its half sizes, with a margin of half a texel around the drawn primitives.

    min_area: that a cut must save, in squared units of length.
    """
    if patch.chart is not None:
        return RECTANGLE
    if patch.outline is not None:
        return patch.outline
    center = patch.rectangle.reshape(2, 2).mean(axis=1)
    half_size = np.maximum(0.5 * np.ptp(patch.rectangle.reshape(2, 2), axis=1), MIN_HALF_SIZE * texel_size)
    bounds = (compute_bounds(primitives.positions[patch.drawn], patch.axes).reshape(-1, 2, 2) - center[:, None]) / half_size[:, None]
    clipped = (np.abs(bounds) > 1.0 + CLIP_TOLERANCE).any(axis=(1, 2))
    local = (primitives.positions[patch.drawn[~clipped]].reshape(-1, 3) @ patch.axes.T - center) / half_size
    # The rectangle clips these primitives: the corners of their clipped bounding boxes contain the visible part.
    boxes = np.clip(bounds[clipped], -1.0, 1.0)
    corners = np.stack([boxes[:, 0][:, [0, 1, 1, 0]], boxes[:, 1][:, [0, 0, 1, 1]]], axis=2).reshape(-1, 2)
    points = np.clip(np.concatenate([local, corners]), -1.0, 1.0)
    return cut_corners(points, 0.5 * texel_size / half_size, max_corners, min_area / float(half_size.prod()))


def cut_corners(points: np.ndarray, margin: np.ndarray, max_corners: int, min_area: float = 0.0) -> np.ndarray:
    """Compute a convex polygon around `points`: the square -1..1 with the corners cut off that save most area.

    Args:
        points: (N, 2) in -1..1.
        margin: (2,) distance along each axis that the cuts keep from the points, for the texture filter.
        max_corners: 4 to 8.
        min_area: Smaller corners stay: a cut costs one triangle.

    Returns:
        (C, 2) float64, counter-clockwise, C at most `max_corners`.
    """
    square = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    cuts = []
    for corner in square:
        directions = (np.abs(corner)[None] * np.column_stack([CORNER_CUT_DIRECTIONS, 1.0 - CORNER_CUT_DIRECTIONS])) * corner
        limits = (points @ directions.T).max(axis=0) + np.abs(directions) @ margin
        saved_areas = np.maximum(1.0 - limits, 0.0) ** 2 / (2.0 * CORNER_CUT_DIRECTIONS * (1.0 - CORNER_CUT_DIRECTIONS))
        best = saved_areas.argmax()
        cuts.append((saved_areas[best], directions[best], limits[best]))
    cuts.sort(key=lambda cut: -cut[0])
    polygon = square
    for saved_area, direction, limit in cuts[: max_corners - 4]:
        if saved_area > min_area:
            polygon = _clip(polygon, direction, limit)
    return polygon


def _clip(polygon: np.ndarray, direction: np.ndarray, limit: float) -> np.ndarray:
    """Clip a convex `polygon` to the half plane direction . p <= limit (Sutherland and Hodgman 1974)."""
    heights = polygon @ direction - limit
    corners = []
    for index, height in enumerate(heights):
        following = (index + 1) % len(polygon)
        if height <= 0.0:
            corners.append(polygon[index])
        if height * heights[following] < 0.0:
            t = height / (height - heights[following])
            corners.append(polygon[index] + t * (polygon[following] - polygon[index]))
    return np.array(corners)
