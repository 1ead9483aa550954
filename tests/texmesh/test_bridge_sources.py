"""Which image colors a material, and its colors as arrays."""

import bpy
import numpy as np
import pytest

from farfield.addon.bridge.shading.surface_reader import read_surface
from farfield.addon.bridge.texmesh import color_images
from farfield.addon.bridge.texmesh.color_images import find_color_images, read_color_image
from farfield.addon.bridge.texmesh.glb_images import GlbImages
from farfield.addon.bridge.texmesh.sources import read_textured_source
from farfield.addon.core.errors import FileError
from farfield.addon.core.imaging.coded_images import decode
from farfield.addon.core.imaging.colors import encode_signed_srgb
from textured_scenes import checker_image, textured_ball, textured_material

pytestmark = pytest.mark.usefixtures("empty_scene")
LINEAR_REC_2020 = np.array([[1.6605, -0.5876, -0.0728], [-0.1246, 1.1329, -0.0083], [-0.0182, -0.1006, 1.1187]])  # ITU-R BT.2087


def fill(image: bpy.types.Image, color: tuple[float, float, float]) -> bpy.types.Image:
    image.pixels.foreach_set(np.tile(np.float32([*color, 1.0]), image.size[0] * image.size[1]))
    return image


def read_ball(item: bpy.types.Object):
    return read_textured_source(item, bpy.context.evaluated_depsgraph_get())


def test_an_image_inside_nested_groups_with_a_mapped_uv_map():
    image = checker_image()
    inner, outer = (bpy.data.node_groups.new(name, "ShaderNodeTree") for name in ("Inner", "Outer"))
    for tree in (inner, outer):
        tree.interface.new_socket("Vector", in_out="INPUT", socket_type="NodeSocketVector")
        tree.interface.new_socket("Color", in_out="OUTPUT", socket_type="NodeSocketColor")
        tree.nodes.new("NodeGroupInput")
        tree.nodes.new("NodeGroupOutput")
    texture = inner.nodes.new("ShaderNodeTexImage")
    texture.image = image
    uv_map, mapping = inner.nodes.new("ShaderNodeUVMap"), inner.nodes.new("ShaderNodeMapping")
    uv_map.uv_map = "Second"
    inner.links.new(uv_map.outputs["UV"], mapping.inputs["Vector"])
    inner.links.new(mapping.outputs["Vector"], texture.inputs["Vector"])
    inner.links.new(texture.outputs["Color"], inner.nodes["Group Output"].inputs["Color"])
    nested = outer.nodes.new("ShaderNodeGroup")
    nested.node_tree = inner
    outer.links.new(nested.outputs["Color"], outer.nodes["Group Output"].inputs["Color"])
    material = textured_material(None)
    node, reroute = material.node_tree.nodes.new("ShaderNodeGroup"), material.node_tree.nodes.new("NodeReroute")
    node.node_tree = outer
    material.node_tree.links.new(node.outputs["Color"], reroute.inputs[0])
    material.node_tree.links.new(reroute.outputs[0], material.node_tree.nodes["Principled BSDF"].inputs["Base Color"])
    assert find_color_images(material)[:1] == [(image, "Second")]
    item = textured_ball()
    item.data.materials[0] = material
    item.data.uv_layers.new(name="Second")
    source = read_ball(item)
    assert source.uv_map == "Second" and source.textures[0].shape == (32, 32, 3)


def test_an_image_that_enters_a_group():
    tree = bpy.data.node_groups.new("Tinted", "ShaderNodeTree")
    tree.interface.new_socket("Color", in_out="INPUT", socket_type="NodeSocketColor")
    tree.interface.new_socket("Shader", in_out="OUTPUT", socket_type="NodeSocketShader")
    start, end, shader = (tree.nodes.new(kind) for kind in ("NodeGroupInput", "NodeGroupOutput", "ShaderNodeBsdfDiffuse"))
    tree.links.new(start.outputs["Color"], shader.inputs["Color"])
    tree.links.new(shader.outputs[0], end.inputs["Shader"])
    image = checker_image()
    material = textured_material(image)
    nodes = material.node_tree.nodes
    group = nodes.new("ShaderNodeGroup")
    group.node_tree = tree
    material.node_tree.links.new(nodes["Image Texture"].outputs["Color"], group.inputs["Color"])
    material.node_tree.links.new(group.outputs["Shader"], nodes["Material Output"].inputs["Surface"])
    assert find_color_images(material)[:1] == [(image, "")]


