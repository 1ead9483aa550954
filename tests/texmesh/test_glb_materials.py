"""Materials in .glb files are those that Blender's own exporter writes, and come back from its importer."""

from contextlib import nullcontext

import bpy
import numpy as np
import pytest

from farfield.addon.bridge.gltf_export import enabled_gltf
from farfield.addon.bridge.texmesh import glb_levels
from farfield.addon.bridge.texmesh.level_sets import level_sets_in
from farfield.addon.core.errors import FileError, SettingsError
from farfield.addon.core.texmesh.settings import ExportSettings
from glb_scenes import Nodes, check_equal, encode, square, write, write_with_blender
from textured_scenes import textured_ball

pytestmark = pytest.mark.usefixtures("empty_scene")


def base_color(nodes: Nodes) -> None:
    nodes.set(Base_Color=nodes.multiply(nodes.image.outputs["Color"], (0.2, 0.6, 1.0, 1.0)))


def factors(nodes: Nodes) -> None:
    nodes.tree.links.remove(nodes.shader.inputs["Base Color"].links[0])
    nodes.set(Base_Color=(0.2, 0.4, 0.6, 1.0), Metallic=0.25, Roughness=0.75)


def metal_and_roughness(nodes: Nodes) -> None:
    channels = nodes.add("SeparateColor", nodes.add_image("ORM")).node.outputs
    nodes.set(Metallic=nodes.add("Math", channels["Blue"], 0.5, operation="MULTIPLY"), Roughness=channels["Green"])


def separate_metal_and_roughness(nodes: Nodes) -> None:
    nodes.set(Metallic=nodes.add_image("M"), Roughness=nodes.add_image("Rough"))


def normal(nodes: Nodes) -> None:
    nodes.set(Normal=nodes.add("NormalMap", 0.5, nodes.add_image("Normal")))


def occlusion(nodes: Nodes) -> None:
    channels = nodes.add("SeparateColor", nodes.add_image("ORM")).node.outputs
    nodes.set(Metallic=channels["Blue"], Roughness=channels["Green"])
    nodes.add_gltf_output(Occlusion=channels["Red"])


def emission(nodes: Nodes) -> None:
    nodes.set(Emission_Color=nodes.multiply(nodes.image.outputs["Color"], (1.0, 0.5, 0.25, 1.0)), Emission_Strength=4.0)


def emission_factor(nodes: Nodes) -> None:
    nodes.set(Emission_Color=(1.0, 0.5, 0.25, 1.0), Emission_Strength=0.5)


def emission_shader(nodes: Nodes) -> None:
    nodes.show(nodes.add("Emission", nodes.image.outputs["Color"], 3.0))


def unlit(nodes: Nodes) -> None:
    light = nodes.add("Emission", nodes.multiply(nodes.image.outputs["Color"], (1.0, 0.5, 0.25, 1.0)))
    ray = nodes.add("LightPath").node.outputs["Is Camera Ray"]
    light = nodes.add("MixShader", ray, nodes.add("BsdfTransparent"), light)
    nodes.show(nodes.add("MixShader", nodes.image.outputs["Alpha"], nodes.add("BsdfTransparent"), light))


def mask(nodes: Nodes) -> None:
    less = nodes.add("Math", nodes.image.outputs["Alpha"], 0.75, operation="LESS_THAN")
    nodes.set(Alpha=nodes.add("Math", 1.0, less, operation="SUBTRACT"))


def mask_by_rounding(nodes: Nodes) -> None:
    nodes.set(Alpha=nodes.add("Math", nodes.image.outputs["Alpha"], operation="ROUND"))


def blend(nodes: Nodes) -> None:
    nodes.set(Alpha=nodes.add("Math", 0.5, nodes.image.outputs["Alpha"], operation="MULTIPLY"))


def blend_by_another_image(nodes: Nodes) -> None:
    nodes.set(Alpha=nodes.add("SeparateColor", nodes.add_image("Mask", size=16)).node.outputs["Green"])


def transmission(nodes: Nodes) -> None:
    nodes.set(Transmission_Weight=0.75, IOR=1.33, Roughness=0.1)


def transmission_image(nodes: Nodes) -> None:
    nodes.set(Transmission_Weight=nodes.add("SeparateColor", nodes.add_image("T")).node.outputs["Red"])


