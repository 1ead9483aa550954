"""What packages read of objects: their orientation, and the images of their materials by role."""

import bpy
import numpy as np
import pytest

from farfield.addon.bridge.packages.images import PackageImages
from farfield.addon.bridge.packages.materials import read_material
from farfield.addon.bridge.packages.sources import read_package_source
from farfield.addon.core.imaging.colors import LINEAR_OF_BYTE
from farfield.addon.core.packages.manifest import ROLES
from farfield.addon.core.packages.shading import Shading
from textured_scenes import checker_image, textured_ball, textured_material

pytestmark = pytest.mark.usefixtures("empty_scene")


def data_image(values: tuple[float, float, float], noise: float = 0.0) -> bpy.types.Image:
    image = bpy.data.images.new("data", 8, 4, is_data=True)
    pixels = np.tile(np.float32([*values, 0.8]), 32)
    image.pixels.foreach_set(pixels + np.random.default_rng(1).uniform(-noise, noise, pixels.shape).astype(np.float32))
    return image


def image_node(material: bpy.types.Material, image: bpy.types.Image) -> bpy.types.Node:
    node = material.node_tree.nodes.new("ShaderNodeTexImage")
    node.image = image
    return node


def signed_volume(mesh) -> float:
    corners = mesh.vertices[mesh.triangles]
    return float(np.einsum("ti,ti->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6.0)


def build_material() -> tuple[bpy.types.Material, dict[str, bpy.types.Image]]:
    """A material with a different image for each map, as Blender's glTF importer builds it."""
    material = textured_material(checker_image())
    tree, shader = material.node_tree, material.node_tree.nodes["Principled BSDF"]
    images = {name: data_image(values, 0.02) for name, values in VALUES.items()}
    nodes = {name: image_node(material, image) for name, image in images.items()}
    separate, normal_map = tree.nodes.new("ShaderNodeSeparateColor"), tree.nodes.new("ShaderNodeNormalMap")
    normal_map.inputs["Strength"].default_value = 0.7
    tree.links.new(nodes["packed"].outputs["Color"], separate.inputs[0])
    tree.links.new(separate.outputs["Green"], shader.inputs["Roughness"])
    tree.links.new(separate.outputs["Blue"], shader.inputs["Metallic"])
    tree.links.new(nodes["normal"].outputs["Color"], normal_map.inputs["Color"])
    tree.links.new(normal_map.outputs["Normal"], shader.inputs["Normal"])
    tree.links.new(nodes["emission"].outputs["Color"], shader.inputs["Emission Color"])
    shader.inputs["Emission Strength"].default_value = 3.0
    tree.links.new(nodes["alpha"].outputs["Alpha"], shader.inputs["Alpha"])
    settings = tree.nodes.new("ShaderNodeGroup")
    settings.node_tree = bpy.data.node_groups.new("glTF Material Output", "ShaderNodeTree")
    settings.node_tree.interface.new_socket("Occlusion", in_out="INPUT", socket_type="NodeSocketFloat")
    tree.links.new(separate.outputs["Red"], settings.inputs["Occlusion"])
    return material, images


VALUES = {"packed": (0.2, 0.4, 0.6), "normal": (0.5, 0.5, 1.0), "emission": (0.5, 0.25, 0.0), "alpha": (0.5, 0.5, 0.5)}


def test_all_maps_of_a_material_are_read_with_their_factors():
    source = read_material(build_material()[0], PackageImages()).source
    assert set(source.images) == set(ROLES)
    means = {role: source.images[role].mean(axis=(0, 1)) for role in ("occlusion", "roughness", "metallic", "normal", "alpha")}
    for role, value in (("occlusion", 0.2), ("roughness", 0.4), ("metallic", 0.6), ("alpha", 0.8)):
        np.testing.assert_allclose(means[role], 255.0 * value, atol=6.0)
    np.testing.assert_allclose(means["normal"], [127.5, 127.5, 255.0], atol=6.0)
    assert source.base_color == (1.0, 1.0, 1.0, 1.0)
    assert source.shading == Shading(1.0, 1.0, (3.0, 3.0, 3.0), pytest.approx(0.7), "blend", 0.0)


def test_images_with_one_value_are_factors():
    material, images = build_material()
    for name, image in images.items():
        image.pixels.foreach_set(np.tile(np.float32([*VALUES[name], 0.8]), 32))
    source = read_material(material, PackageImages()).source
    assert set(source.images) == {"base_color"}
    shading = source.shading
    assert (shading.roughness, shading.metallic) == (pytest.approx(102 / 255), pytest.approx(153 / 255))
    assert shading.emission == pytest.approx([1.5, 0.75, 0.0], abs=0.02)
    assert source.base_color[3] == pytest.approx(204 / 255) and shading.alpha_mode == "blend"


def test_factors_without_images_and_an_alpha_that_is_compared():
    material, _ = build_material()
    tree, shader = material.node_tree, material.node_tree.nodes["Principled BSDF"]
    for name, value in (("Roughness", 0.3), ("Metallic", 0.9), ("Emission Color", (1.0, 0.5, 0.0, 1.0))):
        tree.links.remove(shader.inputs[name].links[0])
        shader.inputs[name].default_value = value
    compare = tree.nodes.new("ShaderNodeMath")
    compare.operation = "GREATER_THAN"
    compare.inputs[1].default_value = 0.25
    tree.links.new(shader.inputs["Alpha"].links[0].from_socket, compare.inputs[0])
    tree.links.new(compare.outputs[0], shader.inputs["Alpha"])
    shading = read_material(material, PackageImages()).source.shading
    assert shading == Shading(*map(pytest.approx, (0.3, 0.9, (3.0, 1.5, 0.0), 0.7)), "mask", 0.25)


def test_what_emits_only_shows_its_color_without_light():
    material = textured_material(checker_image())
    tree = material.node_tree
    emission, image = tree.nodes.new("ShaderNodeEmission"), tree.nodes["Image Texture"]
    emission.inputs["Strength"].default_value = 2.0
    tree.links.new(image.outputs["Color"], emission.inputs["Color"])
    tree.links.new(emission.outputs[0], tree.nodes["Material Output"].inputs["Surface"])
    source = read_material(material, PackageImages()).source
    assert source.shading.is_unlit and set(source.images) == {"base_color"} and source.base_color == (2.0, 2.0, 2.0, 1.0)


def test_images_that_lie_elsewhere_are_named():
    material, images = build_material()
    tree, mapping = material.node_tree, material.node_tree.nodes.new("ShaderNodeMapping")
    mapping.inputs["Scale"].default_value = (7.0, 7.0, 1.0)
    node = next(node for node in tree.nodes if node.type == "TEX_IMAGE" and node.image == images["normal"])
    tree.links.new(tree.nodes.new("ShaderNodeTexCoord").outputs["UV"], mapping.inputs["Vector"])
    tree.links.new(mapping.outputs["Vector"], node.inputs["Vector"])
    found = read_material(material, PackageImages())
    assert "normal" not in found.source.images and found.lacking == (f'the image "{images["normal"].name}"',)


def test_base_color_is_srgb_encoded():
    image = bpy.data.images.new("float", 2, 2, float_buffer=True)
    image.pixels.foreach_set(np.tile(np.float32([0.214, 1.0, 0.0, 1.0]), 4))
    assert (
        np.abs(read_material(textured_material(image), PackageImages()).source.images["base_color"].astype(int) - [127, 255, 0]).max() <= 1
    )


def test_materials_with_the_same_image_have_one_array():
    ball, image = textured_ball(), checker_image()
    ball.data.materials.clear()
    for _ in range(2):
        ball.data.materials.append(textured_material(image))
    for polygon in ball.data.polygons:
        polygon.material_index = polygon.index % 2
    source = read_package_source(ball, bpy.context.evaluated_depsgraph_get())
    first, second = (material.images["base_color"] for material in source.materials)
    assert first is second
    np.testing.assert_array_equal(source.textures[0], LINEAR_OF_BYTE[first])


def test_no_material_is_gray_and_without_images():
    source = read_material(None, PackageImages()).source
    assert source.images == {} and source.base_color == (0.8, 0.8, 0.8, 1.0)


@pytest.mark.parametrize("scale", [(2.0, 2.0, 2.0), (-2.0, 2.0, 2.0)])
def test_meshes_have_the_size_of_the_world_and_faces_look_outside(scale):
    ball = textured_ball()
    volume = signed_volume(read_package_source(ball, bpy.context.evaluated_depsgraph_get()).mesh)
    ball.scale, ball.location, ball.rotation_euler = scale, (5.0, 0.0, 0.0), (0.3, 0.2, 0.1)
    bpy.context.view_layer.update()
    mesh = read_package_source(ball, bpy.context.evaluated_depsgraph_get()).mesh
    assert signed_volume(mesh) == pytest.approx(8.0 * volume, rel=1e-5) and volume > 0.0
    assert np.abs(mesh.vertices).max() < 5.0
    assert mesh.attributes.shape[1] == 0


def test_transparency_is_part_of_the_package():
    ball = textured_ball()
    ball.data.materials[0].node_tree.nodes["Principled BSDF"].inputs["Alpha"].default_value = 0.5
    source = read_package_source(ball, bpy.context.evaluated_depsgraph_get())
    assert source.materials[0].base_color[3] == 0.5 and source.materials[0].shading.alpha_mode == "blend"
    assert not any("lacks" in remark for remark in source.remarks)


def test_color_factors_and_mappings_are_part_of_the_package_and_other_things_are_named():
    ball = textured_ball()
    material = ball.data.materials[0]
    tree, image = material.node_tree, material.node_tree.nodes["Image Texture"]
    before = read_package_source(ball, bpy.context.evaluated_depsgraph_get())
    factor, mapping, coordinates, colors, both = (
        tree.nodes.new(f"ShaderNode{kind}") for kind in ("MixRGB", "Mapping", "TexCoord", "VertexColor", "MixRGB")
    )
    for node in (factor, both):
        node.blend_type = "MULTIPLY"
        node.inputs[0].default_value = 1.0
    factor.inputs[2].default_value = (0.5, 0.25, 1.0, 1.0)
    mapping.inputs["Scale"].default_value, mapping.inputs["Location"].default_value = (4.0, 2.0, 1.0), (0.5, -1.0, 0.0)
    tree.links.new(coordinates.outputs["UV"], mapping.inputs["Vector"])
    tree.links.new(mapping.outputs["Vector"], image.inputs["Vector"])
    tree.links.new(image.outputs["Color"], factor.inputs[1])
    tree.links.new(factor.outputs[0], both.inputs[1])
    tree.links.new(colors.outputs["Color"], both.inputs[2])
    tree.links.new(both.outputs[0], tree.nodes["Principled BSDF"].inputs["Base Color"])
    image.extension = "EXTEND"
    after = read_package_source(ball, bpy.context.evaluated_depsgraph_get())
    assert after.materials[0].base_color == pytest.approx((0.5, 0.25, 1.0, 1.0))
    assert set(after.materials[0].images) == {"base_color"}
    assert np.allclose(after.mesh.uvs, before.mesh.uvs * [4.0, 2.0] + [0.5, -1.0])
    assert 'The package lacks vertex colors, the wrapping of its image of "Paint".' in after.remarks
