"""Materials in .glb files are those of Blender: what is read of nodes, and what Blender's importer makes of written files."""

import math

import bpy
import numpy as np
import pytest

from bridge.blender_scenes import shader_of
from farfield.addon.bridge import lod_crossfade
from farfield.addon.bridge.geometry.evaluated_mesh import read_evaluated_mesh
from farfield.addon.bridge.texmesh.color_images import find_color_images
from farfield.addon.bridge.texmesh.glb_materials import GlbMaterials, VertexUse, describe_unread
from farfield.addon.core.files.glb import GlbMesh, GlbNode, GlbPrimitive, GlbScene, encode_glb
from farfield.addon.core.files.glb_materials import BLEND, MASK, OPAQUE, GlbMaterial, GlbTexture
from farfield.addon.core.imaging.coded_images import decode, encode
from textured_scenes import checker_image, textured_material

pytestmark = pytest.mark.usefixtures("empty_scene")
GLTF = "io_scene_gltf2"


def leaf_image(name: str = "Leaf", size: int = 8) -> bpy.types.Image:
    """A packed orange image that is opaque at the left half only."""
    image = bpy.data.images.new(name, size, size, alpha=True)
    pixels = np.full((size, size, 4), (0.8, 0.4, 0.2, 1.0), np.float32)
    pixels[:, size // 2 :, 3] = 0.0
    image.pixels.foreach_set(pixels.ravel())
    image.pack()
    return image


class Nodes:
    """The nodes of a material with an image in the base color."""

    def __init__(self, image: bpy.types.Image | None = None) -> None:
        self.material = textured_material(leaf_image() if image is None else image, "Leaf")
        self.tree = self.material.node_tree
        self.shader, self.image = shader_of(self.material), self.tree.nodes["Image Texture"]
        self.surface = self.tree.nodes["Material Output"].inputs["Surface"]

    def add(self, kind: str, *inputs, **properties) -> bpy.types.NodeSocket:
        """Add a node with values or links at its first enabled inputs, and return its first enabled output."""
        node = self.tree.nodes.new(f"ShaderNode{kind}")
        for name, value in properties.items():
            setattr(node, name, value)
        enabled = [item for item in node.inputs if item.enabled]
        for socket, value in zip(enabled, inputs, strict=False):
            if isinstance(value, bpy.types.NodeSocket):
                self.tree.links.new(value, socket)
            elif value is not None:
                socket.default_value = value
        return next((item for item in node.outputs if item.enabled), None)

    def link(self, source: bpy.types.NodeSocket, name: str) -> None:
        """Link an input of the shader."""
        self.tree.links.new(source, self.shader.inputs[name])

    def read(self) -> tuple[GlbMaterial, VertexUse, GlbMaterials]:
        """Return the material of the file."""
        materials = GlbMaterials()
        index, use = materials.add(self.material)
        return materials.materials[index], use, materials


def mask_by_comparison(nodes: Nodes) -> None:
    nodes.link(nodes.add("Math", nodes.image.outputs["Alpha"], 0.25, operation="GREATER_THAN"), "Alpha")


def mask_by_rounding(nodes: Nodes) -> None:
    nodes.link(nodes.add("Math", nodes.image.outputs["Alpha"], operation="ROUND"), "Alpha")


def mask_of_the_importer(nodes: Nodes) -> None:
    less = nodes.add("Math", nodes.image.outputs["Alpha"], 0.75, operation="LESS_THAN")
    nodes.link(nodes.add("Math", 1.0, less, operation="SUBTRACT"), "Alpha")


def blend(nodes: Nodes) -> None:
    nodes.link(nodes.image.outputs["Alpha"], "Alpha")


def blend_by_a_factor(nodes: Nodes) -> None:
    nodes.link(nodes.add("Math", 0.5, nodes.image.outputs["Alpha"], operation="MULTIPLY"), "Alpha")


def blend_everywhere(nodes: Nodes) -> None:
    nodes.shader.inputs["Alpha"].default_value = 0.5


def blend_with_a_transparent_shader(nodes: Nodes) -> None:
    mix = nodes.add("MixShader", nodes.image.outputs["Alpha"], nodes.add("BsdfTransparent"), nodes.shader.outputs[0])
    nodes.tree.links.new(mix, nodes.surface)


def blend_with_a_transparent_shader_second(nodes: Nodes) -> None:
    inverse = nodes.add("Math", 1.0, nodes.image.outputs["Alpha"], operation="SUBTRACT")
    nodes.tree.links.new(nodes.add("MixShader", inverse, nodes.shader.outputs[0], nodes.add("BsdfTransparent")), nodes.surface)


def cross_fade(nodes: Nodes) -> None:
    blend(nodes)
    mesh = bpy.data.meshes.new("Leaf")
    mesh.materials.append(nodes.material)
    lod_crossfade.add_crossfade(bpy.data.objects.new("Leaf", mesh), 0.1, 1.0, 0.2)


@pytest.mark.parametrize(
    ("change", "mode", "cutoff", "factor"),
    [
        (lambda _: None, OPAQUE, 0.5, 1.0),
        (mask_by_comparison, MASK, 0.25, 1.0),
        (mask_by_rounding, MASK, 0.5, 1.0),
        (mask_of_the_importer, MASK, 0.75, 1.0),
        (blend, BLEND, 0.5, 1.0),
        (blend_by_a_factor, BLEND, 0.5, 0.5),
        (blend_everywhere, BLEND, 0.5, 0.5),
        (blend_with_a_transparent_shader, BLEND, 0.5, 1.0),
        (blend_with_a_transparent_shader_second, BLEND, 0.5, 1.0),
        (cross_fade, BLEND, 0.5, 1.0),
    ],
)
def test_opacity(change, mode, cutoff, factor):
    nodes = Nodes()
    change(nodes)
    material, _, found = nodes.read()
    assert (material.alpha_mode, material.alpha_cutoff) == (mode, pytest.approx(cutoff))
    assert material.base_color == pytest.approx((1.0, 1.0, 1.0, factor))
    assert found.unread == {}
    pixels = decode(found.images[0])
    uses_alpha = change not in (blend_everywhere,)  # glTF would multiply it with the alpha of the image, which Blender ignores there
    assert (pixels.shape[2] == 4) == uses_alpha
    if uses_alpha:
        assert pixels[0, [0, -1], 3].tolist() == [255, 0]


def test_an_opacity_image_of_its_own_becomes_the_alpha_of_the_color_image():
    nodes = Nodes(checker_image())
    mask = bpy.data.images.new("Mask", 64, 16)
    mask.colorspace_settings.name = "Non-Color"
    pixels = np.ones((16, 64, 4), np.float32)
    pixels[:8, :, :3] = 0.0
    mask.pixels.foreach_set(pixels.ravel())
    node = nodes.tree.nodes.new("ShaderNodeTexImage")
    node.image = mask
    nodes.link(node.outputs["Color"], "Alpha")
    material, _, found = nodes.read()
    coded = decode(found.images[0])
    assert material.alpha_mode == BLEND and coded.shape == (32, 64, 4) and found.unread == {}
    assert coded[:, 5, 3].tolist() == pytest.approx([0] * 15 + [64, 191] + [255] * 15, abs=1)


def multiply(nodes: Nodes) -> None:
    mixed = nodes.add("Mix", 0.5, nodes.image.outputs["Color"], (0.2, 0.6, 1.0, 1.0), data_type="RGBA", blend_type="MULTIPLY")
    nodes.link(mixed, "Base Color")


def multiply_in_a_group(nodes: Nodes) -> None:
    tree = bpy.data.node_groups.new("Factor", "ShaderNodeTree")
    for name in ("Color", "Factor"):
        tree.interface.new_socket(name, in_out="INPUT", socket_type="NodeSocketColor")
    tree.interface.new_socket("Color", in_out="OUTPUT", socket_type="NodeSocketColor")
    start, mix, end = (tree.nodes.new(kind) for kind in ("NodeGroupInput", "ShaderNodeMixRGB", "NodeGroupOutput"))
    mix.blend_type = "MULTIPLY"
    mix.inputs[0].default_value = 0.5
    for output, target in ((start.outputs[0], mix.inputs[1]), (start.outputs[1], mix.inputs[2]), (mix.outputs[0], end.inputs[0])):
        tree.links.new(output, target)
    group = nodes.tree.nodes.new("ShaderNodeGroup")
    group.node_tree = tree
    nodes.tree.links.new(nodes.image.outputs["Color"], group.inputs[0])
    group.inputs[1].default_value = (0.2, 0.6, 1.0, 1.0)
    nodes.link(group.outputs[0], "Base Color")


@pytest.mark.parametrize("change", [multiply, multiply_in_a_group])
def test_color_factors(change):
    nodes = Nodes(checker_image())
    change(nodes)
    material, _, found = nodes.read()
    assert material.base_color == pytest.approx((0.6, 0.8, 1.0, 1.0))
    assert material.texture == GlbTexture(0) and found.unread == {}


@pytest.mark.parametrize(
    ("extension", "interpolation", "wrap", "is_nearest"),
    [("REPEAT", "Linear", "repeat", False), ("EXTEND", "Cubic", "clamp", False), ("MIRROR", "Closest", "mirror", True)],
)
def test_wrapping_and_interpolation(extension, interpolation, wrap, is_nearest):
    nodes = Nodes(checker_image())
    nodes.image.extension, nodes.image.interpolation = extension, interpolation
    material, _, _ = nodes.read()
    assert material.texture == GlbTexture(0, (wrap, wrap), is_nearest)


@pytest.mark.parametrize("vector_type", ["POINT", "TEXTURE", "VECTOR"])
def test_mapping_and_uv_map(vector_type):
    nodes = Nodes(checker_image())
    uvs = nodes.add("UVMap", uv_map="Second")
    mapping = nodes.add("Mapping", uvs, vector_type=vector_type).node
    if vector_type != "VECTOR":
        mapping.inputs["Location"].default_value = (0.25, -0.5, 0.0)
    mapping.inputs["Rotation"].default_value = (0.0, 0.0, math.radians(30.0))
    mapping.inputs["Scale"].default_value = (4.0, 4.0, 1.0)
    nodes.tree.links.new(nodes.add("VectorMath", mapping.outputs[0], (1.0, 2.0, 0.0), operation="ADD"), nodes.image.inputs["Vector"])
    material, use, _ = nodes.read()
    turn = np.array([[math.cos(math.radians(30.0)), -0.5], [0.5, math.cos(math.radians(30.0))]])
    matrix = {"POINT": 4.0 * turn, "VECTOR": 4.0 * turn, "TEXTURE": 0.25 * turn.T}[vector_type]
    moved = {"POINT": [0.25, -0.5], "VECTOR": [0.0, 0.0], "TEXTURE": -0.25 * turn.T @ [0.25, -0.5]}[vector_type]
    assert np.allclose(material.texture.placement, np.column_stack([matrix, np.add(moved, [1.0, 2.0])]), atol=1e-6)
    assert use.uv_map == "Second"


def lose_color_changes(nodes: Nodes) -> None:
    nodes.link(nodes.add("HueSaturation", None, None, None, None, nodes.image.outputs["Color"]), "Base Color")


def lose_normals(nodes: Nodes) -> None:
    nodes.link(nodes.add("NormalMap"), "Normal")


def lose_metal(nodes: Nodes) -> None:
    nodes.shader.inputs["Metallic"].default_value = 1.0


def lose_sheen(nodes: Nodes) -> None:
    nodes.shader.inputs["Sheen Weight"].default_value = 0.5


def lose_a_second_image(nodes: Nodes) -> None:
    node = nodes.tree.nodes.new("ShaderNodeTexImage")
    node.image = checker_image("Dirt")
    mixed = nodes.add("Mix", 1.0, nodes.image.outputs["Color"], node.outputs["Color"], data_type="RGBA", blend_type="MULTIPLY")
    nodes.link(mixed, "Base Color")


def lose_generated_coordinates(nodes: Nodes) -> None:
    nodes.tree.links.new(nodes.add("TexCoord").node.outputs["Generated"], nodes.image.inputs["Vector"])


def lose_shear(nodes: Nodes) -> None:
    mapping = nodes.add("Mapping", nodes.add("TexCoord").node.outputs["UV"], vector_type="TEXTURE").node
    mapping.inputs["Rotation"].default_value, mapping.inputs["Scale"].default_value = (0.0, 0.0, 0.5), (1.0, 3.0, 1.0)
    nodes.tree.links.new(mapping.outputs[0], nodes.image.inputs["Vector"])


def lose_unknown_opacity(nodes: Nodes) -> None:
    nodes.link(nodes.add("LayerWeight"), "Alpha")


@pytest.mark.parametrize(
    ("change", "labels"),
    [
        (lose_color_changes, ("Hue/Saturation/Value",)),
        (lose_normals, ("Normal",)),
        (lose_metal, ("Metallic",)),
        (lose_sheen, ("Sheen Weight",)),
        (lose_unknown_opacity, ("Layer Weight",)),
        (lose_a_second_image, ('the image "Dirt"',)),
        (lose_generated_coordinates, ("Generated coordinates",)),
        (lose_shear, ("Mapping",)),
    ],
)
def test_what_a_file_lacks_is_named(change, labels):
    nodes = Nodes(checker_image())
    change(nodes)
    material, _, found = nodes.read()
    assert material.texture is not None and material.alpha_mode == OPAQUE
    assert found.unread == {"Leaf": labels}
    assert describe_unread(found.unread, "The .glb") == [f'The .glb lacks {labels[0]} of "Leaf".']


@pytest.mark.parametrize("strength", [0.0, 1.0])
def test_an_emission_counts_if_it_has_strength(strength):
    """It takes the place of the base color, which is named."""
    nodes = Nodes(checker_image())
    base = nodes.shader.inputs["Base Color"]
    nodes.tree.links.remove(base.links[0])
    base.default_value = (0.2, 0.4, 0.6, 1.0)
    nodes.link(nodes.image.outputs["Color"], "Emission Color")
    nodes.shader.inputs["Emission Strength"].default_value = strength
    material, _, found = nodes.read()
    assert (material.texture is not None) == (strength > 0.0)
    assert material.base_color[:3] == pytest.approx((1.0, 1.0, 1.0) if strength else (0.2, 0.4, 0.6))
    assert found.unread == ({"Leaf": ("Base Color",)} if strength else {})
    assert [image.name for image, _ in find_color_images(nodes.material)] == (["Checker"] if strength else [])


def test_outputs_of_single_engines_are_read():
    """Files from before Blender 5.0 have one for each engine where a material had no nodes."""
    nodes = Nodes()
    nodes.tree.nodes["Material Output"].target = "EEVEE"
    other = nodes.tree.nodes.new("ShaderNodeOutputMaterial")
    other.target = "CYCLES"
    nodes.tree.links.new(nodes.add("BsdfDiffuse", (0.2, 0.4, 0.6, 1.0)), other.inputs["Surface"])
    material, _, found = nodes.read()
    assert material.base_color == pytest.approx((0.2, 0.4, 0.6, 1.0)) and material.texture is None and found.unread == {}


def test_blenders_importer_makes_the_same_materials(tmp_path):
    """Opacity, color factors, placement and wrapping of every kind come back from Blender's importer as they were written."""
    import addon_utils

    turned = ((0.0, -2.0, 0.25), (3.0, 0.0, -0.5))
    textures = [
        GlbTexture(0),
        GlbTexture(0, ("mirror", "mirror"), True),
        GlbTexture(0, ("clamp", "clamp"), placement=((2.0, 0.0, 0.5), (0.0, -3.0, 0.25))),
        GlbTexture(0, ("repeat", "mirror"), placement=turned),
        GlbTexture(0, ("clamp", "mirror")),
    ]
    modes = [(OPAQUE, 0.5), (MASK, 0.25), (BLEND, 0.5), (MASK, 0.5), (BLEND, 0.5)]
    written = [
        GlbMaterial(f"m{index}", (1.0, 0.5, 0.25, 1.0 if mode == OPAQUE else 0.5), texture, index % 2 == 0, mode, cutoff, index in (0, 1))
        for index, (texture, (mode, cutoff)) in enumerate(zip(textures, modes, strict=True))
    ]
    uvs = np.array([[0.25, -0.5], [1.5, 0.125], [0.5, 2.0]])
    colors = np.array([[0.25, 0.5, 1.0, 0.5], [1.0, 0.0, 0.5, 1.0], [0.5, 0.5, 0.5, 0.0]])
    triangle, positions = np.array([[0, 1, 2]]), np.eye(3)
    parts = [GlbPrimitive(positions, triangle, uvs=uvs, colors=colors, material=index) for index in range(len(written))]
    nodes = tuple(GlbNode(f"n{index}", index) for index in range(len(written)))
    meshes = tuple(GlbMesh(f"n{index}", (part,)) for index, part in enumerate(parts))
    image = encode(np.random.default_rng(0).integers(0, 255, (8, 8, 4)).astype(np.uint8), "png")
    was_enabled = addon_utils.check(GLTF)[1]
    try:
        addon_utils.enable(GLTF)
        for is_quantized in (False, True):
            (tmp_path / "a.glb").write_bytes(encode_glb(GlbScene(nodes, meshes, tuple(written), (image,)), is_quantized))
            bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
            bpy.ops.import_scene.gltf(filepath=str(tmp_path / "a.glb"))
            for index, expected in enumerate(written):
                check_imported(bpy.data.objects[f"n{index}"], expected, uvs, colors)
    finally:
        if not was_enabled:
            addon_utils.disable(GLTF)


def check_imported(item: bpy.types.Object, expected: GlbMaterial, uvs: np.ndarray, colors: np.ndarray) -> None:
    """Check the material of an imported triangle, and where it has texture coordinates and colors."""
    materials = GlbMaterials()
    _, use = materials.add(item.data.materials[0])
    (found,) = materials.materials
    assert (found.name, found.is_double_sided, found.alpha_mode) == (expected.name, expected.is_double_sided, expected.alpha_mode)
    assert found.base_color == pytest.approx(expected.base_color) and materials.unread == {} and found.is_unlit == expected.is_unlit
    assert expected.alpha_mode != MASK or found.alpha_cutoff == pytest.approx(expected.alpha_cutoff)
    assert (found.texture.wrap, found.texture.is_nearest) == (expected.texture.wrap, expected.texture.is_nearest)
    mesh = read_evaluated_mesh(item.data, item)
    matrices = [np.eye(2, 3) if texture.placement is None else np.array(texture.placement) for texture in (found.texture, expected.texture)]
    corners = mesh.triangles[0]
    read, wanted = use.read_uvs(mesh, np.arange(1))[0], uvs[corners]
    assert np.allclose(read @ matrices[0][:, :2].T + matrices[0][:, 2], wanted @ matrices[1][:, :2].T + matrices[1][:, 2], atol=2e-4)
    shown = use.read_colors(mesh, np.arange(1))[0]
    assert np.allclose(shown, colors[corners][:, : shown.shape[1]], atol=0.005)
    assert shown.shape[1] == (3 if expected.alpha_mode == OPAQUE else 4)


def test_uv_maps_and_colors_that_no_material_uses_are_named():
    mesh = bpy.data.meshes.new("Leaf")
    mesh.from_pydata([(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)], [], [(0, 1, 2)])
    for name in ("First", "Second", "Third"):
        mesh.uv_layers.new(name=name)
    for name in ("Shown", "Paint"):
        mesh.color_attributes.new(name, "FLOAT_COLOR", "CORNER")
    nodes = Nodes(checker_image())
    nodes.tree.links.new(nodes.add("UVMap", uv_map="Second"), nodes.image.inputs["Vector"])
    color = nodes.add("VertexColor", layer_name="Shown")
    nodes.link(nodes.add("Mix", 1.0, nodes.image.outputs["Color"], color, data_type="RGBA", blend_type="MULTIPLY"), "Base Color")
    _, use, materials = nodes.read()
    materials.note_attributes("Tree", mesh, [use])
    assert materials.unread == {"Tree": ('the UV map "First"', 'the UV map "Third"', 'the color attribute "Paint"')}