def volume(nodes: Nodes) -> None:
    nodes.set(Transmission_Weight=1.0)
    absorption = nodes.add("VolumeAbsorption", (0.5, 0.75, 1.0, 1.0), 2.0)
    nodes.tree.links.new(absorption, nodes.output.inputs["Volume"])
    nodes.add_gltf_output(Thickness=0.25)


def clear_coat(nodes: Nodes) -> None:
    channels = nodes.add("SeparateColor", nodes.add_image("Coat")).node.outputs
    nodes.set(Coat_Weight=channels["Red"], Coat_Roughness=channels["Green"])
    nodes.set(Coat_Normal=nodes.add("NormalMap", 1.0, nodes.add_image("Coat Normal")))


def clear_coat_factors(nodes: Nodes) -> None:
    nodes.set(Coat_Weight=0.5, Coat_Roughness=0.25)


def sheen(nodes: Nodes) -> None:
    color = nodes.multiply(nodes.image.outputs["Color"], (1.0, 0.5, 0.25, 1.0))
    nodes.set(Sheen_Weight=1.0, Sheen_Tint=color, Sheen_Roughness=0.25)


def specular(nodes: Nodes) -> None:
    nodes.set(Specular_IOR_Level=0.25, Specular_Tint=(1.0, 0.5, 0.25, 1.0), IOR=1.33)


def specular_images(nodes: Nodes) -> None:
    nodes.set(Specular_IOR_Level=nodes.add_image("S", "Alpha"), Specular_Tint=nodes.image.outputs["Color"])


def anisotropy(nodes: Nodes) -> None:
    nodes.set(Anisotropic=0.5, Anisotropic_Rotation=0.25)


def culling(nodes: Nodes) -> None:
    nodes.material.use_backface_culling = True


def vertex_colors(nodes: Nodes) -> None:
    shown = nodes.add("VertexColor", layer_name="Shown")
    nodes.set(Base_Color=nodes.multiply((0.2, 0.6, 1.0, 1.0), nodes.multiply(shown, nodes.image.outputs["Color"])))


def vertex_opacity(nodes: Nodes) -> None:
    shown = nodes.add("VertexColor", layer_name="Shown").node.outputs
    nodes.set(Base_Color=shown["Color"], Alpha=shown["Alpha"])


def second_uv_map(nodes: Nodes) -> None:
    rough = nodes.add_image("Rough")
    nodes.tree.links.new(nodes.add("UVMap", uv_map="Second"), rough.node.inputs["Vector"])
    nodes.set(Roughness=rough)


def placement(nodes: Nodes) -> None:
    mapping = nodes.add("Mapping", nodes.add("UVMap", uv_map="Second")).node
    for name, value in (("Location", (0.25, -0.5, 0.0)), ("Rotation", (0.0, 0.0, 0.5)), ("Scale", (4.0, -2.0, 1.0))):
        mapping.inputs[name].default_value = value
    nodes.place(mapping.outputs[0])


def placement_of_a_texture(nodes: Nodes) -> None:
    mapping = nodes.add("Mapping", nodes.add("UVMap"), vector_type="TEXTURE").node
    for name, value in (("Location", (0.25, -0.5, 0.0)), ("Rotation", (0.0, 0.0, 0.5)), ("Scale", (2.0, 2.0, 1.0))):
        mapping.inputs[name].default_value = value
    nodes.place(mapping.outputs[0])


def wrapping(nodes: Nodes) -> None:
    nodes.image.extension, nodes.image.interpolation = "EXTEND", "Closest"


def different_wrapping(nodes: Nodes) -> None:
    nodes.image.extension = "EXTEND"
    parts = nodes.add("SeparateXYZ", nodes.add("UVMap")).node.outputs
    nodes.place(nodes.add("CombineXYZ", nodes.add("Math", parts[0], 1.0, operation="PINGPONG"), parts[1]))


PROPERTIES = (
    base_color,
    factors,
    metal_and_roughness,
    separate_metal_and_roughness,
    normal,
    occlusion,
    emission,
    emission_factor,
    emission_shader,
    unlit,
    mask,
    mask_by_rounding,
    blend,
    blend_by_another_image,
    transmission,
    transmission_image,
    volume,
    clear_coat,
    clear_coat_factors,
    sheen,
    specular,
    specular_images,
    anisotropy,
    culling,
    vertex_colors,
    vertex_opacity,
    second_uv_map,
    placement,
    placement_of_a_texture,
    wrapping,
    different_wrapping,
)


