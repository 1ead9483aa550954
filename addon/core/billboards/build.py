"""Construction of a billboard cloud with levels of detail from a mesh or point cloud: entry point of the tool `billboards`."""

from dataclasses import replace

import numpy as np

from ..errors import SettingsError
from ..geometry.distance import closest_on_mesh
from ..geometry.mesh import PointCloud, TriangleMesh, drop_degenerate, longest_side
from ..jobs.progress import Progress, StageClock, Steps, subprogress
from .budget import cover_within_budget, read_budget
from .cloud import Cloud, Level, Quads
from .estimate import estimate_level, sample_primitives
from .levels import LevelBuilder
from .lightness import describe_weight, keep_lighter_levels
from .primitives import Primitives, drop_incomplete_points, find_components, from_mesh, from_points
from .settings import BillboardSettings

PACKING_START = 0.95  # Fraction of the progress bar; the rest is for packing the atlas.


def build_cloud(source: TriangleMesh | PointCloud, settings: BillboardSettings, name: str = "mesh") -> Steps[Cloud]:
    """Build the billboard cloud of `source` (world space, any unit of length).

    Returns:
        The cloud. Its primitive indices are those of `source`, also if zero-area triangles were dropped (their owner is -1).

    Raises:
        GeometryError: the source is empty, not finite or without area; the message contains `name`.
        SettingsError: the settings contradict each other or the source, or no error keeps the cloud within the requested budget.
    """
    budget = read_budget(settings)
    clock = StageClock()
    primitives, kept, total = prepare_primitives(source, settings, name)
    side = longest_side(primitives.points[np.unique(primitives.corners)])
    centered, center = _move_to_origin(primitives)
    with clock.stage("components"):
        components = find_components(centered)
    builder = LevelBuilder(settings, side, clock)
    if budget is None:
        steps = builder.build_coverings(centered, components, settings.error, settings.levels)
        coverings = yield from subprogress(steps, 0.0, PACKING_START)
        error = settings.error
    else:
        coverings, error = yield from subprogress(cover_within_budget(centered, components, builder, budget, name), 0.0, PACKING_START)
    yield Progress(PACKING_START, "Packing the atlas")
    levels = builder.build_levels(centered, components, coverings, error)
    levels, notes = (levels, []) if settings.keeps_all_levels else keep_lighter_levels(levels, side)
    notes += _describe_weight(centered, levels, side, settings, name)
    distance, beyond_normal_bound, uncovered = _measure(centered, levels, settings)
    levels = [_move_to_source(level, center, kept, total) for level in levels]
    return Cloud(levels, total, total - len(kept), side, distance, beyond_normal_bound, uncovered, clock.seconds, notes)


def prepare_primitives(source: TriangleMesh | PointCloud, settings: BillboardSettings, name: str) -> tuple[Primitives, np.ndarray, int]:
    """Check `source` and return its usable primitives, their indices (K,) in it, and the number of all its primitives."""
    if isinstance(source, PointCloud):
        if settings.method == "decimate":
            raise SettingsError(f'"{name}" is a point cloud, which cannot be decimated; set Method to clusters or hough.', ("method",))
        points, kept = drop_incomplete_points(source, name)
        return from_points(points), kept, len(source.points)
    mesh, kept = drop_degenerate(source, name)
    return from_mesh(mesh), kept, len(source.triangles)


def _move_to_origin(primitives: Primitives) -> tuple[Primitives, np.ndarray]:
    """Return the primitives relative to the center of their bounding box, where sums of squares are accurate, and that center (3,)."""
    positions = primitives.positions.reshape(-1, 3)
    center = 0.5 * (positions.min(axis=0) + positions.max(axis=0))
    return Primitives(primitives.points - center, primitives.corners, primitives.areas, primitives.normals), center


def _describe_weight(primitives: Primitives, levels: list[Level], side: float, settings: BillboardSettings, name: str) -> list[str]:
    """Return a sentence if the finest level has no fewer triangles than the source, with the error that would be lighter."""
    count = len(primitives) * (primitives.corners.shape[1] - 2)
    if levels[0].triangle_count < count:
        return []
    sample = sample_primitives(primitives, side)
    return [describe_weight(levels, side, count, lambda error: estimate_level(sample, settings, error).triangles, name)]


def _measure(primitives: Primitives, levels: list[Level], settings: BillboardSettings) -> tuple[float, int, int]:
    """Measure what the levels promise.

    Returns:
        The maximum distance of a corner to the plane of a quad, or to the charts, that show it, over the level's error; the number of faces
        of the finest level beyond the normal bound of the quad that owns them; the number of faces that no quad shows. A plane of the
        method hough is two-sided, so there the smaller angle to its two normals counts.
    """
    distance, beyond_normal_bound, uncovered = 0.0, 0, 0
    for index, level in enumerate(levels):
        quads = level.quads
        quad = np.repeat(np.arange(len(quads)), np.diff(quads.drawn_offsets))
        offsets = np.einsum("qi,qi->q", quads.centers, quads.frames[:, 2])
        has_chart = np.array([chart is not None for chart in level.charts])
        is_flat = ~has_chart[quad]
        drawn, quad = quads.drawn[is_flat], quad[is_flat]
        heights = np.einsum("kci,ki->kc", primitives.positions[drawn], quads.frames[quad, 2]) - offsets[quad, None]
        largest = float(np.abs(heights).max(initial=0.0) / level.error)
        distance = max(distance, largest, _measure_charts(primitives, level, has_chart))
        is_drawn = np.zeros(len(primitives), bool)
        is_drawn[quads.drawn] = True
        uncovered = max(uncovered, int((~is_drawn).sum()))
        if index == 0:
            cosines = np.einsum("pi,pi->p", primitives.normals, quads.frames[quads.owner, 2])[~has_chart[quads.owner]]
            cosines = np.abs(cosines) if settings.method == "hough" else cosines
            beyond_normal_bound = int((cosines < np.cos(settings.max_normal_deviation)).sum())
    return distance, beyond_normal_bound, uncovered


def _measure_charts(primitives: Primitives, level: Level, has_chart: np.ndarray) -> float:
    """Return the maximum distance of a corner of a primitive that a chart owns to the charts, over the error."""
    charts = [chart.vertices[chart.triangles] for chart in level.charts if chart is not None]
    if not charts:
        return 0.0
    corners = primitives.corners[has_chart[level.quads.owner]]
    return float(closest_on_mesh(primitives.points[np.unique(corners)], np.concatenate(charts))[0].max() / level.error)


def _move_to_source(level: Level, center: np.ndarray, kept: np.ndarray, total: int) -> Level:
    """Return the level in the space and numbering of the source."""
    owner = np.full(total, -1, np.int32)
    owner[kept] = level.quads.owner
    quads = level.quads
    drawn = kept[quads.drawn].astype(np.int32)
    charts = [None if chart is None else replace(chart, vertices=chart.vertices + center) for chart in level.charts]
    moved = Quads(quads.centers + center, quads.frames, quads.half_sizes, quads.drawn_offsets, drawn, owner)
    return Level(level.error, level.texel_size, moved, level.atlas, level.cutouts, level.joined, level.solid, charts)
