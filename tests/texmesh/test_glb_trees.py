"""Node trees that Blender's exporter does not understand give the same .glb files as trees that mean the same and that it does, and what
glTF cannot store is named."""

import math

import bpy
import numpy as np
import pytest

from farfield.addon.bridge import lod_crossfade
from farfield.addon.bridge.texmesh.color_images import find_color_images
from farfield.addon.bridge.texmesh.glb_objects import GlbObjects
from farfield.addon.compat import uses_nodes
from farfield.addon.core.errors import FileError
from farfield.addon.core.imaging.coded_images import decode
from farfield.addon.core.messages import describe_lacking
from glb_scenes import Nodes, check_equal, random_image, square, write, write_with_blender

pytestmark = pytest.mark.usefixtures("empty_scene")
FACTOR = (0.6, 0.8, 1.0, 1.0)  # what a factor of one half makes of RED
RED = (0.2, 0.6, 1.0, 1.0)


def put_in_group(nodes: Nodes, kind: str, *inputs: tuple[bpy.types.NodeSocket, str], output: str, **properties) -> bpy.types.NodeSocket:
    """Add a group with a node whose `inputs`, links and names, are those of the group, and return its output."""
    tree = bpy.data.node_groups.new("Group", "ShaderNodeTree")
    start, inner, end = (tree.nodes.new(name) for name in ("NodeGroupInput", f"ShaderNode{kind}", "NodeGroupOutput"))
    for name, value in properties.items():
        setattr(inner, name, value)
    for link, name in inputs:
        tree.interface.new_socket(name, in_out="INPUT", socket_type=link.bl_idname)
    tree.interface.new_socket("Result", in_out="OUTPUT", socket_type=inner.outputs[output].bl_idname)
    group = nodes.tree.nodes.new("ShaderNodeGroup")
    group.node_tree = tree
    for index, (link, name) in enumerate(inputs):
        tree.links.new(start.outputs[index], next(item for item in inner.inputs if name in (item.name, item.identifier)))
        nodes.tree.links.new(link, group.inputs[index])
    tree.links.new(inner.outputs[output], end.inputs[0])
    return group.outputs[0]


def fading_factor(nodes: Nodes) -> None:
    nodes.set(Base_Color=nodes.multiply(nodes.image.outputs["Color"], RED, 0.5))


def factor_in_a_group(nodes: Nodes) -> None:
    red = nodes.add("RGB")
    red.default_value = FACTOR
    inputs = (nodes.image.outputs["Color"], "Color1"), (red, "Color2")
    color = put_in_group(nodes, "MixRGB", *inputs, output="Color", blend_type="MULTIPLY")
    group = nodes.tree.nodes["Group"].node_tree
    group.nodes["Mix (Legacy)" if "Mix (Legacy)" in group.nodes else 1].inputs[0].default_value = 1.0
    nodes.set(Base_Color=color)


def plain_factor(nodes: Nodes) -> None:
    nodes.set(Base_Color=nodes.multiply(nodes.image.outputs["Color"], FACTOR))


def muted_node(nodes: Nodes) -> None:
    changed = nodes.add("Gamma", nodes.image.outputs["Color"], 2.0)
    changed.node.mute = True
    nodes.set(Base_Color=changed)


def as_it_is(nodes: Nodes) -> None:
    """The image as base color."""


def shader_in_a_group(nodes: Nodes) -> None:
    nodes.show(put_in_group(nodes, "BsdfPrincipled", (nodes.image.outputs["Color"], "Base Color"), output="BSDF"))


def cross_fade(nodes: Nodes) -> None:
    lod_crossfade.add_crossfade(nodes.item, 0.1, 1.0, 0.2)


def blend(nodes: Nodes) -> None:
    nodes.set(Alpha=nodes.image.outputs["Alpha"])


def transparent_first(nodes: Nodes) -> None:
    nodes.show(nodes.add("MixShader", nodes.image.outputs["Alpha"], nodes.add("BsdfTransparent"), nodes.shader.outputs[0]))


def transparent_second(nodes: Nodes) -> None:
    inverse = nodes.add("Math", 1.0, nodes.image.outputs["Alpha"], operation="SUBTRACT")
    nodes.show(nodes.add("MixShader", inverse, nodes.shader.outputs[0], nodes.add("BsdfTransparent")))


def compared_alpha(nodes: Nodes) -> None:
    opacity = nodes.add("Math", nodes.image.outputs["Alpha"], 0.25, operation="GREATER_THAN")
    nodes.show(nodes.add("MixShader", opacity, nodes.add("BsdfTransparent"), nodes.shader.outputs[0]))


def masked_alpha(nodes: Nodes) -> None:
    nodes.set(Alpha=nodes.add("Math", nodes.image.outputs["Alpha"], 0.25, operation="GREATER_THAN"))


