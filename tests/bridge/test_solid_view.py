"""Solid views show the image that gives a material its color."""

import bpy
import pytest

from bridge.solid_views import shown_image
from farfield.addon.bridge.bdam.materials import ImagePart, TileImages, create_tile_material
from farfield.addon.bridge.photos.results import create_material
from farfield.addon.bridge.shading.solid_view import show_color_image
from textured_scenes import checker_image, textured_material

pytestmark = pytest.mark.usefixtures("empty_scene")


def add_image_node(material: bpy.types.Material, image: bpy.types.Image, target: str) -> bpy.types.Node:
    node = material.node_tree.nodes.new("ShaderNodeTexImage")
    node.image = image
    material.node_tree.links.new(node.outputs["Color"], material.node_tree.nodes["Principled BSDF"].inputs[target])
    return node


@pytest.fixture
def roughness() -> bpy.types.Image:
    return checker_image("Roughness", is_data=True)


@pytest.fixture
def material(roughness) -> bpy.types.Material:
    """A material whose active node is an image of roughness."""
    material = textured_material(None)
    material.node_tree.nodes.active = add_image_node(material, roughness, "Roughness")
    assert shown_image(material) == roughness
    return material


def test_the_color_becomes_active_instead_of_data(material):
    color = checker_image()
    add_image_node(material, color, "Base Color")
    show_color_image(material)
    assert shown_image(material) == color
    show_color_image(material)
    assert shown_image(material) == color


def test_data_without_a_color_is_not_shown(material):
    show_color_image(material)
    assert shown_image(material) is None


def test_the_active_one_of_several_colors_stays(material):
    first, second = checker_image("First"), checker_image("Second")
    nodes, links = material.node_tree.nodes, material.node_tree.links
    mix = nodes.new("ShaderNodeMixRGB")
    links.new(mix.outputs["Color"], nodes["Principled BSDF"].inputs["Base Color"])
    for image, target in ((first, "Color1"), (second, "Color2")):
        node = nodes.new("ShaderNodeTexImage")
        node.image = image
        links.new(node.outputs["Color"], mix.inputs[target])
        nodes.active = node
    show_color_image(material)
    assert shown_image(material) == second
    nodes.active = next(node for node in nodes if node.type == "TEX_IMAGE" and node.image not in (first, second))
    show_color_image(material)
    assert shown_image(material) == first


def test_a_group_in_common_with_other_materials_stays(material, roughness):
    group = bpy.data.node_groups.new("Paint", "ShaderNodeTree")
    group.interface.new_socket("Color", in_out="OUTPUT", socket_type="NodeSocketColor")
    inner = group.nodes.new("ShaderNodeTexImage")
    inner.image = checker_image()
    group.links.new(inner.outputs["Color"], group.nodes.new("NodeGroupOutput").inputs["Color"])
    node = material.node_tree.nodes.new("ShaderNodeGroup")
    node.node_tree = group
    material.node_tree.links.new(node.outputs["Color"], material.node_tree.nodes["Principled BSDF"].inputs["Base Color"])
    show_color_image(material)
    assert shown_image(material) == roughness and not inner.show_texture


def test_materials_without_nodes_or_output_stay(material, roughness):
    nodes = material.node_tree.nodes
    nodes.remove(next(node for node in nodes if node.type == "OUTPUT_MATERIAL"))
    show_color_image(material)
    assert shown_image(material) == roughness
    show_color_image(bpy.data.materials.new("Plain"))


def test_textures_of_photographs_and_terrain_show_their_color(roughness):
    color = checker_image()
    assert shown_image(create_material("Wall", color, has_alpha=True)) == color
    assert shown_image(create_tile_material("Tile", TileImages(ImagePart(color), ImagePart(roughness), None), 1.0, None, None)) == color
