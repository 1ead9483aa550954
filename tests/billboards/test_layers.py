"""Light, translucency, glass, coats, sheen and highlights of the source's materials: as maps, as constants, and in exported files."""

import bpy
import numpy as np
import pytest

pytest.importorskip("bpy")

from bridge import blender_scenes, pbr_clouds
from farfield.addon.bridge.billboards.capture import capture_textures
from farfield.addon.bridge.billboards.clouds import create_cloud
from farfield.addon.bridge.billboards.exports import write_glb
from farfield.addon.bridge.billboards.source_losses import describe_source_losses
from farfield.addon.bridge.imaging.images import read_pixels
from farfield.addon.core.billboards.settings import BillboardSettings
from farfield.addon.core.jobs.progress import run_to_end
from glb_reader import read_glb

SETTINGS = BillboardSettings(samples=4)


@pytest.fixture(autouse=True)
def fresh_scene():
    blender_scenes.reset_scene()


def capture(*objects):
    """Return the source of `objects`, a simple cloud of it and the textures of its only level."""
    bpy.context.view_layer.update()
    source = blender_scenes.read_objects(*objects)
    cloud = pbr_clouds.cloud_of_directions(source.mesh, pbr_clouds.axis_directions(), 0.1)
    return source, cloud, run_to_end(capture_textures(source, cloud, SETTINGS))


def create_level(source, cloud, textures):
    """Return the object of the only level."""
    return create_cloud(cloud, textures, source, bpy.context.scene.collection).objects[0]


def principled(name, **values):
    """Return a Principled material; `values` by the names of its inputs, with underscores for spaces."""
    material = blender_scenes.create_material(name, (0.2, 0.4, 0.6))
    for key, value in values.items():
        blender_scenes.shader_of(material).inputs[key.replace("_", " ")].default_value = value
    return material


def with_shader(name, node_type, wiring="plain", **values):
    """Return a material with another shader than Principled, alone, mixed half and half with it, added to it, or in a group."""
    material = principled(name)
    tree, output = material.node_tree, material.node_tree.nodes["Material Output"].inputs["Surface"]
    shader = blender_scenes.shader_of(material).outputs[0]
    inner = tree if wiring != "grouped" else bpy.data.node_groups.new("Light", "ShaderNodeTree")
    node = inner.nodes.new(node_type)
    for key, value in values.items():
        node.inputs[key].default_value = value
    if wiring == "plain":
        tree.links.new(node.outputs[0], output)
    elif wiring == "grouped":
        inner.interface.new_socket("Out", in_out="OUTPUT", socket_type="NodeSocketShader")
        inner.links.new(node.outputs[0], inner.nodes.new("NodeGroupOutput").inputs[0])
        group = tree.nodes.new("ShaderNodeGroup")
        group.node_tree = inner
        tree.links.new(group.outputs[0], output)
    else:
        both = tree.nodes.new("ShaderNodeMixShader" if wiring == "mixed" else "ShaderNodeAddShader")
        first = 1 if wiring == "mixed" else 0
        tree.links.new(shader, both.inputs[first])
        tree.links.new(node.outputs[0], both.inputs[first + 1])
        tree.links.new(both.outputs[0], output)
    return material


def card_at(x, material, z=0.0):
    card = blender_scenes.card(f"Card {x} {z}", material)
    card.location = (x, 0.0, z)
    return card


def values_at(level, textures, layer, x, side="front"):
    """Return the value of a layer, with its scale, in the middle of the card at `x`; all cards lie on one quad."""
    maps = textures.layers[layer]
    if maps.constant is not None:
        return maps.scale * np.array(maps.constant)
    column, row, width, height = level.atlas.rectangles[0]
    u, v = level.quads.frames[0, :2] @ ([x, 0.0, 0.0] - level.quads.centers[0]) / level.quads.half_sizes[0]
    texel = int(row + (0.5 + 0.5 * v) * height), int(column + (0.5 + 0.5 * u) * width)
    return maps.scale * maps.sides.get(side, maps.sides["front"])[texel]


