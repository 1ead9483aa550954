"""Export of a cloud's levels for programs without Blender's nodes: color, alpha and normals on simple quads."""

import os
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import bpy
import numpy as np

from ...compat import enable_nodes
from ...core.billboards.texels import Texels
from ...core.errors import GeometryError
from ...core.files.filenames import material_path, safe_filename, unique_filenames
from ...core.files.outputs import OBJ_COMMENT
from ...core.geometry.transforms import transform_points
from ...core.imaging.images import dilate
from ...core.imaging.metrics import decode_srgb, encode_srgb
from ...core.messages import describe_lacking
from ..geometry.mesh_arrays import read_loop_vertices, read_positions, read_uvs, read_values, write_attribute
from ..gltf_export import export_gltf, finite_properties
from ..imaging.images import create_image, find_images, read_pixels
from ..shading.node_builder import NodeBuilder
from ..shading.surface_layers import EMISSION, TRANSLUCENCY, TRANSMISSION
from .cloud_materials import FRONT_COLOR, FRONT_NORMAL, FRONT_ROUGHNESS_METALLIC_DEPTH, SIDES
from .clouds import CORNER_NORMALS
from .level_objects import pbr_image, read_face_quads, read_layer_pixels, read_layers, read_level_texels

GLB_OPTIONS = {"export_format": "GLB", "use_selection": True, "export_extras": True, "export_image_format": "AUTO"}
FOLDED_LAYERS = (TRANSLUCENCY, TRANSMISSION)  # The exported color has what these let through, as that of the source.
FLAT_NORMAL = np.float32([0.0, 0.0, 1.0])  # In tangent space.


def write_obj(levels: list[bpy.types.Object], path: Path) -> None:
    """Write `levels` as objects of one `.obj`, with a `.mtl` and one PNG per level next to it; in world space, Y up as usual for OBJ.

    Raises:
        OSError: a file cannot be written.
    """
    mtl = material_path(path)
    shapes, materials = [f"mtllib {mtl.name}"], []
    first_vertex = first_loop = 1  # Vertices and UVs are numbered from 1 through the whole file.
    names = unique_filenames([level.name.replace(" ", "_") for level in levels])  # Also one word each, without line breaks.
    for level, name in zip(levels, names, strict=True):
        materials += [f"newmtl {name}", "Kd 1 1 1", "Ks 0 0 0", "illum 1"]
        image = front_color_image(level)
        if image is not None:
            image_name = f"{mtl.stem}_{name}.png"
            shown = compose_color(level, image, (*FOLDED_LAYERS, EMISSION))
            path.with_name(image_name).write_bytes(shown.packed_file.data)
            if shown != image:
                bpy.data.images.remove(shown)
            materials += [f"map_Kd {image_name}", f"map_d {image_name}"]
        shapes += [f"o {name}", *_format_shape(level, name, first_vertex, first_loop)]
        first_vertex, first_loop = first_vertex + len(level.data.vertices), first_loop + len(level.data.loops)
    mtl.write_text(OBJ_COMMENT + "\n".join(materials) + "\n", encoding="utf-8")
    path.write_text("\n".join(shapes) + "\n", encoding="utf-8")


def write_glb(levels: list[bpy.types.Object], path: Path) -> list[str]:
    """Write `levels` as nodes of one `.glb` with embedded textures. Each node has the level's custom properties as extras.

    Returns sentences about custom properties that it lacks, since their numbers are not finite.

    Raises:
        FileError: Blender's exporter cannot write the file.
        GeometryError: a level cannot be exported, see `check_glb_levels`.
        OSError: the file cannot be renamed.
    """
    check_glb_levels(levels)
    has_extension = os.path.splitext(path.name)[1] != ""  # noqa: PTH122 as the exporter sees it: in "...glb" it finds none, and adds one
    exported = path if has_extension else path.with_name(f"{safe_filename(path.name)}.glb")
    layer = bpy.context.view_layer
    selected, active = list(bpy.context.selected_objects), layer.objects.active
    for item in selected:
        item.select_set(False)
    copies: list[bpy.types.Object] = []
    kept = set(bpy.data.images)
    owners: dict[bpy.types.ID, str] = {}
    try:
        for level in levels:
            copies.append(_create_export_copy(level))
            owners |= dict.fromkeys((copies[-1], copies[-1].data), level.name)
        owners |= {scene: scene.name for scene in bpy.data.scenes if scene.is_editable}
        with finite_properties(owners) as lacking:
            export_gltf(exported, GLB_OPTIONS)
        if exported != path:
            exported.replace(path)
    finally:
        for copy in copies:
            material = copy.data.materials[0]
            bpy.data.meshes.remove(copy.data)
            created = [image for image in find_images([material]) if image not in kept]
            bpy.data.materials.remove(material)
            for image in created:
                bpy.data.images.remove(image)
        for item in selected:
            item.select_set(True)
        layer.objects.active = active
    return describe_lacking(lacking, "The .glb")


