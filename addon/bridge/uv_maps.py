"""Meshes as what is unwrapped, and UV maps back into them."""

from dataclasses import dataclass

import bpy
import numpy as np

from ..core.errors import GeometryError
from ..core.mesh import TriangleMesh

STRETCH = "farfield_stretch"  # attribute of faces: the largest stretch of their triangles
PINS = ".pn."  # before the name of a UV map: the attribute of its corners that are pinned
KEPT = "farfield_unwrap"  # custom property of a mesh


@dataclass(frozen=True)
class UvTarget:
    """A mesh, or some faces of it, without pointers into Blender.

    key: of bpy.data.meshes. name: of its object. mesh: in world space, wound as in Blender. rest (R, 3): triangles that were not taken.
    loops (T, 3), polygons (T,): of those that were. seams (S, 2): vertices. outwards: -1 where the object's matrix mirrors, so that normals
    of `mesh` look inwards, else 1. painted (V,): weights of the vertex group that was asked for, 0 without one.
    """

    key: str
    name: str
    mesh: TriangleMesh
    rest: np.ndarray
    loops: np.ndarray
    polygons: np.ndarray
    seams: np.ndarray
    outwards: float
    painted: np.ndarray


def take(item: bpy.types.Object, group: str | None) -> UvTarget:
    """The mesh of an object as it is stored, since its modifiers get their UVs from there; in Edit Mode its selected faces alone.

    group: the vertex group to read, the active one when empty; None for none.

    Raises:
        GeometryError: when there is no face to take, or no such group.
    """
    mesh = item.data
    editing = item.mode == "EDIT"
    if editing:
        item.update_from_editmode()
    loops, polygons = drawn_triangles(mesh)
    corners = np.empty(len(mesh.loops), np.int32)
    mesh.loops.foreach_get("vertex_index", corners)
    chosen = np.ones(len(loops), bool)
    if editing:
        selected = np.empty(len(mesh.polygons), bool)
        mesh.polygons.foreach_get("select", selected)
        chosen = selected[polygons]
    if not chosen.any():
        raise GeometryError(f'"{item.name}" has no {"selected " if editing else ""}faces to unwrap; select some.')
    vertices = np.empty(3 * len(mesh.vertices), np.float32)
    mesh.vertices.foreach_get("co", vertices)
    matrix = np.array(item.matrix_world, np.float64)
    placed = vertices.reshape(-1, 3).astype(np.float64) @ matrix[:3, :3].T + matrix[:3, 3]
    return UvTarget(
        key=mesh.name,
        name=item.name,
        mesh=TriangleMesh(placed, corners[loops[chosen]]),
        rest=corners[loops[~chosen]],
        loops=loops[chosen],
        polygons=polygons[chosen],
        seams=_seams(mesh),
        outwards=-1.0 if np.linalg.det(matrix[:3, :3]) < 0.0 else 1.0,
        painted=np.zeros(len(mesh.vertices)) if group is None else _painted(item, group),
    )


def drawn_triangles(mesh: bpy.types.Mesh) -> tuple[np.ndarray, np.ndarray]:
    """The triangles that Blender draws of a mesh: loops (T, 3) at their corners, and polygons (T,)."""
    mesh.calc_loop_triangles()
    loops, polygons = np.empty(3 * len(mesh.loop_triangles), np.int32), np.empty(len(mesh.loop_triangles), np.int32)
    mesh.loop_triangles.foreach_get("loops", loops)
    mesh.loop_triangles.foreach_get("polygon_index", polygons)
    return loops.reshape(-1, 3), polygons


def refusal(item: bpy.types.Object, uv_map: str) -> str:
    """Why no UV map of that name can be written into an object's mesh, or an empty string."""
    if item.type != "MESH":
        return f"a {item.type.replace('_', ' ').lower()} has no UV map"
    mesh = item.data
    if not mesh.is_editable:
        return "its mesh is linked from another file; make it local"
    if len(mesh.polygons) == 0:
        return "no faces"
    layer = mesh.uv_layers.get(uv_map)
    if layer is None:
        if uv_map in mesh.attributes:
            return f'"{uv_map}" is the name of another attribute; give another one'
        return "it has eight UV maps, as many as there can be; remove one" if len(mesh.uv_layers) >= 8 else ""
    pins = mesh.attributes.get(PINS + uv_map)
    return f'its UV map "{uv_map}" has pinned corners; unpin them' if pins is not None and any(each.value for each in pins.data) else ""