def test_ordinary_materials_have_six_images_and_the_group_of_former_versions():
    source, cloud, textures = capture(blender_scenes.box(material=principled("Paint", Roughness=0.3, Metallic=0.5)))
    assert not textures[0].layers
    assert not textures[0].parameters
    material = create_level(source, cloud, textures).data.materials[0]
    assert sum(node.type == "TEX_IMAGE" for node in material.node_tree.nodes) == 6
    (group,) = (node.node_tree for node in material.node_tree.nodes if node.type == "GROUP")
    assert (group["farfield_version"], "farfield_variant" in group) == (1, False)
    assert not {"EMISSION", "BSDF_TRANSLUCENT", "BSDF_TRANSPARENT"} & {node.type for node in group.nodes}


def test_strengths_of_lights_keep_their_ratio():
    bright = principled("Bright", Emission_Color=(1.0, 0.5, 0.25, 1.0), Emission_Strength=8.0)
    dim = principled("Dim", Emission_Color=(0.0, 1.0, 0.0, 1.0), Emission_Strength=0.5)
    source, cloud, (textures,) = capture(card_at(0.0, bright), card_at(3.0, dim))
    level = cloud.levels[0]
    assert textures.layers.keys() == {"emission"}
    assert textures.layers["emission"].scale == pytest.approx(8.0, rel=1e-3)
    assert values_at(level, textures, "emission", 0.0) == pytest.approx([8.0, 4.0, 2.0], rel=1e-3)
    assert values_at(level, textures, "emission", 3.0) == pytest.approx([0.0, 0.5, 0.0], abs=1e-3)
    material = create_level(source, cloud, [textures]).data.materials[0]
    group = next(node for node in material.node_tree.nodes if node.type == "GROUP")
    assert group.inputs["Emission Strength"].default_value == pytest.approx(8.0, rel=1e-3)
    # Both sides of the cards shine alike, so that one image is enough.
    images = [node.image for node in material.node_tree.nodes if node.type == "TEX_IMAGE" and "mission" in node.label]
    assert [image.name for image in images] == ["Card 0.0 0.0 Cloud L0 Front Emission"]
    assert read_pixels(images[0])[..., :3].max() == 1.0


@pytest.mark.parametrize(
    "wiring, color, emission",
    [pytest.param("plain", 0.0, 4.0, marks=pytest.mark.exhaustive), ("grouped", 0.0, 4.0), ("mixed", 0.5, 2.0), ("added", 1.0, 4.0)],
)
def test_emission_shaders_are_no_base_color(wiring, color, emission):
    material = with_shader("Light", "ShaderNodeEmission", wiring, Color=(1.0, 1.0, 1.0, 1.0), Strength=4.0)
    _, _, (textures,) = capture(blender_scenes.box(material=material))
    layer = textures.layers["emission"]
    assert not layer.sides
    assert layer.scale * np.array(layer.constant) == pytest.approx([emission] * 3, rel=1e-3)
    covered = textures.front.color[..., 3] > 0.99
    assert textures.front.color[covered][:, :3] == pytest.approx(np.tile(color * np.array([0.2, 0.4, 0.6]), (covered.sum(), 1)), abs=2e-3)


def test_translucency_of_leaves_is_no_base_color():
    material = with_shader("Leaf", "ShaderNodeBsdfTranslucent", "mixed", Color=(0.8, 0.6, 0.0, 1.0))
    source, cloud, (textures,) = capture(card_at(0.0, material))
    assert textures.layers.keys() == {"translucency"}
    assert textures.layers["translucency"].constant == pytest.approx([0.4, 0.3, 0.0], abs=2e-3)
    covered = textures.front.color[..., 3] > 0.99
    assert textures.front.color[covered][0, :3] == pytest.approx([0.1, 0.2, 0.3], abs=2e-3)
    group = next(node for node in create_level(source, cloud, [textures]).data.materials[0].node_tree.nodes if node.type == "GROUP")
    assert (group.node_tree["farfield_version"], group.node_tree["farfield_variant"]) == (2, "Translucency")


