"""Solid views show the color of a cloud, never a lookup table, whatever was baked."""

import bpy
import pytest

from bridge import blender_scenes
from bridge.bakes import SMALL, bake_in_this_process, build_cloud, build_small_cloud
from bridge.solid_views import shown_image
from farfield.addon.bridge.billboards.cloud_materials import FRONT_COLOR
from farfield.addon.bridge.billboards.level_objects import PBR_MATERIAL, pbr_image

pytestmark = pytest.mark.usefixtures("extension")


def shown_images(cloud) -> list[bpy.types.Image | None]:
    return [shown_image(level.data.materials[0]) for level in cloud.levels]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("model", "crossfade"),
    [
        ("surface", True),
        pytest.param("emission", False, marks=pytest.mark.exhaustive),
        pytest.param("surface", False, marks=pytest.mark.exhaustive),
        pytest.param("emission", True, marks=pytest.mark.exhaustive),
    ],
)
def test_the_color_shows_before_and_after_a_bake_and_once_it_is_removed(model, crossfade):
    cloud = build_small_cloud()
    if crossfade:
        bpy.ops.object.camera_add(location=(0.0, -50.0, 0.0))
        bpy.context.scene.camera = bpy.context.object
        bpy.context.view_layer.objects.active = cloud.levels[0]
        assert bpy.ops.farfield.billboards_crossfade() == {"FINISHED"}
    colors = [pbr_image(level, FRONT_COLOR) for level in cloud.levels]
    assert all(color.colorspace_settings.name == "sRGB" for color in colors) and len(set(colors)) == len(cloud.levels) == 2
    assert shown_images(cloud) == colors
    cloud = bake_in_this_process(cloud, **SMALL | {"model": model})
    colors = [pbr_image(level, FRONT_COLOR) for level in cloud.levels]
    assert all(PBR_MATERIAL in level for level in cloud.levels) and shown_images(cloud) == colors
    bpy.context.view_layer.objects.active = cloud.levels[0]
    assert bpy.ops.farfield.btf_restore_pbr() == {"FINISHED"}
    assert not any(PBR_MATERIAL in level for level in cloud.levels) and shown_images(cloud) == colors


@pytest.mark.slow
def test_a_bake_of_a_cloud_without_textures_shows_no_image():
    blender_scenes.reset_scene()
    cloud = build_cloud(blender_scenes.ball(), levels=1, nested_levels=False, textures=False)
    cloud = bake_in_this_process(cloud, **SMALL)
    (level,) = cloud.levels
    assert any(node.type == "TEX_IMAGE" for node in level.data.materials[0].node_tree.nodes)
    assert shown_images(cloud) == [None]