def write(target: UvTarget, corners: np.ndarray, stretches: np.ndarray, uv_map: str, figures: dict[str, float]) -> None:
    """Give a mesh the UV map `corners` (T, 3, 2) of its triangles, their stretch (T,) as an attribute, and keep the figures with it.

    Raises:
        GeometryError: when the mesh has gone or is not the one any more that was taken.
    """
    mesh = bpy.data.meshes.get(target.key)
    if mesh is None or len(mesh.loops) <= int(target.loops.max()) or len(mesh.polygons) <= int(target.polygons.max()):
        raise GeometryError(f'The mesh of "{target.name}" was removed or edited while it was being unwrapped; unwrap it again.')
    layer = mesh.uv_layers.get(uv_map) or mesh.uv_layers.new(name=uv_map, do_init=False)
    mesh.uv_layers.active = layer
    uvs = uvs_of(layer)
    uvs[target.loops] = corners
    layer.uv.foreach_set("vector", uvs.ravel())
    attribute = mesh.attributes.get(STRETCH) or mesh.attributes.new(STRETCH, "FLOAT", "FACE")
    shown = np.empty(len(mesh.polygons), np.float32)
    attribute.data.foreach_get("value", shown)
    shown[target.polygons] = 0.0
    np.maximum.at(shown, target.polygons, np.minimum(stretches, np.finfo(np.float32).max).astype(np.float32))
    attribute.data.foreach_set("value", shown)
    mesh[KEPT] = figures
    mesh.update()


@dataclass(frozen=True)
class StretchedMap:
    """The active UV map of a mesh and its stretch. loops (T, 3): of its triangles. uvs (L, 2) float32. stretches (T,) float32."""

    loops: np.ndarray
    uvs: np.ndarray
    stretches: np.ndarray


def stretched_map(mesh: bpy.types.Mesh) -> StretchedMap | None:
    """What `write` left in a mesh; None where it has not been unwrapped, or is being edited."""
    attribute, layer = mesh.attributes.get(STRETCH), mesh.uv_layers.active
    if attribute is None or layer is None or len(attribute.data) != len(mesh.polygons):  # Edit Mode keeps its data elsewhere
        return None
    loops, polygons = drawn_triangles(mesh)
    stretches = np.empty(len(mesh.polygons), np.float32)
    attribute.data.foreach_get("value", stretches)
    return StretchedMap(loops, uvs_of(layer), stretches[polygons])


def uvs_of(layer: bpy.types.MeshUVLoopLayer) -> np.ndarray:
    """What a UV map holds, (L, 2) float32."""
    uvs = np.empty(2 * len(layer.uv), np.float32)
    layer.uv.foreach_get("vector", uvs)
    return uvs.reshape(-1, 2)


def figures_of(mesh: bpy.types.Mesh) -> dict[str, float | list[float]]:
    """What `write` kept with a mesh; empty where it has not been unwrapped."""
    return mesh[KEPT].to_dict() if KEPT in mesh else {}


def _seams(mesh: bpy.types.Mesh) -> np.ndarray:
    edges, seams = np.empty(2 * len(mesh.edges), np.int32), np.empty(len(mesh.edges), bool)
    mesh.edges.foreach_get("vertices", edges)
    mesh.edges.foreach_get("use_seam", seams)
    return edges.reshape(-1, 2)[seams]


def _painted(item: bpy.types.Object, group: str) -> np.ndarray:
    found = item.vertex_groups.get(group) if group else item.vertex_groups.active
    if found is None:
        wanted = f'no vertex group "{group}"' if group else "no vertex group"
        raise GeometryError(f'"{item.name}" has {wanted}; paint one, or choose another kind of importance.')
    weights = np.zeros(len(item.data.vertices))
    for vertex in item.data.vertices:
        for member in vertex.groups:
            if member.group == found.index:
                weights[vertex.index] = member.weight
    return np.clip(weights, 0.0, 1.0)
