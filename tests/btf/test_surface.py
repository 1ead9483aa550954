"""The model *surface*: a cloud that is lit by all lights as its source is, with the silhouettes of its source."""

import numpy as np
import pytest

pytest.importorskip("bpy")

import bpy

from bridge import blender_scenes
from bridge.bakes import bake_in_this_process, open_cloud
from farfield.addon.bridge.billboards.cloud_materials import MAPS, SIDES, map_label
from farfield.addon.bridge.billboards.level_objects import PBR_MATERIAL, pbr_image
from farfield.addon.bridge.billboards.scene_clouds import SceneCloud, clouds_in
from farfield.addon.bridge.btf.levels.decode import is_upper_hemisphere, read_relightable_texture
from farfield.addon.bridge.btf.levels.surface_levels import check_maps
from farfield.addon.bridge.btf.materials.emission_material import sun_color_property
from farfield.addon.bridge.shading.node_builder import nodes_in
from farfield.addon.bridge.shading.shared_parameters import read_shared_parameters
from farfield.addon.core.errors import FileError, GeometryError
from farfield.addon.core.imaging import metrics
from farfield.addon.core.jobs.progress import run_to_end
from lib import scene_files
from lib.relighting import Candidate, compare_relighting, copy_with_pbr_material
from lib.studio import open_studio
from lib.studio_lights import LIGHT_KINDS, StudioLight

BAKE = {"views_per_side": 3, "samples": 2, "alpha_components": 8, "executor": "serial"}
QUICK_BAKE = {**BAKE, "views_per_side": 2, "samples": 1, "alpha_components": 2}


@pytest.fixture(autouse=True)
def fresh_scene(extension):
    blender_scenes.reset_scene()


def build_cloud(item: bpy.types.Object, **settings) -> SceneCloud:
    bpy.ops.object.select_all(action="DESELECT")
    bpy.context.view_layer.objects.active = item
    item.select_set(True)
    bpy.ops.farfield.billboards_build(**{"error": 4.0, "levels": 1, "samples": 2, "keep_original_visible": True, **settings})
    cloud = clouds_in(bpy.context.scene)[-1]
    bpy.context.view_layer.objects.active = cloud.levels[0]
    return cloud


@pytest.fixture(scope="module")
def baked_file(extension, tmp_path_factory):
    """A file with a ball and its baked cloud."""
    blender_scenes.reset_scene()
    material = blender_scenes.create_material("Red", (0.8, 0.2, 0.1), 0.6)
    blender_scenes.shader_of(material).inputs["Coat Roughness"].default_value = 0.4  # It is copied, and not seen without a coat.
    bake_in_this_process(build_cloud(blender_scenes.ball(material=material, segments=48), solid_parts="quads", samples=4), **BAKE)
    path = tmp_path_factory.mktemp("surface") / "baked.blend"
    scene_files.save_scene(path)
    return path


@pytest.fixture
def cloud(baked_file) -> SceneCloud:
    return open_cloud(baked_file)


@pytest.mark.slow
@pytest.mark.parametrize(
    "kind", ["sun", "area", *(pytest.param(kind, marks=pytest.mark.exhaustive) for kind in LIGHT_KINDS if kind not in ("sun", "area"))]
)
def test_every_light_reaches_the_cloud_and_it_is_nearer_to_the_source_than_its_pbr_maps(cloud, kind):
    plain = Candidate("PBR", [copy_with_pbr_material(cloud.levels[0])])
    directions = np.array([[[0.3, -0.9, 0.2], [-0.8, 0.3, 0.5]], [[0.7, -0.5, 0.5], [-0.2, -0.6, 0.7]]])
    directions /= np.linalg.norm(directions, axis=2, keepdims=True)
    pairs = tuple(directions)
    comparison = run_to_end(compare_relighting(cloud.sources, cloud.levels[0], [plain], cloud.errors[0], pairs, 32, light=kind))
    source, relightable, _ = comparison.renders[..., :3].sum(axis=(1, 2, 3, 4))
    assert relightable == pytest.approx(source, rel=0.08)
    psnr, plain_psnr = comparison.compute_scores()[..., 0]
    assert (psnr > plain_psnr + 0.5).all() and psnr.min() > 28.0


