"""Temporary objects that Blender's glTF exporter reads: levels with copies of their materials, and with the colors of vertices that they
show as one attribute."""

import re
from collections.abc import Sequence

import bpy
import numpy as np

from ...core.errors import GeometryError
from ..geometry.evaluated_mesh import EvaluatedMesh, read_evaluated_mesh
from ..objects import world_matrix
from .glb_images import GlbImages
from .glb_materials import COLORS, GlbMaterial, rewrite_for_glb
from .level_sets import MATERIAL
from .rigs import find_armature, is_animated

NAME = "Farfield Export"
NUMBER_SUFFIX = re.compile(r"\.\d+$")  # that Blender adds to names of copies


class GlbObjects:
    """Objects for the exporter, and what their file will lack. All data-blocks exist within the context only.

    Attributes:
        collection: of the objects.
        lacking: labels of what the files lack, by material or object.
        uv_maps: the number of the active UV map of each object, by its name.
    """

    def __init__(self) -> None:
        self.lacking: dict[str, tuple[str, ...]] = {}
        self.uv_maps: dict[str, int] = {}
        self._images = GlbImages()
        self._materials: dict[bpy.types.Material, GlbMaterial] = {}
        self._meshes: list[bpy.types.Mesh] = []
        self._armatures: dict[bpy.types.Object, bpy.types.Object] = {}
        self._shared: dict[bpy.types.Mesh, str] = {}

    def __enter__(self) -> "GlbObjects":
        self.collection = bpy.data.collections.new(NAME)
        return self

    def __exit__(self, *_: object) -> None:
        self.clear()
        bpy.data.collections.remove(self.collection)
        bpy.data.batch_remove([found.copy for found in self._materials.values()])
        self._images.remove()

    @property
    def material_names(self) -> dict[str, str]:
        """The names of materials in the file by those of their copies."""
        return {found.copy.name: _find_name(material) for material, found in self._materials.items()}

    @property
    def unlit(self) -> set[str]:
        """The names of copies of materials that are shown without light."""
        return {found.copy.name for found in self._materials.values() if found.is_unlit}

    @property
    def armature_names(self) -> dict[str, str]:
        """The names of armatures by those of their copies."""
        return {copy.name: armature.name for armature, copy in self._armatures.items()}

    def clear(self) -> None:
        """Remove the objects and their meshes."""
        bpy.data.batch_remove(list(self.collection.objects))
        self._armatures.clear()
        bpy.data.batch_remove(self._meshes)
        self._meshes.clear()
        self._shared.clear()

    def add(self, item: bpy.types.Object, label: str) -> str:
        """Add an object with the mesh and the materials of another one, without its transform, and return its name. One object stands for
        all with the same mesh. If an armature deforms it, it is at its place under a copy of the armature, since vertices of skins are in
        the space of the scene.

        label: the name under which its attributes are listed that the file lacks.

        Raises:
            GeometryError: it has no triangles, or is in Edit Mode. FileError: an image of a material is missing or cannot be read.
        """
        armature = find_armature(item)
        if armature is None and item.data in self._shared:
            return self._shared[item.data]
        if item.data.is_editmode:
            raise GeometryError(f'"{item.name}" is in Edit Mode; leave it.')
        mesh = read_evaluated_mesh(item.data, item)
        if not len(mesh.triangles):
            raise GeometryError(f'"{item.name}" has no triangles to write; make its levels again.')
        slots = [None if slot.material is None else self._add_material(slot.material) for slot in item.material_slots]
        used = {index: slots[index] for index in np.unique(mesh.material_indices).tolist() if index < len(slots)}
        shown = {index: found for index, found in used.items() if found is not None}
        self._note_use(label, item.data, mesh, shown)
        data = item.data
        if any(found.vertex_colors.is_used for found in shown.values()):
            data = data.copy()
            self._meshes.append(data)
            _write_colors(data, mesh, shown)
        result = bpy.data.objects.new(f"{NAME} {len(self.collection.objects):04}", data)
        self.collection.objects.link(result)
        self.uv_maps[result.name] = max(data.uv_layers.active_index, 0)
        for slot, found in zip(result.material_slots, slots, strict=True):
            slot.link, slot.material = "OBJECT", None if found is None else found.copy
        if armature is None:
            self._shared[item.data] = result.name
        else:
            result.matrix_world = world_matrix(item)
            result.modifiers.new(armature.name, "ARMATURE").object = self._add_armature(armature)
            self._note(label, ["animations"] if is_animated(armature) else [])
        return result.name

    def _add_armature(self, armature: bpy.types.Object) -> bpy.types.Object:
        """Return a copy of an armature without parent and animation, which the exporter writes at rest."""
        if armature not in self._armatures:
            copy = self._armatures[armature] = armature.copy()
            copy.animation_data_clear()
            copy.parent = None
            copy.matrix_world = world_matrix(armature)
            self.collection.objects.link(copy)
        return self._armatures[armature]

    def note_document(self, document: dict) -> None:
        """Note what a file lacks that the exporter may write or not."""
        by_name = {found.copy.name: (_find_name(material), found) for material, found in self._materials.items()}
        for described in document.get("materials", ()):
            name, found = by_name.get(described.get("name"), ("", None))
            if found is not None:
                written = described.get("extensions", {})
                self._note(name, [label for label, extension in found.extended.items() if extension not in written])

    def _add_material(self, material: bpy.types.Material) -> GlbMaterial:
        if material not in self._materials:
            self._materials[material] = GlbMaterial(material.copy())
            rewrite_for_glb(self._materials[material], self._images)
            self._note(_find_name(material), self._materials[material].lacking)
        return self._materials[material]

    def _note_use(self, label: str, data: bpy.types.Mesh, mesh: EvaluatedMesh, shown: dict[int, GlbMaterial]) -> None:
        """Note color attributes that no material uses, images whose border is left, and opacities of vertices that one file cannot hold."""
        kinds = [found.vertex_colors for found in shown.values() if found.vertex_colors.is_used]
        names = {name or mesh.color for kind in kinds for name, _ in (*kind.colors, *kind.alphas)}
        labels = [f'the color attribute "{item.name}"' for item in data.color_attributes if item.name not in names]
        if len({bool(kind.alphas) for kind in kinds}) > 1:
            labels.append("opacities of vertices")
        self._note(label, labels)
        for index, found in shown.items():
            for uv_map, matrix in found.cuts:
                name = uv_map if uv_map in mesh.attributes else mesh.uv_map
                if name:
                    uvs = mesh.at_corners(name, np.flatnonzero(mesh.material_indices == index))
                    placed = uvs @ matrix[:, :2].T + matrix[:, 2]
                    if placed.min() < 0.0 or placed.max() > 1.0:
                        original = next(material for material, other in self._materials.items() if other is found)
                        self._note(_find_name(original), ["the border of its image"])

    def _note(self, name: str, labels: Sequence[str]) -> None:
        if labels:
            self.lacking[name] = tuple(dict.fromkeys((*self.lacking.get(name, ()), *labels)))


