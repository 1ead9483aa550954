"""One evaluated Blender mesh as arrays, with everything that its materials may read."""

from dataclasses import dataclass

import bpy
import numpy as np

from .mesh_arrays import VALUE_KEYS, read_attribute, read_loop_triangles, read_positions, read_values

MaterialKey = tuple[str, str | None]  # name, and the file of the library it is linked from
GEOMETRY_ATTRIBUTES = {"position", "material_index", "custom_normal", "sharp_face", "sharp_edge"}


@dataclass(frozen=True)
class MeshAttribute:
    """A named attribute: domain is "POINT", "CORNER" or "FACE", values (elements, width) float32; colors are scene-linear."""

    domain: str
    values: np.ndarray


@dataclass(frozen=True)
class EvaluatedMesh:
    """A triangulated mesh in object space; several objects may share one.

    Attributes:
        vertices: (V, 3) float32.
        triangles, loops: (T, 3) int32, vertices and loops at the corners.
        polygons: (T,) int32.
        normals: (L, 3) float32, the shading normal at every loop.
        generated: (V, 3) float32, the Generated texture coordinates.
        material_indices: (T,) int32 into `materials`.
        materials: keys of bpy.data.materials (names, since long jobs must not hold pointers), or None.
        attributes: what materials can read, by name.
        uv_map, color: names of the layers that render by default, or "".
    """

    vertices: np.ndarray
    triangles: np.ndarray
    loops: np.ndarray
    polygons: np.ndarray
    normals: np.ndarray
    generated: np.ndarray
    material_indices: np.ndarray
    materials: tuple[MaterialKey | None, ...]
    attributes: dict[str, MeshAttribute]
    uv_map: str
    color: str

    def at_corners(self, name: str, triangles: np.ndarray) -> np.ndarray:
        """Return the values (N, 3, width) float32 of the attribute `name` at the corners of `triangles` (N,)."""
        attribute = self.attributes[name]
        if attribute.domain == "CORNER":
            return attribute.values[self.loops[triangles]]
        if attribute.domain == "POINT":
            return attribute.values[self.triangles[triangles]]
        return np.repeat(attribute.values[self.polygons[triangles]][:, None], 3, axis=1)


def read_evaluated_mesh(mesh: bpy.types.Mesh, instance: bpy.types.Object) -> EvaluatedMesh:
    """Read an evaluated `mesh`; `instance` is the evaluated object that uses it and may override its materials."""
    loops, polygons = read_loop_triangles(mesh)
    material_indices = read_values(mesh.polygons, "material_index", dtype=np.int32)[polygons]
    materials = _material_keys(mesh, instance)
    vertices = read_positions(mesh)
    return EvaluatedMesh(
        vertices=vertices,
        triangles=read_values(mesh.loop_triangles, "vertices", 3, np.int32),
        loops=loops,
        polygons=polygons,
        normals=read_values(mesh.corner_normals, "vector", 3),
        generated=_generated_coordinates(mesh, instance, vertices),
        material_indices=np.clip(material_indices, 0, len(materials) - 1),
        materials=materials,
        attributes=_read_attributes(mesh),
        uv_map=next((layer.name for layer in mesh.uv_layers if layer.active_render), ""),
        color=mesh.attributes.default_color_name,
    )


def _read_attributes(mesh: bpy.types.Mesh) -> dict[str, MeshAttribute]:
    """Return all attributes that a material can read by name."""
    attributes = {}
    uv_maps = {layer.name for layer in mesh.uv_layers}  # may have names like those of internal attributes
    for attribute in mesh.attributes:
        if (attribute.name.startswith(".") and attribute.name not in uv_maps) or attribute.name in GEOMETRY_ATTRIBUTES:
            continue
        if attribute.domain == "EDGE" or attribute.data_type not in VALUE_KEYS:
            continue
        values = read_attribute(attribute).astype(np.float32)
        attributes[attribute.name] = MeshAttribute(attribute.domain, values[:, None] if values.ndim == 1 else values)
    return attributes


def _material_keys(mesh: bpy.types.Mesh, instance: bpy.types.Object) -> tuple[MaterialKey | None, ...]:
    """Return the keys of the materials by index, at least one: those of the evaluated mesh, except for slots overridden by the object."""
    materials = list(mesh.materials) or [None]
    for index, slot in enumerate(instance.material_slots):
        if slot.link == "OBJECT" and index < len(materials):
            materials[index] = slot.material
    return tuple(None if material is None else _material_key(material.original) for material in materials)


def _material_key(material: bpy.types.Material) -> MaterialKey:
    return material.name, None if material.library is None else material.library.filepath


@np.errstate(over="ignore", invalid="ignore")  # infinite coordinates pass: a later check reports them
def _generated_coordinates(mesh: bpy.types.Mesh, instance: bpy.types.Object, vertices: np.ndarray) -> np.ndarray:
    """Return the Generated coordinates (V, 3): undeformed positions where modifiers kept the vertices, in 0..1 of the texture space."""
    original = instance.original.data
    undeformed = vertices
    if isinstance(original, bpy.types.Mesh) and len(original.vertices) == len(mesh.vertices):
        undeformed = read_positions(original)
    space = original if isinstance(original, bpy.types.Mesh | bpy.types.Curve) else mesh
    location, size = np.array(space.texspace_location, np.float32), np.array(space.texspace_size, np.float32)
    return (undeformed - location + size) / (2.0 * np.where(size == 0.0, 1.0, size))