@pytest.mark.slow
def test_the_mesh_of_a_solid_part_is_relit_and_keeps_its_silhouette(extension):
    cloud = build_cloud(blender_scenes.ball(material=blender_scenes.create_material("Red", (0.8, 0.2, 0.1), 0.6)))
    level = cloud.levels[0]
    assert "farfield_quad" in level.data.attributes
    cloud = bake_in_this_process(cloud, **BAKE)
    level = cloud.levels[0]
    plain = Candidate("PBR", [copy_with_pbr_material(level)])
    directions = np.array([[[0.3, -0.9, 0.2], [-0.8, 0.3, 0.5]], [[0.7, -0.5, 0.5], [-0.2, -0.6, 0.7]]])
    directions /= np.linalg.norm(directions, axis=2, keepdims=True)
    comparison = run_to_end(compare_relighting(cloud.sources, level, [plain], cloud.errors[0], tuple(directions), 32, light="sun"))
    source, relightable, _ = comparison.renders[..., :3].sum(axis=(1, 2, 3, 4))
    assert relightable == pytest.approx(source, rel=0.07)
    assert comparison.compute_scores()[..., 0].min() > 34.0


@pytest.mark.slow
def test_the_silhouette_of_every_baked_view_is_that_of_the_source(cloud):
    directions = np.array([[0.1, -0.2, 0.97], [0.9, 0.3, -0.3], [-0.5, -0.6, -0.6]])
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    comparison = run_to_end(compare_relighting(cloud.sources, cloud.levels[0], [], cloud.errors[0], (directions, directions), 16))
    for source, baked in zip(*comparison.renders, strict=True):
        assert metrics.alpha_iou(source[..., 3], baked[..., 3]) > 0.93


@pytest.mark.slow
def test_the_cloud_casts_the_shadow_of_the_source(cloud):
    ground = blender_scenes.card("Ground")
    ground.scale, ground.location = (6.0, 6.0, 1.0), (0.0, 0.0, -3.0)
    level = cloud.levels[0]
    for kind in ("sun", "area"):
        with open_studio([*cloud.sources, level, ground], 24) as studio:
            light = StudioLight(studio.work, studio, kind)
            light.aim(np.array([0.3, -0.2, 0.93]), np.zeros(3), 1.0)
            view = np.array([0.0, -0.05, 1.0]) / np.hypot(1.0, 0.05)
            renders = []
            for visible in (cloud.sources, [level]):
                renders.append(studio.render([*visible, ground], view, np.zeros(3), 0.1, 64)[..., 1])
        shadows = [(render < 0.6 * np.median(render)) for render in renders]
        assert shadows[0].sum() > 100
        assert (shadows[0] & shadows[1]).sum() > 0.85 * (shadows[0] | shadows[1]).sum()


@pytest.mark.slow
def test_no_light_leaks_through_a_solid():
    """The sides of a box that face away from the only light are black, from near too."""
    box = blender_scenes.box(material=blender_scenes.create_material("White", (0.9, 0.9, 0.9), 1.0))
    bevel = box.modifiers.new("Bevel", "BEVEL")
    bevel.width, bevel.segments = 0.4, 3
    cloud = bake_in_this_process(build_cloud(box), **QUICK_BAKE)
    with open_studio([*cloud.sources, cloud.levels[0]], 16) as studio:
        studio.work.scene.world.node_tree.nodes["Background"].inputs["Strength"].default_value = 0.0
        for sun, view in (((0.0, 0.0, 1.0), (0.4, 0.5, -0.75)), ((0.6, 0.5, 0.6), (-0.6, -0.5, -0.6))):
            studio.set_sun_direction(np.array(sun) / np.linalg.norm(sun))
            unit = np.array(view) / np.linalg.norm(view)
            source, baked = (studio.render(items, unit, np.zeros(3), cloud.errors[0] / 2.0, 66) for items in (cloud.sources, cloud.levels))
            is_dark = source[..., :3].max(axis=2) < 1e-3
            is_inside = (source[..., 3] > 0.99) & is_dark
            assert is_inside.sum() > 300
            assert not (baked[is_inside][:, :3] > 0.1).any()


@pytest.mark.slow
def test_emission_needs_no_light():
    material = blender_scenes.create_material("Glow", (0.2, 0.2, 0.2), 1.0)
    shader = blender_scenes.shader_of(material)
    shader.inputs["Emission Color"].default_value, shader.inputs["Emission Strength"].default_value = (0.2, 0.4, 1.0, 1.0), 0.5
    cloud = bake_in_this_process(build_cloud(blender_scenes.ball(material=material), error=8.0), **QUICK_BAKE)
    with open_studio([*cloud.sources, cloud.levels[0]], 4) as studio:
        studio.work.scene.world.node_tree.nodes["Background"].inputs["Strength"].default_value = 0.0
        studio.sun.hide_render = True
        source, baked = (studio.render(items, np.array([0.0, -1.0, 0.0]), np.zeros(3), 0.1, 32) for items in (cloud.sources, cloud.levels))
    inside = source[..., 3] > 0.99
    np.testing.assert_allclose(baked[inside][:, :3].mean(axis=0), source[inside][:, :3].mean(axis=0), rtol=0.1)


