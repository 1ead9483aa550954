"""Stand-ins for an original that fades into its cloud: the same surfaces with copies of their materials, which may be given nodes."""

from collections.abc import Sequence

import bpy

from .cloud_materials import grey_material
from .clouds import KIND
from .meshes import shown_surfaces

ORIGINAL = "original"  # the kind of a stand-in


def add_originals(sources: Sequence[bpy.types.Object], collection: bpy.types.Collection, depsgraph: bpy.types.Depsgraph) -> None:
    """Stand-ins in `collection` for all that `sources` show, evaluated: modifiers, instances, materials set by them.

    The sources must be visible in `depsgraph`. Surfaces of the same data share one mesh.
    """
    wanted = {item.name_full for item in sources}
    meshes: dict[int, bpy.types.Mesh] = {}
    copies: dict[bpy.types.Material | None, bpy.types.Material] = {}
    for owner, instance in shown_surfaces(wanted, depsgraph):
        shown, matrix = instance.object, instance.matrix_world.copy()
        key = shown.data.as_pointer()
        if key not in meshes:
            meshes[key] = _mesh(shown, f"{collection.name} {shown.name}", depsgraph, copies)
        made = bpy.data.objects.new(meshes[key].name, meshes[key])
        _copy_properties(owner, made)
        made[KIND] = ORIGINAL
        made.matrix_world = matrix
        collection.objects.link(made)


def originals_in(collection: bpy.types.Collection) -> list[bpy.types.Object]:
    """The stand-ins in `collection`."""
    return [item for item in collection.objects if item.get(KIND) == ORIGINAL]


def remove_originals(collection: bpy.types.Collection) -> None:
    """Take the stand-ins away, and what only they use."""
    for item in originals_in(collection):
        mesh = item.data
        bpy.data.objects.remove(item)
        if mesh.users == 0:
            materials = [material for material in mesh.materials if material is not None]
            bpy.data.meshes.remove(mesh)
            for material in dict.fromkeys(materials):
                if material.users == 0:
                    bpy.data.materials.remove(material)


def _mesh(
    shown: bpy.types.Object, name: str, depsgraph: bpy.types.Depsgraph, copies: dict[bpy.types.Material | None, bpy.types.Material]
) -> bpy.types.Mesh:
    """The evaluated surface of `shown` with a copy of each of its materials."""
    slots = [slot.material for slot in shown.material_slots]
    mesh = bpy.data.meshes.new_from_object(shown, preserve_all_data_layers=True, depsgraph=depsgraph)
    mesh.name = name
    worn = [slots[index] if index < len(slots) else material for index, material in enumerate(mesh.materials)] or [None]
    mesh.materials.clear()
    for material in worn:
        original = None if material is None else material.original
        if original not in copies:
            copies[original] = _copy(original)
        mesh.materials.append(copies[original])
    return mesh


def _copy(material: bpy.types.Material | None) -> bpy.types.Material:
    if material is None:
        return grey_material("Farfield Original")
    copy = material.copy()
    copy.use_transparent_shadow = True
    return copy


def _copy_properties(source: bpy.types.Object, target: bpy.types.Object) -> None:
    """What materials and renderers ask an object for."""
    target.pass_index, target.color = source.pass_index, source.color
    for name in ("camera", "diffuse", "glossy", "transmission", "volume_scatter", "shadow"):
        setattr(target, f"visible_{name}", getattr(source, f"visible_{name}"))
    for key in source.keys():  # noqa: SIM118 - an object is no dict
        if not key.startswith("farfield_") and key not in target:
            target[key] = source[key]
