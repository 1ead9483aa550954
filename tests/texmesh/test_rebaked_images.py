"""Levels with rebaked textures in a scene: images, materials, what keeps its image, and what is removed and exported."""

import bpy
import numpy as np
import pytest

from farfield.addon.bridge.imaging.images import read_pixels
from farfield.addon.bridge.texmesh.color_images import find_color_image
from farfield.addon.bridge.texmesh.level_sets import level_sets_in
from farfield.addon.bridge.texmesh.rebaked_images import create_rebaked_image
from textured_scenes import checker_image, textured_ball, textured_material

pytestmark = pytest.mark.usefixtures("empty_scene")
SMALL = {"levels": "ratios", "ratios": "0.1", "views": 1, "max_image": 64, "vertices": "optimized", "rebake_textures": True}
SIDE = 256


@pytest.fixture
def ball() -> bpy.types.Object:
    """A smooth sphere with a UV map and a checkered image of SIDE pixels."""
    item = textured_ball(8, "Ball")
    item.data.materials[0] = textured_material(checker_image("Squares", SIDE))
    return item


def make(**values) -> list[bpy.types.Object]:
    assert bpy.ops.farfield.texmesh_levels(**{**SMALL, **values}) == {"FINISHED"}
    (levels,) = level_sets_in(bpy.context.scene)
    return levels.levels


def images_of(levels) -> list[bpy.types.Image]:
    return [find_color_image(level.data.materials[0])[0] for level in levels]


def count_data() -> dict[str, int]:
    return {kind: len(getattr(bpy.data, kind)) for kind in ("objects", "meshes", "materials", "images", "collections", "node_groups")}


def test_levels_have_smaller_images_of_their_own(ball, capsys):
    levels = make(ratios="0.5,0.1")
    original, *images = images_of(levels)
    assert original.name == "Squares" and find_color_image(ball.data.materials[0])[0] == original
    assert [image.name for image in images] == ["Ball L1", "Ball L2"]
    sizes = [max(image.size) for image in images]
    assert sizes == sorted(sizes, reverse=True) and sizes[-1] < SIDE and all(SIDE % size == 0 for size in sizes)
    assert all(image.packed_files and image.colorspace_settings.name == "sRGB" for image in images)
    name = ball.data.materials[0].name
    assert [level.data.materials[0].name for level in levels[1:]] == [f"{name} L1", f"{name} L2"]
    assert 'Textures of the levels of "Ball" have' in capsys.readouterr().out


def test_without_the_setting_levels_have_the_same_image(ball):
    for values in ({"rebake_textures": False}, {"vertices": "original"}):
        assert len(set(images_of(make(**values)))) == 1


def test_images_and_materials_are_removed_with_the_levels(ball):
    before = count_data()
    make(cross_fade=False, ratios="0.2,0.1")
    assert count_data()["images"] == before["images"] + 2
    make(cross_fade=False)
    assert count_data()["images"] == before["images"] + 1
    assert bpy.ops.farfield.texmesh_remove() == {"FINISHED"}
    assert count_data() == before and find_color_image(ball.data.materials[0])[0].name == "Squares"


def test_linked_materials_and_images_stay(ball, tmp_path):
    path = str(tmp_path / "library.blend")
    material = ball.data.materials[0]
    bpy.data.libraries.write(path, {material})
    ball.data.materials.clear()
    with bpy.data.libraries.load(path, link=True) as (_, loaded):
        loaded.materials = [material.name]
    ball.data.materials.append(loaded.materials[0])
    levels = make()
    assert find_color_image(ball.data.materials[0])[0].library is not None
    for level in levels[1:]:
        image = find_color_image(level.data.materials[0])[0]
        assert image.library is None and level.data.materials[0].library is None and image.packed_files
    assert bpy.ops.farfield.texmesh_remove() == {"FINISHED"}
    assert not any(image.name.startswith("Ball L") for image in bpy.data.images)


def test_undo_takes_images_back(ball):
    bpy.context.preferences.edit.use_global_undo = True
    bpy.ops.ed.undo_push(message="before")
    before = count_data()["images"]
    make()
    bpy.ops.ed.undo_push(message="levels")
    bpy.ops.ed.undo()
    assert count_data()["images"] == before and not level_sets_in(bpy.context.scene)


def test_materials_with_the_same_image_have_the_same_rebaked_one(ball):
    ball.data.materials.append(textured_material(ball.data.materials[0].node_tree.nodes["Image Texture"].image, "Second"))
    for polygon in ball.data.polygons:
        polygon.material_index = int(polygon.center.z > 0.0)
    levels = make()
    for level in levels[1:]:
        first, second = (find_color_image(material)[0] for material in level.data.materials)
        assert first == second and first.name.startswith("Ball L")


@pytest.mark.parametrize("kind", ["repeated", "mapping", "group"])
def test_images_that_cannot_be_rebaked_stay(ball, kind, capsys):
    material = ball.data.materials[0]
    if kind == "repeated":
        for loop in ball.data.uv_layers.active.data:
            loop.uv = (4.0 * loop.uv[0], loop.uv[1])
    elif kind == "mapping":
        tree = material.node_tree
        mapping, coordinates = tree.nodes.new("ShaderNodeMapping"), tree.nodes.new("ShaderNodeUVMap")
        mapping.inputs["Scale"].default_value = (2.0, 2.0, 2.0)
        tree.links.new(coordinates.outputs["UV"], mapping.inputs["Vector"])
        tree.links.new(mapping.outputs["Vector"], tree.nodes["Image Texture"].inputs["Vector"])
    else:
        group = bpy.data.node_groups.new("Inner", "ShaderNodeTree")
        group.interface.new_socket("Color", in_out="OUTPUT", socket_type="NodeSocketColor")
        inner = group.nodes.new("ShaderNodeTexImage")
        inner.image = material.node_tree.nodes["Image Texture"].image
        group.links.new(inner.outputs["Color"], group.nodes.new("NodeGroupOutput").inputs[0])
        node = material.node_tree.nodes.new("ShaderNodeGroup")
        node.node_tree = group
        material.node_tree.links.new(node.outputs[0], material.node_tree.nodes["Principled BSDF"].inputs["Base Color"])
        material.node_tree.nodes.remove(material.node_tree.nodes["Image Texture"])
    assert len(set(images_of(make()))) == 1
    expected = {"repeated": "uses parts of it more than once", "mapping": "more than a UV map", "group": "within a node group"}
    assert f'Levels keep the image "Squares": {"" if kind != "repeated" else "the UV map of "}' in (out := capsys.readouterr().out)
    assert expected[kind] in out


@pytest.mark.parametrize("is_float", [False, True])
@pytest.mark.parametrize("alpha_mode", ["STRAIGHT", "CHANNEL_PACKED"])
def test_a_rebaked_image_reads_back(is_float, alpha_mode):
    source = bpy.data.images.new("Source", 8, 8, alpha=True, float_buffer=is_float)
    source.alpha_mode = alpha_mode
    pixels = np.random.default_rng(1).random((4, 8, 4)).astype(np.float32)
    if alpha_mode == "STRAIGHT":
        pixels[..., :3] *= pixels[..., 3:]
    image = create_rebaked_image("Rebaked", pixels, source)
    assert tuple(image.size) == (8, 4) and image.is_float == is_float
    stored = read_pixels(image)
    np.testing.assert_allclose(stored[..., 3], pixels[..., 3], atol=3e-3)
    if is_float:
        np.testing.assert_allclose(stored, pixels, atol=1e-3)