@pytest.mark.slow
def test_the_scene_keeps_nothing_else_and_the_pbr_material_returns(cloud):
    level = cloud.levels[0]
    assert level.animation_data is None or not level.animation_data.drivers
    assert sun_color_property(0) not in level
    assert len(bpy.data.scenes) == 1 and not bpy.data.lights
    pbr_name = level[PBR_MATERIAL]
    assert bpy.ops.farfield.btf_restore_pbr() == {"FINISHED"}
    assert level.data.materials[0].name == pbr_name and PBR_MATERIAL not in level


@pytest.mark.slow
def test_solids_need_no_backs(cloud):
    labels = {node.label for node in nodes_in(cloud.levels[0].data.materials[0].node_tree) if node.type == "TEX_IMAGE"}
    assert labels == {
        "Front color",
        "Front normal",
        "Front roughness metallic depth",
        "Alpha Weights 0",
        "Alpha Weights 1",
        "Alpha Weights 2",
    } | {"Alpha Basis"}


@pytest.mark.slow
def test_linking_suns_is_not_needed(cloud):
    with pytest.raises(RuntimeError, match=r"lit by all lights|poll\(\) failed"):
        bpy.ops.farfield.btf_link_suns()


@pytest.mark.slow
def test_only_baked_lighting_can_be_exported_as_radiance(cloud, tmp_path):
    with pytest.raises(GeometryError, match="bake it with the model Emission"):
        read_relightable_texture(cloud.levels[0])
    with pytest.raises(RuntimeError, match="bake it with the model Emission"):
        bpy.ops.farfield.btf_export(filepath=str(tmp_path / "cloud.btf"))
    assert not list(tmp_path.iterdir())
    assert bpy.ops.farfield.btf_export(filepath=str(tmp_path / "cloud.glb")) == {"FINISHED"}
    assert not is_upper_hemisphere(cloud.levels[0])


@pytest.mark.slow
def test_a_cloud_without_textures_needs_the_model_emission():
    build_cloud(blender_scenes.box(), textures=False)
    with pytest.raises(RuntimeError, match="has no textures, which the model Surface needs"):
        bpy.ops.farfield.btf_bake(**QUICK_BAKE)


@pytest.mark.slow
def test_a_map_without_pixels_is_named(tmp_path):
    built = build_cloud(blender_scenes.box(), error=20.0, samples=1)
    image = pbr_image(built.levels[0], map_label(SIDES[0], MAPS[0]))
    if image.packed_file:
        image.unpack(method="REMOVE")
    image.source, image.filepath = "FILE", str(tmp_path / "gone.png")
    image.reload()
    with pytest.raises(FileError, match=f'"{image.name}" is missing or empty'):
        check_maps(built.levels[0])


@pytest.mark.slow
def test_a_packed_map_that_is_damaged_is_named():
    built = build_cloud(blender_scenes.box(), error=20.0, samples=1)
    image = pbr_image(built.levels[0], map_label(SIDES[1], MAPS[0]))
    blender_scenes.damage_packed_image(image)
    with pytest.raises(FileError, match=f'The packed image "{image.name}" is damaged and cannot be read; replace it'):
        check_maps(built.levels[0])


@pytest.mark.slow
def test_common_shader_parameters_are_copied(cloud):
    (shader,) = {node for node in nodes_in(cloud.levels[0].data.materials[0].node_tree) if node.type == "BSDF_PRINCIPLED"}
    assert shader.inputs["Coat Roughness"].default_value == pytest.approx(0.4)


@pytest.mark.slow
def test_common_shader_parameters_are_those_of_all_materials():
    materials = [blender_scenes.create_material(name) for name in ("First", "Second")]
    for material in materials:
        blender_scenes.shader_of(material).inputs["Coat Weight"].default_value = 0.75
    blender_scenes.shader_of(materials[0]).inputs["Coat Roughness"].default_value = 0.4
    shared = read_shared_parameters(materials)
    assert shared["Coat Weight"] == 0.75 and "Coat Roughness" not in shared
    linked = blender_scenes.create_material("Linked")
    node = linked.node_tree.nodes.new("ShaderNodeValue")
    blender_scenes.link(linked, node.outputs[0], blender_scenes.shader_of(linked).inputs["Coat Weight"])
    assert "Coat Weight" not in read_shared_parameters([*materials, linked])
    other = blender_scenes.create_material("Other")
    other.node_tree.nodes.remove(blender_scenes.shader_of(other))
    assert read_shared_parameters([*materials, other]) == {} == read_shared_parameters([])