def test_leaves_on_one_quad_keep_the_light_from_each_other():
    material = with_shader("Leaf", "ShaderNodeBsdfTranslucent", Color=(0.8, 0.8, 0.8, 1.0))
    _, cloud, (textures,) = capture(card_at(0.0, material), card_at(3.0, material), card_at(3.0, material, z=0.5))
    free = values_at(cloud.levels[0], textures, "translucency", 0.0)
    assert free == pytest.approx([0.4] * 3, abs=0.03)  # Half of the quad is free, for light at an angle.
    assert values_at(cloud.levels[0], textures, "translucency", 3.0) == pytest.approx([0.0] * 3, abs=1e-3)


def test_glass_lets_through_the_color_of_its_panes():
    clear = principled("Glass", Transmission_Weight=1.0, Roughness=0.0)
    frosted = principled("Frosted", Transmission_Weight=1.0, Roughness=0.6)
    _, cloud, (textures,) = capture(card_at(0.0, clear), card_at(3.0, frosted), card_at(6.0, clear), card_at(6.0, clear, z=0.1))
    level, base = cloud.levels[0], np.array([0.2, 0.4, 0.6])
    assert textures.layers.keys() == {"transmission", "translucency"}
    assert values_at(level, textures, "transmission", 0.0) == pytest.approx(np.sqrt(base), abs=0.01)
    assert values_at(level, textures, "transmission", 3.0) == pytest.approx([0.0] * 3, abs=0.01)
    assert values_at(level, textures, "transmission", 6.0) == pytest.approx(base, abs=0.02)
    covered = textures.front.color[..., 3] > 0.99
    assert covered.any()
    assert textures.front.color[covered][:, :3] == pytest.approx(0.0, abs=2e-3)


def test_what_all_materials_have_in_common_is_a_constant():
    car = principled("Car", Coat_Weight=0.7, Coat_Roughness=0.1, IOR=1.8)
    source, cloud, textures = capture(blender_scenes.box(material=car))
    assert not textures[0].layers
    assert textures[0].parameters["Coat Weight"] == pytest.approx(0.7)
    material = create_level(source, cloud, textures).data.materials[0]
    assert sum(node.type == "TEX_IMAGE" for node in material.node_tree.nodes) == 6
    group = next(node for node in material.node_tree.nodes if node.type == "GROUP")
    assert [group.inputs[name].default_value for name in ("Coat Weight", "Coat Roughness", "IOR")] == pytest.approx([0.7, 0.1, 1.8])


def test_coats_sheen_and_highlights_that_differ_are_maps():
    car = principled("Car", Coat_Weight=0.7, Coat_Roughness=0.1)
    velvet = principled("Velvet", Sheen_Weight=0.5, Sheen_Tint=(1.0, 0.5, 0.0, 1.0), Sheen_Roughness=0.3, Specular_IOR_Level=1.0)
    _, cloud, (textures,) = capture(card_at(0.0, car), card_at(3.0, velvet))
    level = cloud.levels[0]
    assert textures.layers.keys() == {"specular", "coat", "sheen"}
    assert not textures.parameters
    assert values_at(level, textures, "coat", 0.0) == pytest.approx([0.7, 0.1, 0.5], abs=2e-3)
    assert values_at(level, textures, "coat", 3.0)[[0, 2]] == pytest.approx([0.0, 0.3], abs=2e-3)
    assert values_at(level, textures, "sheen", 3.0) == pytest.approx([0.5, 0.25, 0.0], abs=2e-3)
    assert values_at(level, textures, "specular", 0.0) == pytest.approx([0.5] * 3, abs=2e-3)
    assert values_at(level, textures, "specular", 3.0) == pytest.approx([1.0] * 3, abs=2e-3)


