"""What packages read of objects: their orientation, and the images of their materials by role."""

import bpy
import numpy as np
import pytest

from farfield.addon.bridge.packages.images import PackageImages
from farfield.addon.bridge.packages.sources import read_material, read_package_source
from farfield.addon.core.imaging.colors import LINEAR_OF_BYTE
from textured_scenes import checker_image, textured_ball, textured_material

pytestmark = pytest.mark.usefixtures("empty_scene")


def data_image(values: tuple[float, float, float]) -> bpy.types.Image:
    image = bpy.data.images.new("data", 8, 4, is_data=True)
    image.pixels.foreach_set(np.tile(np.float32([*values, 1.0]), 32))
    return image


def image_node(material: bpy.types.Material, image: bpy.types.Image) -> bpy.types.Node:
    node = material.node_tree.nodes.new("ShaderNodeTexImage")
    node.image = image
    return node


def signed_volume(mesh) -> float:
    corners = mesh.vertices[mesh.triangles]
    return float(np.einsum("ti,ti->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6.0)


def test_images_by_role():
    material = textured_material(checker_image())
    tree, shader = material.node_tree, material.node_tree.nodes["Principled BSDF"]
    packed, normals = image_node(material, data_image((0.2, 0.4, 0.6))), image_node(material, data_image((0.5, 0.5, 1.0)))
    separate, normal_map = tree.nodes.new("ShaderNodeSeparateColor"), tree.nodes.new("ShaderNodeNormalMap")
    tree.links.new(packed.outputs["Color"], separate.inputs[0])
    tree.links.new(separate.outputs["Green"], shader.inputs["Roughness"])
    tree.links.new(separate.outputs["Blue"], shader.inputs["Metallic"])
    tree.links.new(normals.outputs["Color"], normal_map.inputs["Color"])
    tree.links.new(normal_map.outputs["Normal"], shader.inputs["Normal"])
    source = read_material(material, PackageImages())
    assert set(source.images) == {"base_color", "roughness", "metallic", "normal"}
    assert source.base_color == (1.0, 1.0, 1.0, 1.0)
    assert (source.images["roughness"] == 102).all() and (source.images["metallic"] == 153).all()
    assert source.images["normal"].shape == (4, 8, 3) and (source.images["normal"][0, 0] == [128, 128, 255]).all()


def test_base_color_is_srgb_encoded():
    image = bpy.data.images.new("float", 2, 2, float_buffer=True)
    image.pixels.foreach_set(np.tile(np.float32([0.214, 1.0, 0.0, 1.0]), 4))
    assert np.abs(read_material(textured_material(image), PackageImages()).images["base_color"].astype(int) - [127, 255, 0]).max() <= 1


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
    source = read_material(None, PackageImages())
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


def test_transparency_is_said():
    ball = textured_ball()
    ball.data.materials[0].node_tree.nodes["Principled BSDF"].inputs["Alpha"].default_value = 0.5
    remarks = read_package_source(ball, bpy.context.evaluated_depsgraph_get()).remarks
    assert 'The package lacks transparency of "Paint".' in remarks


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
