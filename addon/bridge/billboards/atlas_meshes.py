"""The plane of a level's atlas, where its textures are captured: the placement of quads, and meshes of the faces that they show.

In the atlas plane one atlas is `texel * width` by `texel * height` large and centered on the origin. A quad keeps its size; its u, v and
normal lie along x, y and z. Lengths, and thus the heights of bumps, are the same as in the scene.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache, partial
from typing import TypeVar

import bpy
import numpy as np

from ...core.arrays import TINY
from ...core.billboards.cloud import Level
from ...core.geometry.mesh import connected_components
from ...core.geometry.transforms import is_mirroring, normalize
from ..geometry.evaluated_mesh import EvaluatedMesh
from ..geometry.mesh_arrays import write_attribute, write_triangles
from ..geometry.meshes import Source, SourceInstance, find_material
from ..rendering.render_scene import RenderScene
from ..shading.material_channels import CELL_COORDINATES
from ..shading.scene_space_nodes import (
    GENERATED,
    INSTANCER_VALUE,
    ISLAND,
    LOCATION,
    OBJECT,
    OBJECT_AXES,
    OBJECT_VALUE,
    POSITION,
    QUAD_AXES,
    RANDOM,
    read_object_value,
    required_attributes,
    to_rgba,
)

Copy = TypeVar("Copy")
HEIGHT_RANGE = 0.01  # In errors. The depth that is captured is corrected by it.
GOLDEN_RATIO = (5.0**0.5 - 1.0) / 2.0


@dataclass(frozen=True)
class AtlasPlacement:
    """Transforms of Q quads into the atlas plane: p -> scale * axes @ (p - center) + position.

    centers (Q, 3) in world space; axes (Q, 3, 3), rows u, v, n; positions (Q, 3) in the atlas plane, z = 0; scales (Q,), less than 1 only
    where a quad has fewer texels than its size.
    """

    centers: np.ndarray
    axes: np.ndarray
    positions: np.ndarray
    scales: np.ndarray

    def to_atlas(self, points: np.ndarray, quads: np.ndarray) -> np.ndarray:
        """Transform world points (N, K, 3), K on each of the quads `quads` (N,), to the atlas plane."""
        local = np.einsum("nij,nkj->nki", self.axes[quads], points - self.centers[quads][:, None])
        return self.scales[quads][:, None, None] * local + self.positions[quads][:, None]

    def to_world(self, points: np.ndarray, quads: np.ndarray) -> np.ndarray:
        """Transform `points` (N, 2) of the atlas plane to world positions (N, 3) on the quads `quads` (N,): the inverse of `to_atlas`."""
        local = (points - self.positions[quads, :2]) / self.scales[quads, None]
        return self.centers[quads] + np.einsum("ni,nij->nj", local, self.axes[quads, :2])


def compute_placement(level: Level) -> AtlasPlacement:
    """Compute the placement of every quad of `level`, centered on the rectangles of its atlas."""
    rectangles = level.atlas.rectangles.astype(np.float64)
    rectangle_centers = rectangles[:, :2] + 0.5 * rectangles[:, 2:] - 0.5 * np.array(level.atlas.size, np.float64)
    positions = np.column_stack([level.texel_size * rectangle_centers, np.zeros(len(rectangle_centers))])
    half_texel = 0.5 * level.texel_size  # A quad that is smaller than its one texel is not enlarged.
    scales = half_texel * level.atlas.quad_sizes / np.maximum(level.quads.half_sizes, half_texel)
    return AtlasPlacement(level.quads.centers, level.quads.frames, positions, np.minimum(scales.min(axis=1), 1.0))


def compute_uvs(level: Level, placement: AtlasPlacement, quad: int, cutout: np.ndarray) -> np.ndarray:
    """Compute the UVs (C, 2) of the points `cutout` (C, 2), in -1..1 of the half sizes of one `quad`."""
    points = placement.positions[quad, :2] + placement.scales[quad] * cutout * level.quads.half_sizes[quad]
    return points / (level.texel_size * np.array(level.atlas.size)) + 0.5


@dataclass(frozen=True)
class DrawnTriangles:
    """K triangles of one mesh, each drawn on one quad for one of the source's P instances of the mesh.

    Attributes:
        mesh: The mesh.
        primitives: (K,) int, indices into the source's primitives.
        triangles: (K,) int, indices into the mesh's triangles.
        quads: (K,) int, indices into the level's quads.
        instances: (K,) int, indices into the source's instances.
        matrices: (P, 4, 4) of the instances.
        instance_randoms: (P,) random numbers of the instances, 0 to 1.
        sources: the P instances.
    """

    mesh: EvaluatedMesh
    primitives: np.ndarray
    triangles: np.ndarray
    quads: np.ndarray
    instances: np.ndarray
    matrices: np.ndarray
    instance_randoms: np.ndarray
    sources: Sequence[SourceInstance]

    @property
    def corner_order(self) -> np.ndarray:
        """(K, 3) corner indices of every triangle in the order that makes it face outwards, reversed in mirrored instances."""
        mirrored = is_mirroring(self.matrices)
        return np.where(mirrored[self.instances][:, None], [2, 1, 0], [0, 1, 2])

    def reorder_corners(self, corners: np.ndarray) -> np.ndarray:
        """Return the corner values `corners` (K, 3, width) in `corner_order`."""
        return np.take_along_axis(corners, self.corner_order[:, :, None], axis=1)


def find_drawn_triangles(source: Source, primitives: np.ndarray, quads: np.ndarray) -> list[DrawnTriangles]:
    """Return the triangles of the `primitives` (D,) of `source`, drawn on `quads` (D,): one entry per distinct mesh of the instances."""
    first_primitives = np.array([instance.first_primitive for instance in source.instances])
    instances = np.searchsorted(first_primitives, primitives, side="right") - 1
    local = primitives - first_primitives[instances]
    meshes = {id(instance.mesh): instance.mesh for instance in source.instances}
    mesh_of_instance = np.array([list(meshes).index(id(instance.mesh)) for instance in source.instances])
    matrices = np.stack([instance.matrix for instance in source.instances])
    instance_randoms = np.array([instance.random for instance in source.instances])
    fan = np.arange(source.triangles_per_primitive)
    drawn = []
    for index, mesh in enumerate(meshes.values()):
        selected = np.flatnonzero(mesh_of_instance[instances] == index)
        if len(selected):
            triangles = (local[selected][:, None] * len(fan) + fan).ravel()
            per_triangle = (np.repeat(values[selected], len(fan)) for values in (primitives, quads, instances))
            primitive_of, quad_of, instance_of = per_triangle
            drawn.append(DrawnTriangles(mesh, primitive_of, triangles, quad_of, instance_of, matrices, instance_randoms, source.instances))
    return drawn


def compute_atlas_positions(drawn: DrawnTriangles, placement: AtlasPlacement) -> tuple[np.ndarray, np.ndarray]:
    """Compute the corners of every drawn triangle in world space and in the atlas plane, both (K, 3, 3) float64."""
    local = drawn.reorder_corners(drawn.mesh.vertices[drawn.mesh.triangles[drawn.triangles]]).astype(np.float64)
    matrices = drawn.matrices[drawn.instances]
    world = np.einsum("kij,kcj->kci", matrices[:, :3, :3], local) + matrices[:, None, :3, 3]
    return world, placement.to_atlas(world, drawn.quads)


def separate_heights(quads: np.ndarray | int, error: float) -> np.ndarray:
    """Return heights (K,) that lift what is drawn on `quads` (K,) out of one common plane, by at most HEIGHT_RANGE of `error`.

    A ray that has passed a transparent surface, such as a face that is cut to the rectangle of another quad, does not meet a second one at
    the same distance. With the golden ratio, quads with similar numbers differ most.
    """
    return HEIGHT_RANGE * error * (quads * GOLDEN_RATIO % 1.0)


def compute_cell_coordinates(level: Level, placement: AtlasPlacement, flat: np.ndarray, quads: np.ndarray) -> np.ndarray:
    """Compute where `flat` (K, 3, 3), points of the atlas plane, lie in the rectangles of `quads` (K,).

    Returns (K, 3, 3): -1..1 across each rectangle; the third component is 0.
    """
    half_sizes = 0.5 * level.texel_size * level.atlas.rectangles[:, 2:]
    coordinates = (flat - placement.positions[quads][:, None])[..., :2] / half_sizes[quads][:, None]
    return np.concatenate([coordinates, np.zeros_like(coordinates[..., :1])], axis=2)


def copy_materials(
    source: Source,
    drawn: DrawnTriangles,
    copies: dict[tuple, Copy],
    copy_material: Callable[[bpy.types.Material | None, str], Copy],
    clip: bool = False,
) -> list[Copy]:
    """Return a copy per material slot of the mesh of `drawn`: those that `copies` has, and otherwise new ones, which are added to it.

    copy_material: returns the copy of a material, or of None. Its second argument is the color attribute that a point cloud without
    material shows, or "". clip: materials that clip need copies of their own.
    """
    color_attribute = drawn.mesh.color if source.points is not None else ""
    keys = [(material, color_attribute, clip) for material in drawn.mesh.materials]
    for key in keys:
        if key not in copies:
            copies[key] = copy_material(None if key[0] is None else find_material(key[0]), color_attribute)
    return [copies[key] for key in keys]


def add_atlas_mesh(
    work: RenderScene,
    drawn: DrawnTriangles,
    world: np.ndarray,
    flat: np.ndarray,
    cell_coordinates: np.ndarray,
    placement: AtlasPlacement,
    materials: Sequence[bpy.types.Material],
) -> bpy.types.Mesh:
    """Add a mesh of separate triangles at `flat` (K, 3, 3) with `materials`, the attributes that these read, and shading normals to `work`.

    world (K, 3, 3): the same corners in world space. cell_coordinates: see `compute_cell_coordinates`.
    """
    required = set().union(*(required_attributes(material.node_tree) for material in materials))
    mesh = work.own(bpy.data.meshes.new("Farfield Atlas"))
    write_triangles(mesh, flat.reshape(-1, 3), np.arange(3 * len(drawn.triangles)).reshape(-1, 3))
    mesh.polygons.foreach_set("material_index", drawn.mesh.material_indices[drawn.triangles])
    _write_attribute(mesh, "custom_normal", _compute_normals(drawn, placement))
    for attribute in drawn.mesh.attributes:
        if attribute in required or attribute in (drawn.mesh.uv_map, drawn.mesh.color):
            _write_attribute(mesh, attribute, drawn.reorder_corners(drawn.mesh.at_corners(attribute, drawn.triangles)))
    for attribute, values in _scene_space_attributes(drawn, world, cell_coordinates, placement, required).items():
        _write_attribute(mesh, attribute, values)
    if drawn.mesh.uv_map:
        mesh.uv_layers[drawn.mesh.uv_map].active_render = True
    if drawn.mesh.color:
        mesh.attributes.default_color_name = drawn.mesh.color
    for material in materials:
        mesh.materials.append(material)
    work.add_object(mesh)
    return mesh


def _compute_normals(drawn: DrawnTriangles, placement: AtlasPlacement) -> np.ndarray:
    """Compute the shading normals (K, 3, 3) of the corners, rotated with their quads."""
    local = drawn.reorder_corners(drawn.mesh.normals[drawn.mesh.loops[drawn.triangles]]).astype(np.float64)
    to_world = np.linalg.pinv(drawn.matrices[:, :3, :3]).transpose(0, 2, 1)[drawn.instances]
    return normalize(np.einsum("kij,kjl,kcl->kci", placement.axes[drawn.quads], to_world, local, optimize=True))


def _scene_space_attributes(
    drawn: DrawnTriangles, world: np.ndarray, cell_coordinates: np.ndarray, placement: AtlasPlacement, required: set[str]
) -> dict[str, np.ndarray]:
    """Compute the scene-space attributes that the materials read, as values (K, 3, width), see `scene_space_nodes`."""
    mesh = drawn.mesh
    object_axes = drawn.matrices[:, :3, :3] / np.maximum(np.linalg.norm(drawn.matrices[:, :3, :3], axis=1, keepdims=True), TINY)
    compute = {
        POSITION: lambda: world,
        OBJECT: lambda: drawn.reorder_corners(mesh.vertices[mesh.triangles[drawn.triangles]]),
        GENERATED: lambda: drawn.reorder_corners(mesh.generated[mesh.triangles[drawn.triangles]]),
        CELL_COORDINATES: lambda: cell_coordinates,
        LOCATION: lambda: _to_corners(drawn.matrices[drawn.instances, :3, 3]),
        RANDOM: lambda: _to_corners(drawn.instance_randoms[drawn.instances][:, None]),
        ISLAND: lambda: _to_corners(_island_randoms(mesh)[drawn.triangles][:, None]),
    }
    for index, name in enumerate(QUAD_AXES):
        compute[name] = lambda index=index: _to_corners(placement.axes[drawn.quads, index])
    for index, name in enumerate(OBJECT_AXES):
        compute[name] = lambda index=index: _to_corners(object_axes[drawn.instances, :, index])
    for name in required:
        for prefix in (OBJECT_VALUE, INSTANCER_VALUE):
            if name.startswith(prefix):
                compute[name] = lambda name=name, prefix=prefix: _to_corners(_read_values(drawn.sources, prefix, name)[drawn.instances])
    return {name: function() for name, function in compute.items() if name in required}


def _read_values(instances: Sequence[SourceInstance], prefix: str, name: str) -> np.ndarray:
    """Return what materials read of each of the P `instances` as `name`, which begins with OBJECT_VALUE or INSTANCER_VALUE as `prefix`:
    (P, 4). It is 0 for objects that were removed."""
    by_uid = {item.session_uid: item for item in bpy.data.objects}
    name, is_of_instancer = name.removeprefix(prefix), prefix == INSTANCER_VALUE
    read_items = cache(partial(read_object_value, name=name))
    values = []
    for instance in instances:
        owner, part = by_uid.get(instance.object_uid), bpy.data.objects.get(instance.part) if instance.part else None
        if is_of_instancer and name in instance.attributes:
            values.append(to_rgba(instance.attributes[name]))
        else:
            items = (owner, part) if is_of_instancer else (part if instance.part else owner,)
            values.append(read_items(tuple(item for item in items if item is not None)))
    return np.array(values)


def _to_corners(values: np.ndarray) -> np.ndarray:
    """Repeat `values` (K, width) per triangle for its three corners."""
    return np.repeat(values[:, None], 3, axis=1)


def _island_randoms(mesh: EvaluatedMesh) -> np.ndarray:
    """Return a random number 0..1 per connected component, for each triangle (T,). Uniform as in Cycles, but not the same numbers."""
    components = connected_components(mesh.vertices.astype(np.float64), mesh.triangles)
    return np.random.default_rng(0).random(int(components.max()) + 1)[components]


def _write_attribute(mesh: bpy.types.Mesh, name: str, values: np.ndarray) -> None:
    """Add the attribute `name` with `values` (K, 3, width) at the corners. Values of width 2 become a UV map."""
    write_attribute(mesh, name, "CORNER" if values.shape[2] == 2 else "POINT", values)
