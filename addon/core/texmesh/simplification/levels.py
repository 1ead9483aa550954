"""Levels of detail of textured meshes whose vertices and wedges are among those of the fine mesh, where they are or moved.

Sections I.B and III.A of the paper: vertices are removed by half-edge collapses in a given order, and drastic simplification goes on where
the constraints of surface and texture would stop it.
"""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ...errors import SettingsError
from ...jobs.progress import Progress, Steps
from ..settings import TexmeshSettings
from ..textured_mesh import TexturedMesh, divide_wedges, reverse_triangles
from .collapse_fans import FLIP, FOLD, SHORT_CURVE, TOPOLOGY, VALID
from .drastic import DrasticSteps
from .engine import CollapseEngine, RemovalOrder
from .removal_orders import CheapestOrder, CollapseCost, GivenOrder, TextureQuadrics
from .wedge_quadrics import WedgeQuadrics

CHECK_FRACTION = 0.85  # Openings are looked for whenever this fraction of the triangles is left since the last time.
TOLERANCE = 0.01  # A count that exceeds the target by this fraction has reached it.
REFUSALS = {
    VALID: "{} without a possible collapse",
    FOLD: "{} that would fold the surface over",
    FLIP: "{} that would flip texture coordinates",
    SHORT_CURVE: "{} that would remove the last triangle of an island or of a loop of seams",
    TOPOLOGY: "{} that would pinch the surface or close a component",
}


@dataclass(frozen=True)
class SubsetLevel:
    """A coarse mesh that refers to vertices and wedges of the fine mesh.

    Attributes:
        triangles, wedge_triangles: (T, 3) int32, into the vertices and wedges of the fine mesh.
        materials: (T,) int32.
        collapse_count: number of collapses up to this level.
        constraint: why the target was not reached within 1 %, "" if it was reached.
        drastic_steps: sentences that tell what drastic simplification did up to this level.
        positions: (V, 3) of the vertices of the fine mesh in this level, None if all have their own.
    """

    triangles: np.ndarray
    wedge_triangles: np.ndarray
    materials: np.ndarray
    collapse_count: int
    constraint: str
    drastic_steps: tuple[str, ...]
    positions: np.ndarray | None


@dataclass(frozen=True)
class Simplification:
    """Levels from fine to coarse, and the N collapses in their order.

    Where several surfaces touch at an edge, a vertex is removed once from each.

    Attributes:
        removed, kept: (N,) int32, the vertices V_R and V_C.
        perceptual_values: (N,) float64.
    """

    levels: tuple[SubsetLevel, ...]
    removed: np.ndarray
    kept: np.ndarray
    perceptual_values: np.ndarray


def simplify_in_order(mesh: TexturedMesh, priorities: np.ndarray, targets: list[int], settings: TexmeshSettings) -> Steps[Simplification]:
    """Simplify `mesh` by removing vertices with low `priorities` (V,) first, ties by perceptual value, each onto its nearest neighbor.

    The order holds up to the independence of the collapses of a round, which are chosen among the first fifth of the vertices. Vertices
    whose collapses the constraints refuse stay until their neighborhood has changed.

    Args:
        targets: triangle counts, descending.

    Raises:
        SettingsError: `targets` do not descend or are not positive, or `priorities` have another length than the vertices.
    """
    if priorities.shape != (len(mesh.vertices),) or not np.isfinite(priorities).all():
        raise SettingsError(
            f"There must be {len(mesh.vertices)} finite priorities, one per vertex, not {priorities.size}; analyze the mesh again."
        )
    engine = CollapseEngine(mesh)
    order = GivenOrder(engine.surface.positions, priorities[engine.fine_vertices].astype(np.float64), settings.protected_fraction)
    return (yield from _make_levels(engine, order, targets, settings))


def simplify_by_cost(
    mesh: TexturedMesh,
    make_cost: Callable[[TexturedMesh, np.ndarray], CollapseCost] | None,
    targets: list[int],
    settings: TexmeshSettings,
) -> Steps[Simplification]:
    """Simplify `mesh` by the collapses with the smallest cost. See `simplify_in_order`.

    With *Vertices: Optimized*, seams and touching surfaces set no limits, since their costs count: a vertex may leave a seam with its
    texture coordinates.

    make_cost: returns the cost for a mesh and the vertices (V,) of the input that its vertices are; None for `TextureQuadrics`.
    """
    engine = CollapseEngine(mesh, crosses_seams=settings.vertices == "optimized")
    cost = TextureQuadrics(engine.mesh) if make_cost is None else make_cost(engine.mesh, engine.fine_vertices)
    if isinstance(cost, WedgeQuadrics) and cost.moves_vertices:
        engine.placement = cost
    order = CheapestOrder(cost, len(engine.mesh.vertices))
    return (yield from _make_levels(engine, order, targets, settings))