def diffuse(nodes: Nodes) -> None:
    nodes.show(nodes.add("BsdfDiffuse", nodes.image.outputs["Color"]))


def rough(nodes: Nodes) -> None:
    nodes.set(Roughness=1.0, Specular_IOR_Level=0.0)


def glossy(nodes: Nodes) -> None:
    nodes.show(nodes.add("BsdfAnisotropic", nodes.image.outputs["Color"], 0.25))


def metal(nodes: Nodes) -> None:
    nodes.set(Metallic=1.0, Roughness=0.25)


def glass(nodes: Nodes) -> None:
    shader = nodes.add("BsdfGlass", nodes.image.outputs["Color"]).node
    shader.inputs["Roughness"].default_value, shader.inputs["IOR"].default_value = 0.125, 1.33
    nodes.show(shader.outputs[0])


def transmission(nodes: Nodes) -> None:
    nodes.set(Transmission_Weight=1.0, Roughness=0.125, IOR=1.33)


def added_light(nodes: Nodes) -> None:
    light = nodes.add("Emission", nodes.image.outputs["Color"], 3.0)
    nodes.show(nodes.add("AddShader", light, nodes.shader.outputs[0]))


def light(nodes: Nodes) -> None:
    nodes.set(Emission_Color=nodes.image.outputs["Color"], Emission_Strength=3.0)


def transparent_light(nodes: Nodes) -> None:
    light = nodes.add("Emission", nodes.image.outputs["Color"], 3.0)
    nodes.show(nodes.add("MixShader", 0.5, nodes.add("BsdfTransparent"), light))


def black_light(nodes: Nodes) -> None:
    light(nodes)
    nodes.tree.links.remove(nodes.shader.inputs["Base Color"].links[0])
    nodes.set(Base_Color=(0.0, 0.0, 0.0, 1.0), Metallic=1.0, Roughness=1.0, Alpha=0.5)


def linked_numbers(nodes: Nodes) -> None:
    for name, value in (("Transmission Weight", 0.5), ("IOR", 1.33), ("Coat Weight", 0.25), ("Roughness", 0.75)):
        number = nodes.add("Value")
        number.default_value = value
        nodes.tree.links.new(number, nodes.shader.inputs[name])


def numbers(nodes: Nodes) -> None:
    nodes.set(Transmission_Weight=0.5, IOR=1.33, Coat_Weight=0.25, Roughness=0.75)


def chained_placement(nodes: Nodes) -> None:
    first = nodes.add("Mapping", nodes.add("UVMap", uv_map="Second"), vector_type="VECTOR").node
    first.inputs["Rotation"].default_value, first.inputs["Scale"].default_value = (0.0, 0.0, math.radians(30.0)), (4.0, 4.0, 1.0)
    nodes.place(nodes.add("VectorMath", first.outputs[0], (1.0, 2.0, 0.0), operation="ADD"))


def placement(nodes: Nodes) -> None:
    mapping = nodes.add("Mapping", nodes.add("UVMap", uv_map="Second")).node
    for name, value in (("Location", (1.0, 2.0, 0.0)), ("Rotation", (0.0, 0.0, math.radians(30.0))), ("Scale", (4.0, 4.0, 1.0))):
        mapping.inputs[name].default_value = value
    nodes.place(mapping.outputs[0])


def two_outputs(nodes: Nodes) -> None:
    """Files from before Blender 5.0 have one for each engine where a material had no nodes."""
    nodes.output.target = "EEVEE"
    other = nodes.tree.nodes.new("ShaderNodeOutputMaterial")
    other.target = "CYCLES"
    nodes.tree.links.new(nodes.add("BsdfDiffuse", nodes.image.outputs["Color"]), other.inputs["Surface"])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "equivalent"),
    [
        (fading_factor, plain_factor),
        (factor_in_a_group, plain_factor),
        (muted_node, as_it_is),
        (shader_in_a_group, as_it_is),
        (cross_fade, as_it_is),
        (transparent_first, blend),
        (transparent_second, blend),
        (compared_alpha, masked_alpha),
        (diffuse, rough),
        (glossy, metal),
        (glass, transmission),
        (added_light, light),
        (transparent_light, black_light),
        (linked_numbers, numbers),
        (chained_placement, placement),
        (two_outputs, rough),
    ],
)
def test_trees_that_mean_the_same_give_the_same_material(change, equivalent):
    nodes, simple = Nodes(), Nodes()
    change(nodes)
    equivalent(simple)
    (found, lacking), expected = write(nodes.item), write_with_blender(simple.item)
    assert lacking == {}
    check_equal(found.materials[0], {**expected.materials[0], "name": "Leaf"})