def test_colors_come_before_normals_and_roughness():
    material = textured_material(color := checker_image("Color"))
    nodes, links = material.node_tree.nodes, material.node_tree.links
    for name in ("Roughness", "Alpha", "Metallic"):
        other = nodes.new("ShaderNodeTexImage")
        other.image = checker_image(name)
        links.new(other.outputs["Color"], nodes["Principled BSDF"].inputs[name])
    assert find_color_images(material)[0][0] == color


def test_images_of_other_inputs_are_no_colors():
    material = textured_material(None)
    nodes, links = material.node_tree.nodes, material.node_tree.links
    shader, normal_map, other = nodes["Principled BSDF"], nodes.new("ShaderNodeNormalMap"), nodes.new("ShaderNodeTexImage")
    shader.inputs["Base Color"].default_value = (0.1, 0.2, 0.3, 1.0)
    other.image = checker_image("Roughness", is_data=True)
    links.new(other.outputs["Color"], shader.inputs["Roughness"])
    links.new(other.outputs["Color"], normal_map.inputs["Color"])
    links.new(normal_map.outputs["Normal"], shader.inputs["Normal"])
    mix, transparent = nodes.new("ShaderNodeMixShader"), nodes.new("ShaderNodeBsdfTransparent")
    links.new(other.outputs["Color"], mix.inputs[0])
    links.new(transparent.outputs[0], mix.inputs[1])
    links.new(shader.outputs[0], mix.inputs[2])
    links.new(mix.outputs[0], nodes["Material Output"].inputs["Surface"])
    assert find_color_images(material) == []
    light = nodes.new("ShaderNodeTexImage")
    light.image = checker_image("Light")
    links.new(light.outputs["Color"], shader.inputs["Emission Color"])
    shader.inputs["Emission Strength"].default_value = 1.0
    assert find_color_images(material) == [(light.image, "")]


def test_all_images_of_a_color_are_found_the_nearest_first():
    material = textured_material(first := checker_image("First"))
    nodes, links = material.node_tree.nodes, material.node_tree.links
    ramp, mix, gamma = (nodes.new(f"ShaderNode{kind}") for kind in ("ValToRGB", "MixRGB", "Gamma"))
    mask = nodes.new("ShaderNodeTexImage")
    mask.image = checker_image("Mask")
    links.new(mask.outputs["Color"], ramp.inputs[0])
    links.new(ramp.outputs[0], mix.inputs[0])
    links.new(nodes["Image Texture"].outputs["Color"], gamma.inputs["Color"])
    links.new(gamma.outputs[0], mix.inputs[1])
    links.new(mix.outputs[0], nodes["Principled BSDF"].inputs["Base Color"])
    assert find_color_images(material) == [(first, ""), (mask.image, "")]


def test_materials_without_an_image():
    assert find_color_images(None) == []
    material = textured_material(None)
    material.node_tree.nodes["Principled BSDF"].inputs["Base Color"].default_value = (0.1, 0.2, 0.3, 1.0)
    assert find_color_images(material) == []
    assert read_surface(material).color.factor == pytest.approx((0.1, 0.2, 0.3))


def test_values_that_are_no_numbers_are_black():
    material = textured_material(None)
    material.node_tree.nodes["Principled BSDF"].inputs["Base Color"].default_value = (0.5, float("nan"), 0.25, 1.0)
    assert read_surface(material).color.factor == (0.5, 0.0, 0.25)


