"""Levels of a cloud for programs that know neither Blender's nodes nor Farfield: colour, alpha and normals on plain quads."""

from pathlib import Path

import bpy
import numpy as np

from ..core.images import dilate
from .btf_clouds import plain_material, texels_of_level
from .cloud_materials import FRONT_COLOUR, FRONT_NORMAL
from .clouds import CORNER_NORMALS
from .images import data_image, pixels_of

FACING = np.float32([0.0, 0.0, 1.0])  # a normal along that of its quad


def write_obj(levels: list[bpy.types.Object], path: Path) -> None:
    """Write `levels` as objects of one `.obj`, with a `.mtl` and a PNG a level beside it; world space, Y up as is usual there.

    Raises:
        OSError: when a file cannot be written.
    """
    shapes, materials = [f"mtllib {path.stem}.mtl"], []
    written = 1  # vertices are counted from 1 through the whole file
    for level in levels:
        name = level.name.replace(" ", "_")
        materials += [f"newmtl {name}", "Kd 1 1 1", "Ks 0 0 0", "illum 1"]
        image = front_colour(level)
        if image is not None:
            picture = f"{path.stem}_{name}.png"
            path.with_name(picture).write_bytes(image.packed_file.data)
            materials += [f"map_Kd {picture}", f"map_d {picture}"]
        shapes += [f"o {name}", *_shape_lines(level, name, written)]
        written += len(level.data.vertices)
    path.with_suffix(".mtl").write_text("\n".join(materials) + "\n", encoding="utf-8")
    path.write_text("\n".join(shapes) + "\n", encoding="utf-8")


def write_glb(levels: list[bpy.types.Object], path: Path) -> None:
    """Write `levels` as nodes of one `.glb` that holds their textures; each node carries its figures as extras.

    Raises:
        RuntimeError: when Blender's exporter fails.
    """
    layer = bpy.context.view_layer
    selected, active = list(bpy.context.selected_objects), layer.objects.active
    for item in selected:
        item.select_set(False)
    plain = [_plain_copy(level) for level in levels]
    try:
        bpy.ops.export_scene.gltf(
            filepath=str(path),
            export_format="GLB",
            use_selection=True,
            export_extras=True,
            export_image_format="AUTO",
            export_animations=False,
        )
    finally:
        for copy in plain:
            material = copy.data.materials[0]
            normals = _image_labelled(material, FRONT_NORMAL)
            bpy.data.meshes.remove(copy.data)
            bpy.data.materials.remove(material)
            if normals is not None:
                bpy.data.images.remove(normals)
        for item in selected:
            item.select_set(True)
        layer.objects.active = active


def front_colour(level: bpy.types.Object) -> bpy.types.Image | None:
    """The image with the colour and alpha of the front of a level's quads, or None where no textures were captured."""
    return _image_labelled(plain_material(level), FRONT_COLOUR)


def tangent_normals(level: bpy.types.Object) -> np.ndarray | None:
    """The normals of the fronts of a level's quads as a tangent-space map (H, W, 4) in 0..1, or None where none were captured.

    Red goes along the texture's x on the quad, green along its y, blue along the quad's own normal, and never behind the quad.
    """
    image = _image_labelled(plain_material(level), FRONT_NORMAL)
    if image is None:
        return None
    texels = texels_of_level(level)
    x, y = texels.pixels.T
    normals = 2.0 * pixels_of(image)[y, x, :3] - 1.0
    facing = np.empty(3 * len(level.data.polygons), np.float32)
    level.data.polygons.foreach_get("normal", facing)
    along = texels.steps / np.linalg.norm(texels.steps, axis=2, keepdims=True)
    frames = np.concatenate([along, facing.reshape(-1, 1, 3)], axis=1)[texels.quads]
    local = np.einsum("nij,nj->ni", frames, normals)
    local[:, 2] = np.maximum(local[:, 2], 0.0)
    lengths = np.linalg.norm(local, axis=1, keepdims=True)
    local = np.where(lengths > 0.0, local / np.where(lengths > 0.0, lengths, 1.0), FACING)
    known = texels.image(np.ones((len(texels), 1), np.float32))
    return dilate(texels.image(np.column_stack([0.5 + 0.5 * local, np.ones(len(local))]).astype(np.float32)), known[..., 0])