def test_colors_of_vertices_that_are_multiplied():
    """glTF has one color per vertex, of which the exporter knows one attribute."""
    nodes, plain = Nodes("Leaf"), Nodes("Plain")
    shown, paint = (nodes.add("VertexColor", layer_name=name).node.outputs for name in ("Shown", "Paint"))
    nodes.set(Base_Color=nodes.multiply(shown["Color"], paint["Color"]), Alpha=paint["Alpha"])
    item = square("Both", nodes.material, plain.material)
    values = {name: np.empty(24, np.float32) for name in ("Shown", "Paint")}
    for name, colors in values.items():
        item.data.color_attributes[name].data.foreach_get("color", colors)
    found, lacking = write(item)
    leaf, other = sorted(found.meshes[0].primitives, key=lambda part: found.materials[part.material]["name"])
    product = values["Shown"].reshape(-1, 4)[:3] * values["Paint"].reshape(-1, 4)[:3]
    product[:, 3] = values["Paint"].reshape(-1, 4)[:3, 3]
    assert lacking == {} and found.materials[leaf.material]["alphaMode"] == "BLEND"
    np.testing.assert_allclose(np.sort(leaf.attributes["COLOR_0"], axis=0), np.sort(product, axis=0), atol=1e-4)
    assert (other.attributes["COLOR_0"] == 1.0).all()


def test_opacities_of_vertices_without_colors():
    nodes = Nodes()
    nodes.set(Alpha=nodes.add("VertexColor", layer_name="Shown").node.outputs["Alpha"])
    found, lacking = write(nodes.item)
    colors = found.meshes[0].primitives[0].attributes["COLOR_0"]
    assert lacking == {} and (colors[:, :3] == 1.0).all() and np.ptp(colors[:, 3]) > 0.1


def test_alpha_that_does_not_show_is_not_stored():
    """glTF would multiply the opacity of the material with that of the image."""
    nodes = Nodes()
    nodes.set(Alpha=0.5)
    found, _ = write(nodes.item)
    assert found.materials[0]["alphaMode"] == "BLEND" and decode(found.images[0]).shape[2] == 3
    nodes.image.image.alpha_mode = "NONE"
    nodes.set(Alpha=nodes.image.outputs["Alpha"])
    found, _ = write(nodes.item)
    assert "alphaMode" not in found.materials[0]


def test_colors_in_another_space_are_converted():
    nodes = Nodes()
    nodes.image.image = image = random_image("Linear", is_data=True)
    found, _ = write(nodes.item)
    linear = np.array(image.pixels[:]).reshape(8, 8, 4)[..., :3]
    encoded = np.where(linear > 0.0031308, 1.055 * linear ** (1.0 / 2.4) - 0.055, 12.92 * linear)
    assert np.abs(decode(found.images[0]) / 255.0 - encoded).max() < 0.005
    assert {item.name for item in bpy.data.images} == {"Leaf", "Linear"}


def test_a_material_without_nodes_has_its_viewport_color():
    material = bpy.data.materials.new("Leaf")
    if uses_nodes(material):
        pytest.skip("materials of this Blender have nodes")
    item = square("Leaf", material)
    material.diffuse_color, material.metallic, material.roughness = (0.2, 0.4, 0.6, 1.0), 0.25, 0.75
    surface = write(item)[0].materials[0]["pbrMetallicRoughness"]
    assert surface == {"baseColorFactor": pytest.approx([0.2, 0.4, 0.6, 1.0]), "metallicFactor": 0.25, "roughnessFactor": 0.75}


def lose_color_changes(nodes: Nodes) -> None:
    nodes.set(Base_Color=nodes.add("HueSaturation", None, None, None, None, nodes.image.outputs["Color"]))


def lose_bumps(nodes: Nodes) -> None:
    nodes.set(Normal=nodes.add("Bump", None, None, None, nodes.add_image("Height")))


def lose_subsurface_scattering(nodes: Nodes) -> None:
    nodes.set(Subsurface_Weight=0.5)


def lose_coat_color(nodes: Nodes) -> None:
    nodes.set(Coat_Weight=0.5, Coat_Tint=(1.0, 0.5, 0.25, 1.0))


def lose_displacement(nodes: Nodes) -> None:
    nodes.tree.links.new(nodes.add("Displacement"), nodes.output.inputs["Displacement"])


def lose_a_volume(nodes: Nodes) -> None:
    nodes.tree.links.new(nodes.add("VolumeScatter"), nodes.output.inputs["Volume"])


def lose_a_second_shader(nodes: Nodes) -> None:
    nodes.show(nodes.add("MixShader", 0.5, nodes.shader.outputs[0], nodes.add("BsdfAnisotropic")))


def lose_a_second_image(nodes: Nodes) -> None:
    nodes.set(Base_Color=nodes.multiply(nodes.image.outputs["Color"], nodes.add_image("Dirt")))