@pytest.mark.slow
@pytest.mark.parametrize("change", PROPERTIES)
def test_materials_are_those_of_blenders_exporter(change):
    nodes = Nodes()
    change(nodes)
    found, lacking = write(nodes.item)
    expected = write_with_blender(nodes.item)
    assert lacking == {} and len(found.materials) == len(expected.materials) == 1
    check_equal(found.materials[0], expected.materials[0])
    (part,), (other,) = found.meshes[0].primitives, expected.meshes[0].primitives
    assert set(part.attributes) == set(other.attributes)
    for name, values in other.attributes.items():
        order, other_order = (np.lexsort(item.attributes["TEXCOORD_0"].T) for item in (part, other))
        np.testing.assert_allclose(part.attributes[name][order], values[other_order], atol=1e-4, err_msg=name)


@pytest.mark.parametrize("change", PROPERTIES)
def test_blenders_importer_brings_them_back(change, tmp_path):
    nodes = Nodes()
    change(nodes)
    expected = write_with_blender(nodes.item)
    (tmp_path / "a.glb").write_bytes(encode(nodes.item, is_quantized=True)[0])
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    with enabled_gltf():
        bpy.ops.import_scene.gltf(filepath=str(tmp_path / "a.glb"))
    check_equal(write_with_blender(*bpy.context.scene.objects).materials[0], expected.materials[0])


def test_the_same_scene_gives_the_same_bytes():
    nodes = Nodes()
    metal_and_roughness(nodes)
    assert encode(nodes.item)[0] == encode(nodes.item)[0]


def test_several_objects_and_materials_have_files_of_their_own_materials():
    first, second = Nodes("First"), Nodes("Second")
    blend(second)
    metal_and_roughness(first)
    both = square("Both", first.material, second.material)
    found, _ = write(first.item, both, second.item)
    expected = write_with_blender(first.item, both, second.item)
    assert [node.name for node in found.nodes] == ["First", "Both", "Second"]
    assert [len(mesh.primitives) for mesh in found.meshes] == [1, 2, 1]
    for name in ("First", "Second"):
        materials = [next(item for item in file.materials if item["name"] == name) for file in (found, expected)]
        check_equal(*materials)


def test_an_add_on_that_is_disabled_and_an_object_in_edit_mode_stay_so():
    import addon_utils

    expected = write(Nodes().item)[0].materials
    item = Nodes().item
    bpy.ops.mesh.primitive_cube_add()
    bpy.ops.object.mode_set(mode="EDIT")
    with enabled_gltf():
        addon_utils.disable("io_scene_gltf2")
        check_equal(write(item)[0].materials[0], {**expected[0], "name": "Leaf.001"})
        assert not addon_utils.check("io_scene_gltf2")[1] and bpy.context.object.mode == "EDIT"
        addon_utils.enable("io_scene_gltf2")


def test_an_error_of_the_exporter_is_one_sentence(monkeypatch, tmp_path):
    (tmp_path / "levels.glb").mkdir()
    monkeypatch.setattr(glb_levels, "temporary_folder", lambda: nullcontext(tmp_path))
    with pytest.raises(FileError, match=r"^Blender's glTF exporter failed: \[Errno \d+\] [^\n]*levels\.glb'\.$"):
        write(Nodes().item)


def test_without_pillow_images_keep_their_sizes_and_other_settings_are_refused(monkeypatch, tmp_path):
    monkeypatch.setattr(glb_levels, "find_spec", lambda _: None)
    ball = textured_ball(6, "Ball")
    ball.select_set(True)
    bpy.context.view_layer.objects.active = ball
    bpy.ops.farfield.texmesh_levels(levels="ratios", ratios="0.5", views=1, max_image=32, vertices="original")
    sets = level_sets_in(bpy.context.scene)
    paths, sentences = glb_levels.write_levels(sets, tmp_path / "ball.glb")
    assert len(paths) == 2 and sentences[0] == "Images of levels keep their sizes, since this Python lacks the module Pillow."
    for name in ("webp", "compressed"):
        with pytest.raises(
            SettingsError, match=r"needs the module \w+, which this Python lacks; turn it off, or install Farfield's zip\.$"
        ):
            glb_levels.write_levels(sets, tmp_path / "other.glb", ExportSettings(**{name: True}))
    assert not (tmp_path / "other-L0.glb").exists()