@pytest.mark.parametrize(
    ("properties", "space", "linear"),
    [
        ({}, "sRGB", [0.21404, 0.03310, 0.60383]),  # encoded values in a byte image
        ({"float_buffer": True}, "Linear Rec.709", [0.5, 0.2, 0.8]),
        ({"is_data": True}, "Non-Color", [0.5, 0.2, 0.8]),
        ({}, "Linear Rec.709", [0.5, 0.2, 0.8]),
        ({}, "Linear Rec.2020", LINEAR_REC_2020 @ [0.5, 0.2, 0.8]),
        ({}, "Rec.1886", np.power([0.5, 0.2, 0.8], 2.4)),
    ],
)
def test_color_spaces(properties, space, linear):
    image = bpy.data.images.new("Flat", 8, 8, **properties)
    image.colorspace_settings.name = space
    fill(image, (0.5, 0.2, 0.8))
    colors, is_scaled = read_color_image(image)
    assert colors.shape == (8, 8, 3) and colors.dtype == np.float32 and not is_scaled
    np.testing.assert_allclose(colors, np.broadcast_to(linear, (8, 8, 3)), atol=4e-3)
    images = GlbImages()
    stored = images.prepare(image, is_color=True)
    assert (stored == image) == (not properties and space == "sRGB")
    coded = image.pixels[:3] if stored == image else decode(stored.packed_file.data)[0, 0] / 255.0  # glTF wants sRGB values
    np.testing.assert_allclose(coded, np.clip(encode_signed_srgb(np.float64(linear)), 0.0, 1.0), atol=6e-3)
    images.remove()
    assert [item.name for item in bpy.data.scenes] == ["Scene"] and list(bpy.data.images) == [image]


def test_larger_images_are_scaled_down_and_said(monkeypatch):
    monkeypatch.setattr(color_images, "MAX_SIDE", 16)
    item = textured_ball()
    image = item.data.materials[0].node_tree.nodes["Image Texture"].image
    count = len(bpy.data.images)
    source = read_ball(item)
    assert source.textures[0].shape == (16, 16, 3) and tuple(image.size) == (32, 32) and len(bpy.data.images) == count
    assert f'The image "{image.name}" is analyzed at 16 by 16 pixels.' in source.remarks
    np.testing.assert_allclose(source.textures[0].mean(), read_color_image_unscaled(image).mean(), rtol=0.1)


def read_color_image_unscaled(image: bpy.types.Image) -> np.ndarray:
    pixels = np.empty(image.size[0] * image.size[1] * 4, np.float32)
    image.pixels.foreach_get(pixels)
    encoded = pixels.reshape(-1, 4)[:, :3]
    return np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)


def test_of_udim_tiles_the_first_counts(tmp_path):
    for tile in (1001, 1002):
        saved = fill(bpy.data.images.new("Tile", 8, 8), (0.5, 0.2, 0.8) if tile == 1001 else (0.0, 0.0, 0.0))
        saved.filepath_raw, saved.file_format = str(tmp_path / f"wood.{tile}.png"), "PNG"
        saved.save()
    image = bpy.data.images.load(str(tmp_path / "wood.1001.png"))
    image.source, image.filepath = "TILED", str(tmp_path / "wood.<UDIM>.png")
    image.tiles.new(1002)
    item = textured_ball()
    item.data.materials[0].node_tree.nodes["Image Texture"].image = image
    source = read_ball(item)
    assert f'Of the UDIM image "{image.name}" only the first tile counts.' in source.remarks
    np.testing.assert_allclose(source.textures[0][0, 0], [0.21404, 0.03310, 0.60383], atol=4e-3)


def test_a_missing_image_is_named():
    item = textured_ball()
    image = bpy.data.images.new("Lost", 8, 8)
    image.source, image.filepath = "FILE", "//lost.png"
    item.data.materials[0].node_tree.nodes["Image Texture"].image = image
    with pytest.raises(FileError, match=r'"Lost.*" is missing or empty'):
        read_ball(item)


def test_plain_colors_count_beside_others():
    item = textured_ball()
    glass, paint = textured_material(None, "Glass"), textured_material(None, "Red")
    for material, color in ((glass, (0.02, 0.1, 0.05, 1.0)), (paint, (0.7, 0.1, 0.1, 1.0))):
        material.node_tree.nodes["Principled BSDF"].inputs["Base Color"].default_value = color
        item.data.materials.append(material)
    item.data.polygons.foreach_set("material_index", np.arange(len(item.data.polygons)) % 3)
    textures = {len(texture): texture for texture in read_ball(item).textures[:2]}
    assert textures.keys() == {32, 1} and textures[1].ravel() == pytest.approx([0.02, 0.1, 0.05])
    item.data.materials[0] = paint
    source = read_ball(item)
    assert [len(texture) for texture in source.textures] == [1] * len(source.textures)
    assert any("only its geometry and plain colors count" in remark for remark in source.remarks)
    for index in range(3):
        item.data.materials[index] = glass
    source = read_ball(item)
    assert not any(texture is not None for texture in source.textures)
    assert any("only its geometry counts" in remark for remark in source.remarks)
