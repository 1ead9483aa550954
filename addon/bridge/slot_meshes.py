"""The faces that a level's quads show, as meshes lying in the slots of its atlas."""

from dataclasses import dataclass

import bpy
import numpy as np

from ..core.billboards.cloud import Level
from ..core.mesh import connected_parts
from .channels import INSIDE
from .meshes import Source
from .slots import Slots
from .surfaces import Surface
from .world_nodes import GENERATED, ISLAND, LOCATION, OBJECT, OBJECT_AXES, POSITION, QUAD_AXES, RANDOM

LAYER_TYPES = {1: ("FLOAT", "value"), 2: ("FLOAT2", "vector"), 3: ("FLOAT_VECTOR", "vector"), 4: ("FLOAT_COLOR", "color")}


@dataclass(frozen=True)
class Drawn:
    """K triangles of one surface that are drawn, each on one quad for one part: four arrays (K,) int, and the parts' matrices (P, 4, 4).

    primitives: their numbers in the source.
    """

    surface: Surface
    primitives: np.ndarray
    triangles: np.ndarray
    quads: np.ndarray
    parts: np.ndarray
    matrices: np.ndarray
    randoms: np.ndarray

    @property
    def corner_order(self) -> np.ndarray:
        """(K, 3): the corners of every triangle in the order that makes it face outwards."""
        mirrored = np.linalg.det(self.matrices[:, :3, :3]) < 0.0
        return np.where(mirrored[self.parts][:, None], [2, 1, 0], [0, 1, 2])

    def ordered(self, corners: np.ndarray) -> np.ndarray:
        """`corners` (K, 3, width) in `corner_order`."""
        return np.take_along_axis(corners, self.corner_order[:, :, None], axis=1)


def drawn_surfaces(source: Source, primitives: np.ndarray, quads: np.ndarray) -> list[Drawn]:
    """The `primitives` (D,) of `source`, each drawn on the one of `quads` (D,) beside it: one entry for each surface that a part has,
    however many parts share it."""
    firsts = np.array([part.first for part in source.parts])
    parts = np.searchsorted(firsts, primitives, side="right") - 1
    local = primitives - firsts[parts]
    surfaces = {id(part.surface): part.surface for part in source.parts}
    surface_of_part = np.array([list(surfaces).index(id(part.surface)) for part in source.parts])
    matrices, randoms = np.stack([part.matrix for part in source.parts]), np.array([part.random for part in source.parts])
    fan = np.arange(source.triangles_per_primitive)
    drawn = []
    for number, surface in enumerate(surfaces.values()):
        chosen = np.flatnonzero(surface_of_part[parts] == number)
        if len(chosen):
            triangles = (local[chosen][:, None] * len(fan) + fan).ravel()
            numbers, of_quad, of_part = (np.repeat(values[chosen], len(fan)) for values in (primitives, quads, parts))
            drawn.append(Drawn(surface, numbers, triangles, of_quad, of_part, matrices, randoms))
    return drawn


def slot_positions(drawn: Drawn, slots: Slots) -> tuple[np.ndarray, np.ndarray]:
    """World positions and positions in the slots of the corners of every drawn triangle, both (K, 3, 3) float64."""
    local = drawn.ordered(drawn.surface.vertices[drawn.surface.triangles[drawn.triangles]]).astype(np.float64)
    matrices = drawn.matrices[drawn.parts]
    world = np.einsum("kij,kcj->kci", matrices[:, :3, :3], local) + matrices[:, None, :3, 3]
    return world, slots.move(world, drawn.quads)


def places_inside(level: Level, slots: Slots, moved: np.ndarray, quads: np.ndarray) -> np.ndarray:
    """`moved` (K, 3, 3) as places (K, 3, 3) in the rectangles of `quads` (K,): -1..1 across each and half its gutter, third number 0."""
    half_sizes = 0.5 * level.texel * (level.atlas.rectangles[:, 2:] + level.atlas.gutter)
    places = (moved - slots.places[quads][:, None])[..., :2] / half_sizes[quads][:, None]
    return np.concatenate([places, np.zeros_like(places[..., :1])], axis=2)


