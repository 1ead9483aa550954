"""Reads meshes for unwrapping, and writes UV maps, their stretch and their metrics into meshes."""

from collections.abc import Iterable
from dataclasses import dataclass

import bpy
import idprop
import numpy as np

from ...core.errors import GeometryError
from ...core.geometry.mesh import TriangleMesh, face_areas_and_normals
from ...core.geometry.transforms import is_mirroring, transform_points
from ...core.unwrap.texture import Texture, compute_texel_density
from ..geometry.mesh_arrays import read_attribute, read_loop_triangles, read_loop_vertices, read_positions, read_uvs, read_values, write_uvs
from ..geometry.meshes import describe_type, is_collection_instance, is_in_view_layer
from ..objects import find_by_uid

STRETCH_ATTRIBUTE = "farfield_stretch"  # Face attribute: the stretch farthest from 1 of the triangles of a polygon.
PIN_PREFIX = ".pn."  # The attribute with the pinned corners of a UV map has this before the map's name.
METRICS_PROPERTY = "farfield_unwrap"  # Custom property of a mesh.
DENSITIES_PROPERTY = "texel_densities"  # Among the metrics: texels per meter of each UV map.
MAX_UV_MAPS = 8  # Per mesh.


@dataclass(frozen=True)
class UvTarget:
    """A mesh, or some polygons of it, to unwrap. Holds no pointers into Blender.

    Attributes:
        mesh_uid: Session UID of the mesh, which stays when it is renamed.
        object_name: Name of the object.
        mesh: The triangles to unwrap, in world space, wound as in Blender.
        other_triangles: (R, 3) of polygons that are not unwrapped.
        loops: (T, 3) of the triangles of `mesh`.
        polygon_ids: (T,) polygon of each triangle.
        seams: (S, 2) vertices.
        normal_sign: -1 where the object's matrix mirrors, so that normals of `mesh` point inwards, else 1.
        group_weights: (V,) weights of the vertex group, 0 without one.
    """

    mesh_uid: int
    object_name: str
    mesh: TriangleMesh
    other_triangles: np.ndarray
    loops: np.ndarray
    polygon_ids: np.ndarray
    seams: np.ndarray
    normal_sign: float
    group_weights: np.ndarray


def read_uv_target(item: bpy.types.Object, vertex_group: str | None) -> UvTarget:
    """Read the original mesh of an object, before modifiers, since these inherit its UVs; in Edit Mode only its selected polygons.

    vertex_group: name of the group to read, "" for the active one, None for none.

    Raises:
        GeometryError: there are no polygons to unwrap, or no such group.
    """
    mesh = item.data
    is_editing = item.mode == "EDIT"
    if is_editing:
        item.update_from_editmode()
    loops, polygons = read_loop_triangles(mesh)
    loop_vertices = read_loop_vertices(mesh)
    is_selected = np.ones(len(loops), bool)
    if is_editing:
        is_selected = read_values(mesh.polygons, "select", dtype=bool)[polygons]
    if not is_selected.any():
        raise GeometryError(f'"{item.name}" has no {"selected " if is_editing else ""}faces to unwrap; select some.')
    matrix = np.array(item.matrix_world, np.float64)
    with np.errstate(over="ignore", invalid="ignore"):  # A later check reports coordinates that are not finite.
        positions = transform_points(matrix, read_positions(mesh))
        is_mirrored = is_mirroring(matrix)
    return UvTarget(
        mesh_uid=mesh.session_uid,
        object_name=item.name,
        mesh=TriangleMesh(positions, loop_vertices[loops[is_selected]]),
        other_triangles=loop_vertices[loops[~is_selected]],
        loops=loops[is_selected],
        polygon_ids=polygons[is_selected],
        seams=read_values(mesh.edges, "vertices", 2, np.int32)[read_values(mesh.edges, "use_seam", dtype=bool)],
        normal_sign=-1.0 if is_mirrored else 1.0,
        group_weights=np.zeros(len(mesh.vertices)) if vertex_group is None else _read_vertex_group(item, vertex_group),
    )


