"""From a mesh or point cloud to a billboard cloud in levels: the one entry to the tool `billboards`."""

import numpy as np

from ..errors import GeometryError, SettingsError
from ..mesh import PointCloud, TriangleMesh, check_points, longest_side, without_zero_area
from ..progress import Progress, StageClock, Steps, scaled
from .budget import budget_of, within_budget
from .cloud import Cloud, Level, Quads
from .levels import LevelBuilder
from .primitives import Primitives, from_mesh, from_points
from .settings import BillboardSettings
from .surfaces import surfaces_of


def build(source: TriangleMesh | PointCloud, settings: BillboardSettings, name: str = "mesh") -> Steps[Cloud]:
    """Build the billboard cloud of `source` (world space, any unit of length).

    Returns:
        The cloud; primitive numbers in it are those of `source`, also where zero-area triangles were dropped (their owner is -1).

    Raises:
        GeometryError: when the source is empty, not finite or without area; `name` says whose it is.
        SettingsError: when the settings contradict each other or the source, or no error keeps the cloud within the budget asked for.
    """
    budget = budget_of(settings)
    clock = StageClock()
    primitives, kept, total = prepare(source, settings, name)
    side = longest_side(primitives.points[np.unique(primitives.corners)])
    centred, middle = _about_origin(primitives)
    with clock.stage("parts"):
        surfaces = surfaces_of(centred)
    builder = LevelBuilder(settings, side, clock)
    if budget is None:
        coverings = yield from scaled(builder.coverings(centred, surfaces, settings.error, settings.levels), 0.0, 0.95)
        error = settings.error
    else:
        coverings, error = yield from scaled(within_budget(centred, surfaces, builder, budget, name), 0.0, 0.95)
    yield Progress(0.95, "Packing the atlas")
    levels = builder.levels(centred, surfaces, coverings, error)
    distance, beyond, uncovered = _figures(centred, levels, settings)
    levels = [_in_source(level, middle, kept, total) for level in levels]
    return Cloud(levels, total, total - len(kept), side, distance, beyond, uncovered, clock.seconds)


def prepare(source: TriangleMesh | PointCloud, settings: BillboardSettings, name: str) -> tuple[Primitives, np.ndarray, int]:
    """The checked primitives of `source`, their numbers (K,) in it, and how many it has in all."""
    if isinstance(source, PointCloud):
        if settings.method == "decimate":
            raise SettingsError(f'"{name}" is a point cloud, which cannot be decimated; choose the method clusters or hough.')
        check_points(source.points, name)
        kept = np.flatnonzero((source.radii > 0.0) & (np.abs(np.linalg.norm(source.normals, axis=1) - 1.0) < 1e-3))
        if len(kept) == 0:
            raise GeometryError(f'No point of "{name}" has a radius and a normal; estimate them first.')
        colors = None if source.colors is None else source.colors[kept]
        return from_points(PointCloud(source.points[kept], source.normals[kept], source.radii[kept], colors)), kept, len(source.points)
    mesh, kept = without_zero_area(source, name)
    return from_mesh(mesh), kept, len(source.triangles)


def _about_origin(primitives: Primitives) -> tuple[Primitives, np.ndarray]:
    """The primitives about the centre of their box, where sums of squares keep their digits, and that centre (3,)."""
    used = primitives.positions.reshape(-1, 3)
    middle = 0.5 * (used.min(axis=0) + used.max(axis=0))
    return Primitives(primitives.points - middle, primitives.corners, primitives.areas, primitives.normals), middle


def _figures(primitives: Primitives, levels: list[Level], settings: BillboardSettings) -> tuple[float, int, int]:
    """Largest corner distance to a plane that shows it over the level's error; faces beyond the normal bound and faces shown nowhere.

    A plane of the method hough serves both of its sides, so there it is the smaller angle to either that counts.
    """
    distance, beyond, uncovered = 0.0, 0, 0
    for number, level in enumerate(levels):
        quads = level.quads
        which = np.repeat(np.arange(len(quads)), np.diff(quads.drawn_offsets))
        offsets = np.einsum("qi,qi->q", quads.centers, quads.frames[:, 2])
        heights = np.einsum("kci,ki->kc", primitives.positions[quads.drawn], quads.frames[which, 2]) - offsets[which, None]
        distance = max(distance, float(np.abs(heights).max() / level.error))
        shown = np.zeros(len(primitives), bool)
        shown[quads.drawn] = True
        uncovered = max(uncovered, int((~shown).sum()))
        if number == 0:
            facing = np.einsum("pi,pi->p", primitives.normals, quads.frames[quads.owner, 2])
            facing = np.abs(facing) if settings.method == "hough" else facing
            beyond = int((facing < np.cos(settings.max_normal_deviation)).sum())
    return distance, beyond, uncovered


def _in_source(level: Level, middle: np.ndarray, kept: np.ndarray, total: int) -> Level:
    """The level back in the place and the numbering of the source."""
    owner = np.full(total, -1, np.int32)
    owner[kept] = level.quads.owner
    quads = level.quads
    moved = Quads(quads.centers + middle, quads.frames, quads.half_sizes, quads.drawn_offsets, kept[quads.drawn].astype(np.int32), owner)
    return Level(level.error, level.texel, moved, level.atlas, level.cutouts, level.joined, level.solid)