def _find_name(material: bpy.types.Material) -> str:
    """Return the name that a material of levels has in files: that of its original, unless it was renamed or has textures of its own."""
    original = str(material.get(MATERIAL, material.name))
    stems = {NUMBER_SUFFIX.sub("", name) for name in (original, material.name)}
    return original if len(stems) == 1 else material.name


def _write_colors(data: bpy.types.Mesh, mesh: EvaluatedMesh, shown: dict[int, GlbMaterial]) -> None:
    """Write the attribute COLORS: the product of the color attributes that the material of each face shows."""
    values = np.ones((len(data.loops), 4), np.float32)
    for index, found in shown.items():
        rows = np.flatnonzero(mesh.material_indices == index)
        loops = mesh.loops[rows]
        for attributes, components in ((found.vertex_colors.colors, slice(0, 3)), (found.vertex_colors.alphas, slice(3, 4))):
            for name, output in attributes:
                values[loops, components] *= _read_attribute(mesh, rows, name, output)
    data.color_attributes.new(COLORS, "FLOAT_COLOR", "CORNER").data.foreach_set("color", values.ravel())


def _read_attribute(mesh: EvaluatedMesh, triangles: np.ndarray, name: str, output: str) -> np.ndarray:
    """Return what an attribute node shows at the corners of `triangles` (N,), (N, 3, 1 or 3); 0 without the attribute, as in renders."""
    attribute = mesh.attributes.get(name or mesh.color)
    if attribute is None:
        return np.zeros((len(triangles), 3, 1))
    values = mesh.at_corners(name or mesh.color, triangles)
    if output == "Alpha":
        return values[..., 3:4] if values.shape[2] == 4 else np.ones((len(values), 3, 1))
    return values[..., :3] if values.shape[2] >= 3 else values[..., :1]