def _image_labelled(material: bpy.types.Material | None, label: str) -> bpy.types.Image | None:
    """The image of the first node with this label."""
    nodes = material.node_tree.nodes if material is not None and material.node_tree is not None else []
    return next((node.image for node in nodes if node.type == "TEX_IMAGE" and node.label == label), None)


def _shape_lines(level: bpy.types.Object, material: str, first: int) -> list[str]:
    """Vertices, UVs and polygons of one level as lines of an `.obj`."""
    mesh = level.data
    positions = np.empty(len(mesh.vertices) * 3, np.float32)
    mesh.vertices.foreach_get("co", positions)
    matrix = np.array(level.matrix_basis)  # levels have no parent; hidden objects have no up-to-date world matrix
    positions = positions.reshape(-1, 3) @ matrix[:3, :3].T + matrix[:3, 3]
    uvs = np.empty(len(mesh.loops) * 2, np.float32)
    mesh.uv_layers[0].data.foreach_get("uv", uvs)
    lines = [f"v {x:.9g} {z:.9g} {-y:.9g}" for x, y, z in positions]
    lines += [f"vt {u:.7g} {v:.7g}" for u, v in uvs.reshape(-1, 2)]
    lines += [f"usemtl {material}"]
    # Each corner of a quad is a vertex of its own, so vertices and UVs share their numbers.
    lines += ["f " + " ".join(f"{first + corner}/{first + corner}" for corner in polygon.vertices) for polygon in mesh.polygons]
    return lines


def _plain_copy(level: bpy.types.Object) -> bpy.types.Object:
    """A visible, selected copy of `level` with a material that every reader of glTF understands.

    With a map of normals the quads are flat: the map is measured from them, and the normals of their corners are in it.
    """
    normals = tangent_normals(level)
    copy = bpy.data.objects.new(level.name, level.data.copy())
    copy.matrix_basis = level.matrix_basis
    for key in level.keys():  # noqa: SIM118 - an object is no dict
        copy[key] = level[key]
    copy.data.materials.clear()
    copy.data.materials.append(_plain_copy_material(level.name, front_colour(level), normals))
    if normals is not None and CORNER_NORMALS in copy.data.attributes:
        copy.data.attributes.remove(copy.data.attributes[CORNER_NORMALS])
    bpy.context.scene.collection.objects.link(copy)
    copy.select_set(True)
    return copy


def _plain_copy_material(name: str, image: bpy.types.Image | None, normals: np.ndarray | None) -> bpy.types.Material:
    """Two-sided, without highlights; alpha cut at one half, since blended quads are not sorted by what reads the file."""
    material = bpy.data.materials.new(name)
    if material.node_tree is None:
        material.use_nodes = True
    material.use_backface_culling = False
    nodes, links = material.node_tree.nodes, material.node_tree.links
    shader = next(node for node in nodes if node.type == "BSDF_PRINCIPLED")
    shader.inputs["Roughness"].default_value = 1.0
    if image is not None:
        texture, cut = nodes.new("ShaderNodeTexImage"), nodes.new("ShaderNodeMath")
        texture.image, texture.extension = image, "EXTEND"
        cut.operation = "ROUND"
        links.new(texture.outputs["Color"], shader.inputs["Base Color"])
        links.new(texture.outputs["Alpha"], cut.inputs[0])
        links.new(cut.outputs[0], shader.inputs["Alpha"])
    if normals is not None:
        texture, turned = nodes.new("ShaderNodeTexImage"), nodes.new("ShaderNodeNormalMap")
        texture.image, texture.extension, texture.label = data_image(f"{name} Normals", normals, is_data=True), "EXTEND", FRONT_NORMAL
        links.new(texture.outputs["Color"], turned.inputs["Color"])
        links.new(turned.outputs[0], shader.inputs["Normal"])
    return material