def extract_level(mesh: TexturedMesh, level: SubsetLevel) -> TexturedMesh:
    """Return `level` of `mesh` as a mesh of its own, without unused vertices and wedges; wedges may have moved to several vertices."""
    used_vertices, triangles = np.unique(level.triangles, return_inverse=True)
    triangles = triangles.reshape(-1, 3).astype(np.int32)
    wedge_triangles, used_wedges, wedge_vertices = divide_wedges(level.wedge_triangles, triangles, len(used_vertices))
    sources = np.zeros(len(mesh.uvs), np.int32)
    sources[mesh.wedge_triangles.reshape(-1)] = mesh.sources.reshape(-1)
    return TexturedMesh(
        vertices=(mesh.vertices if level.positions is None else level.positions)[used_vertices],
        triangles=triangles,
        wedge_triangles=wedge_triangles,
        wedge_vertices=wedge_vertices.astype(np.int32),
        uvs=mesh.uvs[used_wedges],
        attributes=mesh.attributes[used_wedges],
        materials=level.materials,
        sources=sources[level.wedge_triangles],
        has_normals=mesh.has_normals,
    )


def _make_levels(engine: CollapseEngine, order: RemovalOrder, targets: list[int], settings: TexmeshSettings) -> Steps[Simplification]:
    if any(target < 1 for target in targets) or any(first < second for first, second in pairwise(targets)):
        raise SettingsError(f"Triangle counts of levels must be positive and descend, not {', '.join(map(str, targets))}.")
    drastic = DrasticSteps(engine, order, settings)
    initial_count = engine.triangle_count
    last_target = min(targets, default=initial_count)
    levels, checked_count = [], initial_count
    for target in targets:
        if engine.triangle_count > target:
            drastic.prepare(target)
        is_exhausted = False
        while engine.triangle_count > target and not is_exhausted:
            fraction = (initial_count - engine.triangle_count) / max(initial_count - last_target, 1)
            yield Progress(min(max(fraction, 0.0), 1.0), "Simplifying")
            is_exhausted = not _advance(engine, order, drastic, target)
            if engine.triangle_count < CHECK_FRACTION * checked_count:
                checked_count = engine.triangle_count
                drastic.close_cheap_openings(order.min_cost, target)
        levels.append(_take_level(engine, drastic, target))
    return Simplification(
        levels=tuple(levels),
        removed=engine.fine_vertices[_join(engine.removed, np.int32)],
        kept=engine.fine_vertices[_join(engine.kept, np.int32)],
        perceptual_values=_join(engine.values, np.float64),
    )


def _take_level(engine: CollapseEngine, drastic: DrasticSteps, target: int) -> SubsetLevel:
    """Return the current triangles as a level."""
    is_reached = engine.triangle_count <= (1.0 + TOLERANCE) * target
    triangles, wedge_triangles = reverse_triangles(engine.is_reversed, (engine.triangles.T, engine.wedges.T))
    return SubsetLevel(
        triangles=engine.fine_vertices[triangles],
        wedge_triangles=engine.fine_wedges[wedge_triangles],
        materials=engine.materials.copy(),
        collapse_count=sum(map(len, engine.removed)),
        constraint="" if is_reached else name_constraint(engine, target),
        drastic_steps=tuple(drastic.sentences),
        positions=None if engine.placement is None else _list_positions(engine),
    )


def _list_positions(engine: CollapseEngine) -> np.ndarray:
    """Return the positions (V, 3) of the vertices of the mesh that was given; the current ones of those that are used."""
    positions = np.empty((engine.fine_vertices.max() + 1, 3))
    positions[engine.fine_vertices] = engine.surface.positions.T
    used = np.flatnonzero(engine.topology.is_used)
    positions[engine.fine_vertices[used]] = engine.surface.positions.T[used]
    return positions


def _advance(engine: CollapseEngine, order: RemovalOrder, drastic: DrasticSteps, target: int) -> bool:
    """Perform the next round, or step of drastic simplification. Return whether there was one."""
    if engine.run_round(order, engine.triangle_count - target) is not None:
        return True
    if engine.retry():
        return True
    return engine.triangle_count > (1.0 + TOLERANCE) * target and drastic.take_next(target)


def _join(parts: list[np.ndarray], dtype: type) -> np.ndarray:
    return np.concatenate(parts).astype(dtype) if parts else np.zeros(0, dtype)


def name_constraint(engine: CollapseEngine, target: int) -> str:
    """Return a sentence that names what keeps the current vertices from being removed, the most frequent reason first."""
    topology = engine.topology
    is_kept = topology.is_used & ~topology.is_removable
    counts = {
        "{} at corners, crossings or ends of seams and boundaries": np.count_nonzero(is_kept & ~topology.is_locked),
        "{} at edges with more than two triangles or opposite orientations": np.count_nonzero(is_kept & topology.is_locked),
    }
    for reason, text in REFUSALS.items():
        counts[text] = np.count_nonzero(topology.is_removable & (engine.reasons == reason))
    parts = [text.format(count) for text, count in sorted(counts.items(), key=lambda item: -item[1]) if count]
    total = np.count_nonzero(topology.is_used)
    return f"{engine.triangle_count} triangles remain instead of {target}, because of {total} vertices these stay: {', '.join(parts)}."
