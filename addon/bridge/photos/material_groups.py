"""Faces grouped by material, so that each material gets a texture of its own, and the materials with these textures."""

from collections.abc import Mapping
from dataclasses import dataclass

import bpy
import numpy as np

from ...compat import uses_nodes
from ...core.errors import GeometryError
from ..geometry.evaluated_mesh import MaterialKey
from ..geometry.meshes import SourceInstance, find_material
from ..shading.node_builder import NodeBuilder
from ..shading.solid_view import show_image
from ..shading.surface_reader import find_output
from .results import TEXTURE_PROPERTY, add_texture, create_material, keep_unused

SUFFIX = " Photo Texture"


@dataclass(frozen=True)
class MaterialGroups:
    """The materials of triangles.

    triangles: (T,) int32, the group of each triangle. uids: session UID of the material of each group, None for faces without one.
    names: of the materials, "" for none.
    """

    triangles: np.ndarray
    uids: tuple[int | None, ...]
    names: tuple[str, ...]

    def name_textures(self, fallback: str) -> list[str]:
        """Return a name for the texture of each group: that of its material or, without one, `fallback`, and a suffix."""
        names = (name or fallback for name in self.names)
        return [(name.rpartition(SUFFIX)[0] or name) + SUFFIX for name in names]  # Materials of an earlier merge have the suffix.


def read_material_groups(objects: list[bpy.types.Object], instances: list[SourceInstance]) -> MaterialGroups:
    """Return the materials of all triangles of `instances`, which show `objects`. Raises GeometryError if a material is that of a modifier
    instead of a material slot."""
    slots = {item.session_uid: {_slot_key(slot) for slot in item.material_slots} or {None} for item in objects}
    indices: dict[MaterialKey | None, int] = {}
    triangles = []
    for instance in instances:
        mesh = instance.mesh
        used = np.unique(mesh.material_indices)
        table = np.zeros(len(mesh.materials), np.int32)
        for index in used:
            key = mesh.materials[index]
            if key not in slots[instance.object_uid]:
                what = "faces without a material" if key is None else f'the material "{key[0]}"'
                raise GeometryError(
                    f'Modifiers give "{instance.name}" {what}, which is in none of its material slots; apply them, or choose Replace '
                    "as Materials."
                )
            table[index] = indices.setdefault(key, len(indices))
        triangles.append(table[mesh.material_indices])
    materials = [None if key is None else find_material(key) for key in indices]
    return MaterialGroups(
        np.concatenate(triangles),
        tuple(None if material is None else material.session_uid for material in materials),
        tuple("" if material is None else material.name for material in materials),
    )


def assign_to_materials(
    objects: list[bpy.types.Object], images: Mapping[int | None, bpy.types.Image], *, has_alpha: bool = False
) -> list[str]:
    """Replace each material in the slots of `objects` by a copy that shows its image as base color.

    A material without a Principled BSDF, and faces without a material, get a new material. The replaced ones are kept as in
    `assign_texture`.

    Args:
        images: by the session UID of the material, or None for faces without one.

    Returns:
        The names of materials that could not be copied.
    """
    created: dict[int | None, bpy.types.Material] = {}
    replaced: dict[int, bpy.types.Material] = {}
    failed = []

    def create(old: bpy.types.Material | None) -> bpy.types.Material:
        key = None if old is None else old.session_uid
        if key not in created:
            image = images[key]
            shader = None if old is None else find_shader(old)
            if shader is None:
                created[key] = create_material(image.name, image, has_alpha)
            else:
                created[key] = _copy_with_texture(old, shader.name, image, has_alpha)
            if old is not None:
                replaced[key] = old
                if shader is None:
                    failed.append(old.name)
        return created[key]

    for item in objects:
        if not item.material_slots and None in images:
            item.data.materials.append(create(None))
        for slot in item.material_slots:
            if (None if slot.material is None else slot.material.session_uid) in images:
                slot.material = create(slot.material)
    keep_unused(replaced.values())
    return failed


def find_shader(material: bpy.types.Material) -> bpy.types.Node | None:
    """Return the Principled BSDF that a material shows: that of the active output, or the only one; None if there is none."""
    if not uses_nodes(material) or material.node_tree is None:
        return None
    tree = material.node_tree
    output = find_output(tree)
    if output is None:
        return None
    links = output.inputs["Surface"].links
    if links and links[0].from_node.type == "BSDF_PRINCIPLED":
        return links[0].from_node
    found = [node for node in tree.nodes if node.type == "BSDF_PRINCIPLED" and not node.mute]
    return found[0] if links and len(found) == 1 else None


def _copy_with_texture(material: bpy.types.Material, shader_name: str, image: bpy.types.Image, has_alpha: bool) -> bpy.types.Material:
    copy = material.copy()
    copy.name, copy.use_fake_user = image.name, False
    tree = copy.node_tree
    shader = tree.nodes[shader_name]
    former = next((link.from_node for link in shader.inputs["Base Color"].links), None)
    if TEXTURE_PROPERTY in material and former is not None and former.type == "TEX_IMAGE":
        former.image = image  # An earlier merge made this node.
        texture = former
    else:
        copy[TEXTURE_PROPERTY] = True
        texture = add_texture(tree, shader, image)
    if has_alpha and not texture.outputs["Alpha"].links:
        own = next((link.from_socket for link in shader.inputs["Alpha"].links), shader.inputs["Alpha"].default_value)
        builder = NodeBuilder(tree)
        builder.connect(builder.math("MULTIPLY", texture.outputs["Alpha"], own), shader.inputs["Alpha"])
    show_image(copy, image)
    return copy


def _slot_key(slot: bpy.types.MaterialSlot) -> MaterialKey | None:
    material = slot.material
    if material is None:
        return None
    return material.name, None if material.library is None else material.library.filepath
