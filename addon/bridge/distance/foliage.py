"""Levels of foliage: fewer and larger leaves, and opaque pieces of those that opacity maps cut out, see `aggregates` and `cutouts`."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import bpy
import numpy as np

from ...core.distance.aggregates import AggregateLevel, Elements, count_triangles, find_elements, simplify_elements
from ...core.distance.cutouts import Cutouts, find_cutouts, place_pieces
from ...core.distance.levels import LevelCandidate
from ...core.geometry.mesh import face_areas_and_normals, longest_side
from ...core.jobs.progress import Progress, Steps
from ..geometry.evaluated_mesh import EvaluatedMesh, MaterialKey, MeshAttribute
from ..geometry.joined_meshes import join_instances
from ..geometry.meshes import SourceInstance, find_material
from .opacity_maps import OpacityMap, create_opaque, read_opacity_map
from .simplified_meshes import MIN_TRIANGLES, SimplifiedMesh, create_level, decimate

# Pixels of the levels that are tried, relative to the longest side.
PIXELS = 0.5 ** np.arange(14.0, 2.9, -0.5)
COST_RATIO = 0.3  # Of a level to the one before, at most; a wood shows all levels at once.


@dataclass(frozen=True)
class CutLeaves:
    """Elements that opacity maps cut out.

    Attributes:
        cutouts: their pieces.
        maps: opacity map by index of the material.
        opaque: key of the same material without opacity, by the same index.
    """

    cutouts: Cutouts
    maps: dict[int, OpacityMap]
    opaque: dict[int, MaterialKey]


@dataclass(frozen=True)
class Foliage:
    """An object that is foliage. leaves: those that are cut out, None without any."""

    evaluated: EvaluatedMesh
    elements: Elements
    leaves: CutLeaves | None

    @property
    def transparent_triangles(self) -> int:
        """The number of triangles of leaves that are cut out."""
        return (
            0 if self.leaves is None else int(self.leaves.cutouts.is_cut[self.elements.of_triangles[self.elements.of_triangles >= 0]].sum())
        )


def find_foliage(evaluated: EvaluatedMesh) -> Foliage | None:
    """Return the leaves of a mesh, None if it is no foliage."""
    elements = find_elements(evaluated.vertices, evaluated.triangles)
    return None if elements is None else Foliage(evaluated, elements, _find_cut_leaves(evaluated, elements))


def simplify_foliage(item: bpy.types.Object, foliage: Foliage, scene: bpy.types.Scene) -> Steps[list[SimplifiedMesh]]:
    """Return levels of an object that is foliage, finest first. `scene` is a temporary one, for Decimate."""
    yield Progress(0.0, "Simplifying branches")
    evaluated, elements, leaves = foliage.evaluated, foliage.elements, foliage.leaves
    rest = np.flatnonzero(elements.of_triangles < 0)
    branches: list[tuple[EvaluatedMesh | None, float]] = [(_select_triangles(evaluated, rest) if len(rest) else None, 0.0)]
    side = longest_side(evaluated.vertices)
    if len(rest):
        branches += decimate(branches[0][0], scene, side)
    levels: list[SimplifiedMesh] = []
    previous = LevelCandidate(len(evaluated.triangles), 0.0, foliage.transparent_triangles)
    for step, pixel_size in enumerate((side * PIXELS).tolist()):
        branch = next(mesh for mesh, size in reversed(branches) if size <= pixel_size)
        counts = count_triangles(elements, pixel_size)
        pieces, transparent, is_replaced = 0, 0, np.zeros(len(counts), bool)
        if leaves is not None:
            is_replaced = leaves.cutouts.is_replaced(pixel_size)
            pieces = leaves.cutouts.count_triangles(pixel_size, elements.ranks)
            transparent = int(counts[leaves.cutouts.is_cut & ~is_replaced].sum())
        triangles = int(counts[~is_replaced].sum()) + pieces + (0 if branch is None else len(branch.triangles))
        candidate = LevelCandidate(triangles, pixel_size, transparent)
        if candidate.cost > COST_RATIO * previous.cost or triangles < MIN_TRIANGLES:
            continue
        yield Progress(step / len(PIXELS), "Dropping leaves")
        parts = [_create_leaves(evaluated, simplify_elements(elements, pixel_size, is_replaced))]
        parts += [] if branch is None else [branch]
        parts += _create_pieces(foliage, pixel_size) if pieces else []
        levels.append(create_level(item, _join([part for part in parts if len(part.triangles)]), pixel_size, transparent))
        previous = candidate
    return levels


def _find_cut_leaves(evaluated: EvaluatedMesh, elements: Elements) -> CutLeaves | None:
    """Return the elements whose material has an opacity map that opaque pieces can stand for."""
    used = np.unique(evaluated.material_indices[elements.of_triangles >= 0]).tolist()
    maps, opaque = {}, {}
    for index in used:
        key = evaluated.materials[index]
        found = None if key is None else read_opacity_map(find_material(key))
        if found is None or found.find_uv_map(evaluated) not in evaluated.attributes:
            continue
        material = create_opaque(find_material(key))
        if material is not None:
            maps[index], opaque[index] = found, (material.name, None)
    if not maps:
        return None
    rows = np.flatnonzero(elements.of_triangles >= 0)
    other = ~np.isin(evaluated.material_indices[rows], list(maps))
    is_cut = np.bincount(elements.of_triangles[rows], other, minlength=len(elements.centers)) == 0

    def read_opacity(triangles: np.ndarray, weights: np.ndarray) -> np.ndarray:
        result = np.ones(len(triangles))
        for index, opacity in maps.items():
            chosen = evaluated.material_indices[triangles] == index
            uvs = np.einsum("nk,nkc->nc", weights[chosen], opacity.read_uvs(evaluated, triangles[chosen]))
            result[chosen] = opacity.sample(uvs)
        return result

    cutouts = find_cutouts(evaluated.vertices, evaluated.triangles, elements.of_triangles, is_cut, read_opacity)
    return CutLeaves(cutouts, maps, opaque)


def _create_leaves(evaluated: EvaluatedMesh, level: AggregateLevel) -> EvaluatedMesh:
    corners = 3 * level.kept[:, None] + np.arange(3)
    positions = np.concatenate([evaluated.vertices[evaluated.triangles[level.kept]], level.positions])
    is_flat = np.concatenate([np.zeros(len(corners), bool), level.is_flat])
    return _select_corners(evaluated, positions, np.concatenate([corners, level.sources]), is_flat)


def _create_pieces(foliage: Foliage, pixel_size: float) -> list[EvaluatedMesh]:
    """Return meshes of the opaque pieces where a pixel has this size, one for each material."""
    evaluated, leaves = foliage.evaluated, foliage.leaves
    points = leaves.cutouts.choose(pixel_size, foliage.elements.ranks)
    indices = evaluated.material_indices[leaves.cutouts.triangles[points]]
    found = []
    for index in np.unique(indices).tolist():
        opacity, chosen = leaves.maps[index], points[indices == index]
        uvs = opacity.read_uvs(evaluated, leaves.cutouts.triangles[chosen])
        pieces = place_pieces(evaluated.vertices, evaluated.triangles, uvs, leaves.cutouts, chosen, pixel_size)
        nearest = pieces.weights.mean(axis=1).argmax(axis=1)
        corners = np.repeat(3 * pieces.sources + nearest, 3).reshape(-1, 3)
        mesh = _select_corners(evaluated, pieces.positions, corners, np.zeros(len(corners), bool))
        values = np.einsum("nck,nki->nci", pieces.weights, opacity.read_uvs(evaluated, pieces.sources)).reshape(-1, 2).astype(np.float32)
        material_indices = np.zeros(len(corners), np.int32)
        attributes = mesh.attributes | {opacity.find_uv_map(evaluated): MeshAttribute("CORNER", values)}
        normals = np.where(np.repeat(pieces.is_back, 3)[:, None], -mesh.normals, mesh.normals)
        found.append(
            replace(mesh, normals=normals, materials=(leaves.opaque[index],), material_indices=material_indices, attributes=attributes)
        )
    return found


def _select_triangles(evaluated: EvaluatedMesh, triangles: np.ndarray) -> EvaluatedMesh:
    """Return some triangles of a mesh."""
    corners = 3 * triangles[:, None] + np.arange(3)
    return _select_corners(evaluated, evaluated.vertices[evaluated.triangles[triangles]], corners, np.zeros(len(triangles), bool))


def _select_corners(evaluated: EvaluatedMesh, positions: np.ndarray, sources: np.ndarray, is_flat: np.ndarray) -> EvaluatedMesh:
    """Return triangles with corners at `positions` (N, 3, 3), and everything else from the corners `sources` (N, 3) of a mesh,
    3 * triangle + corner; those that are flat (N,) have the normals of their faces."""
    faces, corners = sources // 3, sources % 3
    indices = np.arange(sources.size, dtype=np.int32).reshape(-1, 3)
    normals = evaluated.normals[evaluated.loops[faces, corners]]
    _, face_normals = face_areas_and_normals(positions)
    normals = np.where(is_flat[:, None, None], face_normals[:, None], normals).astype(np.float32)
    attributes = {
        name: MeshAttribute("POINT" if attribute.domain == "POINT" else "CORNER", _at_corners(evaluated, attribute, faces, corners))
        for name, attribute in evaluated.attributes.items()
    }
    return replace(
        evaluated,
        vertices=positions.reshape(-1, 3).astype(np.float32),
        triangles=indices,
        loops=indices,
        polygons=np.arange(len(sources), dtype=np.int32),
        normals=normals.reshape(-1, 3),
        generated=evaluated.generated[evaluated.triangles[faces, corners]].reshape(-1, 3),
        material_indices=evaluated.material_indices[faces[:, 0]],
        attributes=attributes,
    )


def _at_corners(evaluated: EvaluatedMesh, attribute: MeshAttribute, faces: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Return the values (3 N, width) of an attribute at corners (N, 3) of a mesh."""
    if attribute.domain == "CORNER":
        rows = evaluated.loops[faces, corners]
    else:
        rows = evaluated.triangles[faces, corners] if attribute.domain == "POINT" else evaluated.polygons[faces]
    return attribute.values[rows.ravel()]


def _join(meshes: Sequence[EvaluatedMesh]) -> EvaluatedMesh:
    if len(meshes) == 1:
        return meshes[0]
    return join_instances([SourceInstance("", mesh, np.eye(4), 0) for mesh in meshes], np.eye(4))
