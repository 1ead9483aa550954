"""One evaluated Blender mesh as arrays, with all that its materials may ask for."""

from dataclasses import dataclass

import bpy
import numpy as np

VALUE_KEYS = {  # attribute type -> (property that holds the value, numbers in it)
    "FLOAT": ("value", 1),
    "INT": ("value", 1),
    "INT8": ("value", 1),
    "BOOLEAN": ("value", 1),
    "FLOAT2": ("vector", 2),
    "FLOAT_VECTOR": ("vector", 3),
    "FLOAT_COLOR": ("color", 4),
    "BYTE_COLOR": ("color", 4),
}
MaterialKey = tuple[str, str | None]  # name, and the file of the library it is linked from
GEOMETRY_ATTRIBUTES = {"position", "material_index", "custom_normal", "sharp_face", "sharp_edge"}


@dataclass(frozen=True)
class MeshAttribute:
    """A named layer: domain is "POINT", "CORNER" or "FACE", values (elements, width) float32; colours are scene-linear."""

    domain: str
    values: np.ndarray


@dataclass(frozen=True)
class Surface:
    """A triangulated mesh in the space of its object; several objects may share one.

    vertices (V, 3) float32. triangles, loops (T, 3) int32: vertices and loops at the corners; polygons (T,) int32.
    normals (L, 3) float32: the shading normal at every loop. generated (V, 3) float32: what the Generated texture coordinate says.
    material_indices (T,) int32 into materials: keys of bpy.data.materials (names, since long work must hold no pointers), or None.
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
        """Values (N, 3, width) float32 of the attribute `name` at the corners of `triangles` (N,)."""
        attribute = self.attributes[name]
        if attribute.domain == "CORNER":
            return attribute.values[self.loops[triangles]]
        if attribute.domain == "POINT":
            return attribute.values[self.triangles[triangles]]
        return np.repeat(attribute.values[self.polygons[triangles]][:, None], 3, axis=1)


def read_surface(mesh: bpy.types.Mesh, instance: bpy.types.Object) -> Surface:
    """The surface of an evaluated `mesh`; `instance` is the evaluated object that shows it and may override its materials."""
    mesh.calc_loop_triangles()
    triangle_count = len(mesh.loop_triangles)
    polygons = _read(mesh.loop_triangles, "polygon_index", triangle_count, np.int32)
    material_indices = _read(mesh.polygons, "material_index", len(mesh.polygons), np.int32)[polygons]
    materials = _materials(mesh, instance)
    vertices = _read(mesh.vertices, "co", len(mesh.vertices) * 3, np.float32).reshape(-1, 3)
    default_uv = next((layer.name for layer in mesh.uv_layers if layer.active_render), "")
    return Surface(
        vertices=vertices,
        triangles=_read(mesh.loop_triangles, "vertices", triangle_count * 3, np.int32).reshape(-1, 3),
        loops=_read(mesh.loop_triangles, "loops", triangle_count * 3, np.int32).reshape(-1, 3),
        polygons=polygons,
        normals=_read(mesh.corner_normals, "vector", len(mesh.loops) * 3, np.float32).reshape(-1, 3),
        generated=_generated(mesh, instance, vertices),
        material_indices=np.clip(material_indices, 0, len(materials) - 1),
        materials=materials,
        attributes=_attributes(mesh),
        uv_map=default_uv,
        color=mesh.attributes.default_color_name,
    )


def _read(collection: bpy.types.bpy_prop_collection, name: str, count: int, dtype: type) -> np.ndarray:
    values = np.empty(count, dtype)
    collection.foreach_get(name, values)
    return values


def _attributes(mesh: bpy.types.Mesh) -> dict[str, MeshAttribute]:
    """All layers that a material can read by name."""
    layers = {}
    for attribute in mesh.attributes:
        if attribute.name.startswith(".") or attribute.name in GEOMETRY_ATTRIBUTES:
            continue
        if attribute.domain == "EDGE" or attribute.data_type not in VALUE_KEYS:
            continue
        key, width = VALUE_KEYS[attribute.data_type]
        raw_type = {"INT": np.int32, "INT8": np.int32, "BOOLEAN": bool}.get(attribute.data_type, np.float32)
        values = _read(attribute.data, key, len(attribute.data) * width, raw_type)
        layers[attribute.name] = MeshAttribute(attribute.domain, values.astype(np.float32).reshape(-1, width))
    return layers


def _materials(mesh: bpy.types.Mesh, instance: bpy.types.Object) -> tuple[MaterialKey | None, ...]:
    """Keys of the materials by index: those of the evaluated mesh, but for slots that the object overrides. One entry at least."""
    materials = list(mesh.materials) or [None]
    for index, slot in enumerate(instance.material_slots):
        if slot.link == "OBJECT" and index < len(materials):
            materials[index] = slot.material
    return tuple(None if material is None else _key(material.original) for material in materials)


def _key(material: bpy.types.Material) -> MaterialKey:
    return material.name, None if material.library is None else material.library.filepath


@np.errstate(invalid="ignore")  # infinite coordinates pass: there is a sentence for them later
def _generated(mesh: bpy.types.Mesh, instance: bpy.types.Object, vertices: np.ndarray) -> np.ndarray:
    """Generated coordinates (V, 3): the undeformed positions where modifiers kept the vertices, in 0..1 of the texture space."""
    original = instance.original.data
    undeformed = vertices
    if isinstance(original, bpy.types.Mesh) and len(original.vertices) == len(mesh.vertices):
        undeformed = _read(original.vertices, "co", len(vertices) * 3, np.float32).reshape(-1, 3)
    space = original if isinstance(original, bpy.types.Mesh | bpy.types.Curve) else mesh
    location, size = np.array(space.texspace_location, np.float32), np.array(space.texspace_size, np.float32)
    return (undeformed - location + size) / (2.0 * np.where(size == 0.0, 1.0, size))