def slot_mesh(
    name: str, drawn: Drawn, world: np.ndarray, moved: np.ndarray, inside: np.ndarray, slots: Slots, asked: set[str]
) -> bpy.types.Mesh:
    """A mesh of separate triangles at `moved` (K, 3, 3), with normals and those attributes whose names are in `asked`."""
    count = len(drawn.triangles)
    mesh = bpy.data.meshes.new(name)
    mesh.vertices.add(3 * count)
    mesh.loops.add(3 * count)
    mesh.polygons.add(count)
    mesh.vertices.foreach_set("co", moved.astype(np.float32).ravel())
    mesh.loops.foreach_set("vertex_index", np.arange(3 * count, dtype=np.int32))
    mesh.polygons.foreach_set("loop_start", np.arange(0, 3 * count, 3, dtype=np.int32))
    mesh.polygons.foreach_set("material_index", drawn.surface.material_indices[drawn.triangles])
    mesh.update(calc_edges=True)
    _write(mesh, "custom_normal", _slot_normals(drawn, slots))
    for layer in drawn.surface.attributes:
        if layer in asked or layer in (drawn.surface.uv_map, drawn.surface.color):
            _write(mesh, layer, drawn.ordered(drawn.surface.at_corners(layer, drawn.triangles)))
    for layer, values in _scene_layers(drawn, world, inside, slots, asked).items():
        _write(mesh, layer, values)
    if drawn.surface.uv_map:
        mesh.uv_layers[drawn.surface.uv_map].active_render = True
    if drawn.surface.color:
        mesh.attributes.default_color_name = drawn.surface.color
    return mesh


def _slot_normals(drawn: Drawn, slots: Slots) -> np.ndarray:
    """Shading normals (K, 3, 3) of the corners, turned with their quads."""
    local = drawn.ordered(drawn.surface.normals[drawn.surface.loops[drawn.triangles]]).astype(np.float64)
    to_world = np.linalg.pinv(drawn.matrices[:, :3, :3]).transpose(0, 2, 1)[drawn.parts]
    turned = np.einsum("kij,kjl,kcl->kci", slots.axes[drawn.quads], to_world, local, optimize=True)
    lengths = np.linalg.norm(turned, axis=2, keepdims=True)
    return turned / np.where(lengths > 0.0, lengths, 1.0)


def _scene_layers(drawn: Drawn, world: np.ndarray, inside: np.ndarray, slots: Slots, asked: set[str]) -> dict[str, np.ndarray]:
    """What the materials ask of the scene, as values (K, 3, width)."""
    surface = drawn.surface
    object_axes = drawn.matrices[:, :3, :3] / np.maximum(np.linalg.norm(drawn.matrices[:, :3, :3], axis=1, keepdims=True), 1e-300)
    makers = {
        POSITION: lambda: world,
        OBJECT: lambda: drawn.ordered(surface.vertices[surface.triangles[drawn.triangles]]),
        GENERATED: lambda: drawn.ordered(surface.generated[surface.triangles[drawn.triangles]]),
        INSIDE: lambda: inside,
        LOCATION: lambda: _thrice(drawn.matrices[drawn.parts, :3, 3]),
        RANDOM: lambda: _thrice(drawn.randoms[drawn.parts][:, None]),
        ISLAND: lambda: _thrice(_island_randoms(surface)[drawn.triangles][:, None]),
    }
    for index, name in enumerate(QUAD_AXES):
        makers[name] = lambda index=index: _thrice(slots.axes[drawn.quads, index])
    for index, name in enumerate(OBJECT_AXES):
        makers[name] = lambda index=index: _thrice(object_axes[drawn.parts, :, index])
    return {name: make() for name, make in makers.items() if name in asked}


def _thrice(values: np.ndarray) -> np.ndarray:
    """One value (K, width) a triangle as the same value at its three corners."""
    return np.repeat(values[:, None], 3, axis=1)


def _island_randoms(surface: Surface) -> np.ndarray:
    """A number 0..1 (T,) for each triangle, one for each of the connected parts. Evenly spread as Cycles' own, but not the same numbers."""
    islands = connected_parts(surface.vertices.astype(np.float64), surface.triangles)
    return np.random.default_rng(0).random(int(islands.max()) + 1)[islands]


def _write(mesh: bpy.types.Mesh, name: str, values: np.ndarray) -> None:
    """Add the layer `name` with `values` (K, 3, width) at the corners; pairs of numbers are made a UV map."""
    kind, key = LAYER_TYPES[values.shape[2]]
    layer = mesh.attributes.new(name, kind, "CORNER" if kind == "FLOAT2" else "POINT")
    layer.data.foreach_set(key, values.astype(np.float32).ravel())