def read_unit_length(scene: bpy.types.Scene) -> float:
    """Return the length of a Blender unit in meters."""
    units = scene.unit_settings
    return 1.0 if units.system == "NONE" else units.scale_length


def measure_texel_densities(
    mesh: bpy.types.Mesh, target: UvTarget, uv_maps: Iterable[str], texture: Texture, unit_length: float
) -> dict[str, float]:
    """Return the texels per meter, on average, of the triangles of `target` in UV maps of its mesh, which is not in Edit Mode."""
    area = float(face_areas_and_normals(target.mesh.corners)[0].sum()) * unit_length**2
    return {name: compute_texel_density(read_uvs(mesh.uv_layers[name])[target.loops].astype(np.float64), area, texture) for name in uv_maps}


def skip_reason(item: bpy.types.Object, uv_map: str) -> str:
    """Return why no UV map of this name can be written into an object's mesh, or an empty string."""
    if is_collection_instance(item):
        return "it is an instance of a collection; make it real, or unwrap the meshes of the collection"
    if item.type != "MESH":
        return f"{describe_type(item)} has no UV map"
    mesh = item.data
    if not mesh.is_editable:
        return "its mesh is linked from a library; make it local"
    if not is_in_view_layer(item, bpy.context.view_layer):
        return "its collection is excluded from the view layer"
    return "no faces" if len(mesh.polygons) == 0 else _write_obstacle(mesh, uv_map)


def _write_obstacle(mesh: bpy.types.Mesh, uv_map: str) -> str:
    """Return why no UV map of this name can be written into a local mesh with faces, or an empty string."""
    stretch = mesh.attributes.get(STRETCH_ATTRIBUTE)
    if stretch is not None and not _is_stretch(stretch):
        return f'another attribute is named "{STRETCH_ATTRIBUTE}"; rename it'
    layer = mesh.uv_layers.get(uv_map)
    if layer is None:
        if uv_map in mesh.attributes:
            return f'another attribute is named "{uv_map}"; choose another UV map name'
        return "it has the maximum of eight UV maps; remove one" if len(mesh.uv_layers) >= MAX_UV_MAPS else ""
    pins = mesh.attributes.get(PIN_PREFIX + uv_map)
    return f'its UV map "{uv_map}" has pinned vertices; unpin them' if pins is not None and any(pin.value for pin in pins.data) else ""


def find_mesh(target: UvTarget, uv_map: str) -> bpy.types.Mesh:
    """Return the mesh of `target`, also if it was renamed, so that a UV map of this name can be written into it.

    Raises:
        GeometryError: the mesh was removed or edited since it was read, or cannot hold the UV map any more.
    """
    mesh = find_by_uid(bpy.data.meshes, target.mesh_uid)
    if mesh is None or len(mesh.loops) <= int(target.loops.max()) or len(mesh.polygons) <= int(target.polygon_ids.max()):
        raise GeometryError(f'The mesh of "{target.object_name}" was removed or edited while it was being unwrapped; unwrap it again.')
    obstacle = _write_obstacle(mesh, uv_map)
    if obstacle:
        raise GeometryError(f'"{target.object_name}" was changed while it was being unwrapped: {obstacle}.')
    return mesh


