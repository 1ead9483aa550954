"""From a mesh or point cloud to a billboard cloud in levels: the one entry to the tool `billboards`."""

import numpy as np

from ..errors import GeometryError, SettingsError
from ..mesh import PointCloud, TriangleMesh, check_points, longest_side, without_zero_area
from ..progress import Progress, StageClock, Steps, scaled
from . import methods
from .atlas import pack
from .cloud import Cloud, Level, Quads
from .cutouts import cut_corners
from .patches import Covering, Patch, overlapping, to_quads
from .primitives import Primitives, from_mesh, from_points
from .rectangles import bounds_of
from .settings import BillboardSettings
from .surfaces import Surfaces, shared_surfaces, surfaces_of

MARGIN = 0.25  # of the error: quads of a convex surface that meet at 30 degrees are apart by about this much
KEPT_BACK = 1e-4  # of the error and the normal bound: room for rounding to single precision in Blender and in files


def build(source: TriangleMesh | PointCloud, settings: BillboardSettings, name: str = "mesh") -> Steps[Cloud]:
    """Build the billboard cloud of `source` (world space, any unit of length).

    Returns:
        The cloud; primitive numbers in it are those of `source`, also where zero-area triangles were dropped (their owner is -1).

    Raises:
        GeometryError: when the source is empty, not finite or without area; `name` says whose it is.
        SettingsError: when the settings contradict the source.
    """
    clock = StageClock()
    primitives, kept, total = prepare(source, settings, name)
    side = longest_side(primitives.points[np.unique(primitives.corners)])
    errors = [settings.error * side * 2.0**level for level in range(settings.levels)]
    inner = [error * (1.0 - KEPT_BACK) for error in errors]
    centred, middle = _about_origin(primitives)
    with clock.stage("parts"):
        surfaces = surfaces_of(centred)
    coverings = yield from scaled(METHODS[settings.method](centred, surfaces, inner, settings, clock), 0.0, 0.95)
    yield Progress(0.95, "Packing the atlas")
    with clock.stage("pack"):
        levels = [
            _level(centred, covering, surfaces, error, settings.texel_error * error, settings.cutout_corners)
            for covering, error in zip(coverings, errors, strict=True)
        ]
    distance, beyond, uncovered = _figures(centred, levels, settings.max_normal_deviation)
    levels = [_in_source(level, middle, kept, total) for level in levels]
    return Cloud(levels, total, total - len(kept), side, distance, beyond, uncovered, clock.seconds)


METHODS = {"clusters": methods.clusters, "hough": methods.hough, "decimate": methods.decimate}


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


def _level(primitives: Primitives, covering: Covering, surfaces: Surfaces, error: float, texel: float, most_corners: int) -> Level:
    """Quads, atlas and cutouts of one level."""
    shared = shared_surfaces(surfaces, covering.owner)
    covering = overlapping(primitives, covering, shared, MARGIN * error)
    quads = to_quads(covering.patches, covering.owner)
    cutouts = [_cutout(primitives, patch, texel, most_corners) for patch in covering.patches]
    joined = np.array([patch.outline is None and bool(shared[patch.shown].any()) for patch in covering.patches])
    solid = np.array([bool(surfaces.solid[patch.shown].all()) for patch in covering.patches])
    return Level(error, texel, quads, pack(quads.half_sizes, texel), cutouts, joined, solid)


def _cutout(primitives: Primitives, patch: Patch, texel: float, most_corners: int) -> np.ndarray:
    """The polygon that `patch` is cut to, in -1..1 of its half sides; half a texel stays free around what it shows."""
    if patch.outline is not None:
        return patch.outline
    middle = patch.rectangle.reshape(2, 2).mean(axis=1)
    half = np.maximum(0.5 * np.ptp(patch.rectangle.reshape(2, 2), axis=1), 1e-12 * texel)
    bounds = (bounds_of(primitives.positions[patch.shown], patch.axes).reshape(-1, 2, 2) - middle[:, None]) / half[:, None]
    sticking_out = (np.abs(bounds) > 1.0 + 1e-6).any(axis=(1, 2))
    local = (primitives.positions[patch.shown[~sticking_out]].reshape(-1, 3) @ patch.axes.T - middle) / half
    # What sticks out is cut at the rectangle: the corners of its box hold all that is left of it.
    boxes = np.clip(bounds[sticking_out], -1.0, 1.0)
    corners = np.stack([boxes[:, 0][:, [0, 1, 1, 0]], boxes[:, 1][:, [0, 0, 1, 1]]], axis=2).reshape(-1, 2)
    return cut_corners(np.clip(np.concatenate([local, corners]), -1.0, 1.0), 0.5 * texel / half, most_corners)


def _figures(primitives: Primitives, levels: list[Level], max_normal_deviation: float) -> tuple[float, int, int]:
    """Largest corner distance to a plane that shows it over the level's error; faces beyond the normal bound and faces shown nowhere."""
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
            beyond = int((facing < np.cos(max_normal_deviation)).sum())
    return distance, beyond, uncovered


def _in_source(level: Level, middle: np.ndarray, kept: np.ndarray, total: int) -> Level:
    """The level back in the place and the numbering of the source."""
    owner = np.full(total, -1, np.int32)
    owner[kept] = level.quads.owner
    quads = level.quads
    moved = Quads(quads.centers + middle, quads.frames, quads.half_sizes, quads.drawn_offsets, kept[quads.drawn].astype(np.int32), owner)
    return Level(level.error, level.texel, moved, level.atlas, level.cutouts, level.joined, level.solid)