def test_color_and_attributes_of_objects_with_one_material():
    material = principled("Shared")
    info, attribute = (material.node_tree.nodes.new(kind) for kind in ("ShaderNodeObjectInfo", "ShaderNodeAttribute"))
    attribute.attribute_type, attribute.attribute_name = "OBJECT", "glow"
    shader = blender_scenes.shader_of(material)
    blender_scenes.link(material, info.outputs["Color"], shader.inputs["Base Color"])
    blender_scenes.link(material, info.outputs["Alpha"], shader.inputs["Metallic"])
    blender_scenes.link(material, attribute.outputs["Fac"], shader.inputs["Roughness"])
    first, second = card_at(0.0, material), card_at(3.0, material)
    second.data = first.data
    first.color, second.color = (0.9, 0.1, 0.2, 0.25), (0.1, 0.8, 0.3, 0.75)
    first["glow"], second.data["glow"] = 0.3, 0.6
    _, _, (textures,) = capture(first, second)
    covered = textures.front.color[..., 3] > 0.99
    looks = np.column_stack([textures.front.color[covered][:, :3], textures.front.roughness_metallic_depth[covered][:, :2]])
    assert np.unique(looks.round(2), axis=0) == pytest.approx(np.array([[0.1, 0.8, 0.3, 0.6, 0.75], [0.9, 0.1, 0.2, 0.3, 0.25]]), abs=6e-3)


def test_mapped_texture_coordinates():
    material = principled("Mapped")
    uv, mapping = (material.node_tree.nodes.new(kind) for kind in ("ShaderNodeUVMap", "ShaderNodeMapping"))
    mapping.inputs["Location"].default_value, mapping.inputs["Scale"].default_value = (0.1, 0.2, 0.3), (0.5, 0.25, 1.0)
    blender_scenes.link(material, uv.outputs[0], mapping.inputs["Vector"])
    blender_scenes.link(material, mapping.outputs[0], blender_scenes.shader_of(material).inputs["Base Color"])
    _, _, (textures,) = capture(card_at(0.0, material))
    covered = textures.front.color[..., 3] > 0.99
    colors = textures.front.color[covered][:, :3]
    assert colors.min(axis=0) == pytest.approx([0.1, 0.2, 0.3], abs=0.02)
    assert colors.max(axis=0) == pytest.approx([0.6, 0.45, 0.3], abs=0.02)


def test_losses_are_named_per_material():
    glass, smoke = principled("Glass", Transmission_Weight=1.0, Roughness=0.0), principled("Smoke", Anisotropic=0.5)
    volume = smoke.node_tree.nodes.new("ShaderNodeVolumePrincipled")
    blender_scenes.link(smoke, volume.outputs[0], smoke.node_tree.nodes["Material Output"].inputs["Volume"])
    for name in ("Glass", "Smoke"):
        shader = blender_scenes.shader_of(bpy.data.materials[name])
        shader.inputs["Coat Weight"].default_value, shader.inputs["Coat Tint"].default_value = 1.0, (1.0, 0.5, 0.5, 1.0)
    box, pane = blender_scenes.box("Box", principled("Plain")), card_at(0.0, glass)
    objects = [blender_scenes.ball("Light", glass), blender_scenes.box("Fire", smoke), box, pane]
    bpy.context.view_layer.update()
    assert describe_source_losses(blender_scenes.read_objects(*objects)) == [
        '"Glass" of "Light": its coat tint and refraction are left out.',
        '"Smoke" of "Fire": its volume, anisotropy and coat tint are left out.',
    ]
    assert describe_source_losses(blender_scenes.read_objects(pane)) == []  # Panes do not refract.


def test_glb_has_light_and_glass(tmp_path):
    light = principled("Light", Emission_Color=(1.0, 0.5, 0.25, 1.0), Emission_Strength=5.0)
    glass = principled("Glass", Transmission_Weight=1.0, Roughness=0.0)
    level = create_level(*capture(card_at(0.0, light), card_at(3.0, glass)))
    before = blender_scenes.count_data()
    write_glb([level], tmp_path / "light.glb")
    assert blender_scenes.count_data() == before
    (material,) = read_glb(tmp_path / "light.glb").document["materials"]
    assert material["extensions"]["KHR_materials_emissive_strength"]["emissiveStrength"] == pytest.approx(5.0, rel=1e-3)
    assert "emissiveTexture" in material
    assert "transmissionTexture" in material["extensions"]["KHR_materials_transmission"]