def lose_generated_coordinates(nodes: Nodes) -> None:
    nodes.place(nodes.add("TexCoord").node.outputs["Generated"])


def lose_shear(nodes: Nodes) -> None:
    mapping = nodes.add("Mapping", nodes.add("TexCoord").node.outputs["UV"], vector_type="TEXTURE").node
    mapping.inputs["Rotation"].default_value, mapping.inputs["Scale"].default_value = (0.0, 0.0, 0.5), (1.0, 3.0, 1.0)
    nodes.place(mapping.outputs[0])


def lose_unknown_opacity(nodes: Nodes) -> None:
    nodes.set(Alpha=nodes.add("LayerWeight"))


def lose_unknown_roughness(nodes: Nodes) -> None:
    nodes.set(Roughness=nodes.add("TexNoise"))


def lose_bright_colors(nodes: Nodes) -> None:
    nodes.set(Base_Color=nodes.multiply(nodes.image.outputs["Color"], (2.0, 1.0, 1.0, 1.0)))


def lose_a_border(nodes: Nodes) -> None:
    nodes.image.extension = "CLIP"
    nodes.item.data.uv_layers[0].uv[0].vector = (2.0, 0.5)


def lose_translucency(nodes: Nodes) -> None:
    nodes.show(nodes.add("BsdfTranslucent", nodes.image.outputs["Color"]))


@pytest.mark.parametrize(
    ("change", "labels"),
    [
        (lose_color_changes, ("Hue/Saturation/Value",)),
        (lose_bumps, ("Bump",)),
        (lose_subsurface_scattering, ("Subsurface Weight",)),
        (lose_coat_color, ("Coat Tint",)),
        (lose_displacement, ("Displacement",)),
        (lose_a_volume, ("Volume",)),
        (lose_a_second_shader, ("Mix Shader",)),
        (lose_a_second_image, ('the image "Dirt"',)),
        (lose_generated_coordinates, ("Generated coordinates",)),
        (lose_shear, ("Mapping",)),
        (lose_unknown_opacity, ("Layer Weight",)),
        (lose_unknown_roughness, ("Noise Texture",)),
        (lose_bright_colors, ("a color above 1",)),
        (lose_a_border, ("the border of its image",)),
        (lose_translucency, ("Translucent BSDF",)),
    ],
)
def test_what_a_file_lacks_is_named(change, labels):
    nodes = Nodes()
    change(nodes)
    found, lacking = write(nodes.item)
    assert "baseColorTexture" in found.materials[0]["pbrMetallicRoughness"] and "alphaMode" not in found.materials[0]
    assert lacking == {"Leaf": labels}
    assert describe_lacking(lacking, "The .glb") == [f'The .glb lacks {labels[0]} of "Leaf".']


def test_color_attributes_that_no_material_uses_are_named():
    nodes = Nodes()
    nodes.set(Base_Color=nodes.multiply(nodes.image.outputs["Color"], nodes.add("VertexColor", layer_name="Shown")))
    with GlbObjects() as objects:
        objects.add(nodes.item, "Tree")
    assert objects.lacking == {"Tree": ('the color attribute "Paint"',)}


def lose_image(nodes: Nodes) -> bpy.types.NodeSocket:
    """Add an image whose file is missing."""
    output = nodes.add("TexImage", image=bpy.data.images.new("Lost", 8, 8))
    output.node.image.source, output.node.image.filepath = "FILE", "//lost.png"
    return output


def test_a_missing_image_of_the_color_is_refused_and_nothing_is_left():
    nodes = Nodes()
    nodes.set(Base_Color=lose_image(nodes))
    kinds = bpy.data.materials, bpy.data.objects, bpy.data.meshes, bpy.data.images, bpy.data.collections
    before = [len(data) for data in kinds]
    with pytest.raises(FileError, match=r'The image "Lost" is missing or empty .*lost\.png'):
        write(nodes.item)
    assert before == [len(data) for data in kinds]


def test_other_missing_images_are_named():
    nodes = Nodes()
    output = lose_image(nodes)
    nodes.set(Roughness=output, Normal=nodes.add("NormalMap", 1.0, output))
    nodes.add_gltf_output(Occlusion=output)
    found, lacking = write(nodes.item)
    assert lacking == {"Leaf": ('the missing image "Lost"',)}
    assert found.materials[0]["pbrMetallicRoughness"]["roughnessFactor"] == 0.5


@pytest.mark.parametrize("strength", [0.0, 1.0])
def test_an_emission_colors_the_analysis_if_it_has_strength(strength):
    nodes = Nodes()
    nodes.tree.links.remove(nodes.shader.inputs["Base Color"].links[0])
    nodes.set(Emission_Color=nodes.image.outputs["Color"], Emission_Strength=strength)
    assert [image.name for image, _ in find_color_images(nodes.material)] == (["Leaf"] if strength else [])