def check_glb_levels(levels: list[bpy.types.Object]) -> None:
    """Raise GeometryError if the transform of a level is not finite: a .glb cannot store it."""
    for level in levels:
        if not np.isfinite(np.array(level.matrix_basis)).all():
            raise GeometryError(f'The level "{level.name}" has a transform that is not finite; clear it (Object > Clear).')


def front_color_image(level: bpy.types.Object) -> bpy.types.Image | None:
    """Return the image with the color and alpha of the fronts of a level's quads, or None if no textures were captured."""
    return pbr_image(level, FRONT_COLOR)


def compute_tangent_normals(level: bpy.types.Object) -> np.ndarray | None:
    """Compute a tangent-space normal map (H, W, 4) in 0..1 of the fronts of a level's quads, or None if no normals were captured.

    Red is the component along the texture's x axis on the quad, green along its y axis, blue along the quad's normal. Blue is at least 0.5:
    normals do not point behind the quad.
    """
    image = pbr_image(level, FRONT_NORMAL)
    if image is None:
        return None
    texels = read_level_texels(level)
    x, y = texels.pixels.T
    normals = 2.0 * read_pixels(image)[y, x, :3] - 1.0
    quad_normals = _quad_normals(level.data, texels)
    tangents = texels.steps / np.linalg.norm(texels.steps, axis=2, keepdims=True)
    frames = np.concatenate([tangents, quad_normals.reshape(-1, 1, 3)], axis=1)[texels.quad_indices]
    local = np.einsum("nij,nj->ni", frames, normals)
    local[:, 2] = np.maximum(local[:, 2], 0.0)
    lengths = np.linalg.norm(local, axis=1, keepdims=True)
    local = np.where(lengths > 0.0, local / np.where(lengths > 0.0, lengths, 1.0), FLAT_NORMAL)
    is_texel = texels.to_image(np.ones((len(texels), 1), np.float32))
    return dilate(texels.to_image(np.column_stack([0.5 + 0.5 * local, np.ones(len(local))]).astype(np.float32)), is_texel[..., 0])


def _quad_normals(mesh: bpy.types.Mesh, texels: Texels) -> np.ndarray:
    """Return the unit normals (Q, 3) of the quads of a level's `mesh`: those of its faces, or of the planes of its charts."""
    return read_values(mesh.polygons, "normal", 3) if read_face_quads(mesh) is None else texels.quad_normals.astype(np.float32)


def _format_shape(level: bpy.types.Object, material: str, first_vertex: int, first_loop: int) -> list[str]:
    """Return vertices, UVs and polygons of one level as lines of an `.obj`."""
    mesh = level.data
    matrix = np.array(level.matrix_basis)  # Levels have no parent; world matrices of hidden objects are not up to date.
    positions = transform_points(matrix, read_positions(mesh))
    lines = [f"v {x:.9g} {z:.9g} {-y:.9g}" for x, y, z in positions]
    lines += [f"vt {u:.7g} {v:.7g}" for u, v in read_uvs(mesh.uv_layers[0])]
    lines += [f"usemtl {material}"]
    loops = first_loop + np.arange(len(mesh.loops))
    vertices = (first_vertex + read_loop_vertices(mesh)).tolist()
    pairs = [f"{vertex}/{loop}" for vertex, loop in zip(vertices, loops.tolist(), strict=True)]
    starts = [*read_values(mesh.polygons, "loop_start", dtype=np.int32).tolist(), len(pairs)]
    lines += ["f " + " ".join(pairs[start:end]) for start, end in pairwise(starts)]
    return lines


def _create_export_copy(level: bpy.types.Object) -> bpy.types.Object:
    """Create a visible, selected copy of `level` with a plain mesh."""
    copy = bpy.data.objects.new(level.name, create_plain_mesh(level))
    copy.matrix_basis = level.matrix_basis
    for key in level.keys():  # noqa: SIM118 - an object is not a dict
        copy[key] = level[key]
    bpy.context.scene.collection.objects.link(copy)
    copy.select_set(True)
    return copy