def write_uv_map(
    target: UvTarget,
    corner_uvs: np.ndarray,
    stretches: np.ndarray,
    uv_map: str,
    metrics: dict[str, float],
    texture: Texture | None = None,
    unit_length: float = 1.0,
) -> None:
    """Write the UV map `corner_uvs` (T, 3, 2), its dominant stretch (T,) and its metrics into the mesh, and make it active.

    The metrics also get the texel density of each UV map of the mesh, for a `texture` and a Blender unit of so many meters.

    Raises:
        GeometryError: see `find_mesh`.
    """
    mesh = find_mesh(target, uv_map)
    layer = mesh.uv_layers.get(uv_map) or mesh.uv_layers.new(name=uv_map, do_init=False)
    mesh.uv_layers.active = layer
    uvs = read_uvs(layer)
    uvs[target.loops] = corner_uvs
    write_uvs(layer, uvs)
    attribute = mesh.attributes.get(STRETCH_ATTRIBUTE) or mesh.attributes.new(STRETCH_ATTRIBUTE, "FLOAT", "FACE")
    polygon_stretches = read_attribute(attribute)
    float32 = np.finfo(np.float32)
    limited = np.clip(stretches, float32.tiny, float32.max).astype(np.float32)
    order = np.argsort(np.abs(np.log(limited)), kind="stable")  # Of the triangles of a polygon the last one counts.
    polygon_stretches[target.polygon_ids[order]] = limited[order]
    attribute.data.foreach_set("value", polygon_stretches)
    texture = texture or Texture()
    densities = measure_texel_densities(mesh, target, mesh.uv_layers.keys(), texture, unit_length)
    mesh[METRICS_PROPERTY] = {**metrics, DENSITIES_PROPERTY: densities}
    mesh.update()


@dataclass(frozen=True)
class UvStretch:
    """The active UV map of a mesh and its stretch. loops (T, 3): of its triangles. uvs (L, 2) float32. stretches (T,) float32."""

    loops: np.ndarray
    uvs: np.ndarray
    stretches: np.ndarray


def read_uv_stretch(mesh: bpy.types.Mesh) -> UvStretch | None:
    """Read the active UV map and the stretch stored by `write_uv_map`; None for a mesh not unwrapped or in Edit Mode."""
    attribute, layer = mesh.attributes.get(STRETCH_ATTRIBUTE), mesh.uv_layers.active
    if attribute is None or layer is None or not _is_stretch(attribute) or len(attribute.data) != len(mesh.polygons):
        return None  # The data of a mesh in Edit Mode are elsewhere.
    loops, polygons = read_loop_triangles(mesh)
    stretches = read_attribute(attribute)
    return UvStretch(loops, read_uvs(layer), stretches[polygons])


def read_metrics(mesh: bpy.types.Mesh) -> dict[str, float]:
    """Read the numbers among the metrics stored by `write_uv_map`; empty for a mesh that has not been unwrapped."""
    return _read_numbers(mesh.get(METRICS_PROPERTY))


def read_texel_densities(mesh: bpy.types.Mesh) -> dict[str, float]:
    """Read the texels per meter of each UV map, as measured by `write_uv_map`, of those that the mesh still has."""
    stored = mesh.get(METRICS_PROPERTY)
    densities = _read_numbers(stored.get(DENSITIES_PROPERTY)) if isinstance(stored, idprop.types.IDPropertyGroup) else {}
    return {name: density for name, density in densities.items() if name in mesh.uv_layers}


def _read_numbers(stored: object) -> dict[str, float]:
    """Return the numbers in a custom property. It may have been edited or come from elsewhere: anything else is ignored."""
    if not isinstance(stored, idprop.types.IDPropertyGroup):
        return {}
    return {name: value for name, value in stored.items() if isinstance(value, int | float)}


def _is_stretch(attribute: bpy.types.Attribute) -> bool:
    """Whether an attribute has the domain and type of the stretch that `write_uv_map` stores."""
    return (attribute.domain, attribute.data_type) == ("FACE", "FLOAT")


def _read_vertex_group(item: bpy.types.Object, name: str) -> np.ndarray:
    group = item.vertex_groups.get(name) if name else item.vertex_groups.active
    if group is None:
        missing = f'no vertex group "{name}"' if name else "no vertex group"
        raise GeometryError(f'"{item.name}" has {missing}; paint one, or choose another Importance.')
    weights = np.zeros(len(item.data.vertices))
    for vertex in item.data.vertices:
        for membership in vertex.groups:
            if membership.group == group.index:
                weights[vertex.index] = membership.weight
    return np.clip(weights, 0.0, 1.0)