def create_plain_mesh(level: bpy.types.Object) -> bpy.types.Mesh:
    """Create a copy of the quads of `level` with a material that every glTF reader supports.

    With a normal map the quads are flat shaded, because a tangent-space normal map is relative to the quad's own normal; all faces of a
    chart have the normal of its plane.
    """
    normals = compute_tangent_normals(level)
    mesh = level.data.copy()
    mesh.materials.clear()
    mesh.materials.append(_create_export_material(level, normals))
    if normals is not None and CORNER_NORMALS in mesh.attributes:
        mesh.attributes.remove(mesh.attributes[CORNER_NORMALS])
        quads = read_face_quads(mesh)
        if quads is not None:
            counts = read_values(mesh.polygons, "loop_total", dtype=np.int32)
            write_attribute(mesh, CORNER_NORMALS, "CORNER", np.repeat(read_level_texels(level).quad_normals[quads], counts, axis=0))
    return mesh


def compose_color(level: bpy.types.Object, image: bpy.types.Image, names: Sequence[str]) -> bpy.types.Image:
    """Return the front `image` of a level with the layers called `names` added to its color: a new image, or `image` if it has none."""
    layers = [read_layer_pixels(layer, SIDES[0]) for name, layer in read_layers(level).items() if name in names]
    if not layers:
        return image
    pixels = read_pixels(image)
    pixels[..., :3] = encode_srgb(np.clip(decode_srgb(pixels[..., :3]) + sum(layers), 0.0, 1.0))
    return create_image(f"{level.name} Color", pixels, is_data=False)


def _connect_layers(nodes: NodeBuilder, shader: bpy.types.Node, level: bpy.types.Object) -> None:
    """Let an exported material emit light and let light through, as far as glTF can store it."""
    layers = read_layers(level)
    if EMISSION in layers:
        emission = layers[EMISSION]
        color = emission.constant
        if color is None:
            color = nodes.node("ShaderNodeTexImage", {"image": emission.images[SIDES[0]], "extension": "EXTEND"}).outputs["Color"]
        nodes.connect(color, shader.inputs["Emission Color"])
        shader.inputs["Emission Strength"].default_value = emission.scale
    color_image, parameters = front_color_image(level), pbr_image(level, FRONT_ROUGHNESS_METALLIC_DEPTH)
    if TRANSMISSION in layers and color_image is not None and parameters is not None:
        through = read_layer_pixels(layers[TRANSMISSION], SIDES[0]).mean(axis=2)
        others = [read_layer_pixels(layers[name], SIDES[0]).mean(axis=2) for name in (TRANSLUCENCY,) if name in layers]
        total = decode_srgb(read_pixels(color_image)[..., :3]).mean(axis=2) + through + sum(others)
        pixels = np.zeros((*total.shape, 4), np.float32)
        pixels[..., 0], pixels[..., 3] = np.clip(through / np.maximum(total, 1e-6), 0.0, 1.0), 1.0
        # Only glass has highlights: it would blur what is behind it.
        pixels[..., 1] = np.where(pixels[..., 0] > 0.0, read_pixels(parameters)[..., 0], 1.0)
        image = create_image(f"{level.name} Transmission", pixels, is_data=True)
        weight, roughness, _ = nodes.separate_color(
            nodes.node("ShaderNodeTexImage", {"image": image, "extension": "EXTEND"}).outputs["Color"]
        )
        nodes.connect(weight, shader.inputs["Transmission Weight"])
        nodes.connect(roughness, shader.inputs["Roughness"])


def _create_export_material(level: bpy.types.Object, normals: np.ndarray | None) -> bpy.types.Material:
    """Create a two-sided material without highlights. Alpha is clipped at 0.5, because game engines do not sort blended quads."""
    name, image = level.name, front_color_image(level)
    material = bpy.data.materials.new(name)
    enable_nodes(material)
    material.use_backface_culling = False
    nodes, links = material.node_tree.nodes, material.node_tree.links
    shader = next(node for node in nodes if node.type == "BSDF_PRINCIPLED")
    shader.inputs["Roughness"].default_value = 1.0
    if image is not None:
        texture, clip = nodes.new("ShaderNodeTexImage"), nodes.new("ShaderNodeMath")
        texture.image, texture.extension = compose_color(level, image, FOLDED_LAYERS), "EXTEND"
        clip.operation = "ROUND"
        links.new(texture.outputs["Color"], shader.inputs["Base Color"])
        links.new(texture.outputs["Alpha"], clip.inputs[0])
        links.new(clip.outputs[0], shader.inputs["Alpha"])
    if normals is not None:
        texture, normal_map = nodes.new("ShaderNodeTexImage"), nodes.new("ShaderNodeNormalMap")
        texture.image, texture.extension, texture.label = create_image(f"{name} Normals", normals, is_data=True), "EXTEND", FRONT_NORMAL
        links.new(texture.outputs["Color"], normal_map.inputs["Color"])
        links.new(normal_map.outputs[0], shader.inputs["Normal"])
    _connect_layers(NodeBuilder(material.node_tree), shader, level)
    return material
