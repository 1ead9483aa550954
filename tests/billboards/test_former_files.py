"""Clouds in files that former versions of Farfield saved.

`former_cloud_material.json` describes the material of a cloud and its node group, recorded with `describe_tree` from what the version
before layers of materials created (node group version 1).
"""

import json
from pathlib import Path

import bpy
import numpy as np
import pytest

pytest.importorskip("bpy")

from bridge import blender_scenes
from bridge.operator_scenes import levels, select
from farfield.addon.bridge.billboards.cloud_materials import MAPS, SIDES, create_cloud_material, map_label
from farfield.addon.compat import enable_nodes
from lib.studio import open_studio
from node_descriptions import build_tree, describe_tree

pytestmark = pytest.mark.usefixtures("empty_scene")
FORMER = json.loads(Path(__file__).with_name("former_cloud_material.json").read_text(encoding="utf-8"))


def build(item, **settings):
    """Build a cloud of an object and return its only level."""
    before = set(levels())
    select(item)
    bpy.ops.farfield.billboards_build(levels=1, error=8.0, samples=1, keep_original_visible=True, **settings)
    (name,) = set(levels()) - before
    return levels()[name]


def replace_by_former_material(level):
    """Give a level the material that the former version would have created, with its images and its node group."""
    current = level.data.materials[0]
    images = {node.label: node.image for node in current.node_tree.nodes if node.type == "TEX_IMAGE"}
    distance = next(node.inputs["Shadowless Distance"].default_value for node in current.node_tree.nodes if node.type == "GROUP")
    former = bpy.data.materials.new(current.name)
    enable_nodes(former)
    former.node_tree.nodes.clear()
    for name in ("surface_render_method", "use_transparent_shadow", "use_backface_culling", "use_backface_culling_shadow"):
        setattr(former, name, getattr(current, name))
    former.cycles.use_bump_map_correction = current.cycles.use_bump_map_correction
    level.data.materials[0] = former
    groups = {node.node_tree for node in current.node_tree.nodes if node.type == "GROUP"}
    bpy.data.batch_remove([current, *groups])
    group = bpy.data.node_groups.new(FORMER["group_name"], "ShaderNodeTree")
    group["farfield_version"] = FORMER["version"]
    build_tree(group, FORMER["group"], lambda *_: None)
    labels = {f"{side} {map_name}": map_label(side, map_name) for side in SIDES for map_name in MAPS}
    build_tree(former.node_tree, FORMER["material"], lambda name, data: images[labels[data]] if name == "image" else group)
    next(node for node in former.node_tree.nodes if node.type == "GROUP").inputs["Shadowless Distance"].default_value = distance


def group_of(level):
    """Return the node group of the material of a level."""
    return next(node.node_tree for node in level.data.materials[0].node_tree.nodes if node.type == "GROUP")


def render(level):
    """Return renders of a level from two directions."""
    with open_studio([level], 8) as studio:
        directions = np.array([[0.5, -0.7, 0.5], [-0.6, 0.6, 0.53]])
        return [studio.render([level], direction / np.linalg.norm(direction), np.zeros(3), 0.06, 64) for direction in directions]


def test_materials_without_layers_are_still_created_as_they_were():
    images = {(side, map_name): bpy.data.images.new(f"{side} {map_name}", 4, 4) for side in SIDES for map_name in MAPS}
    material = create_cloud_material("Material", images, 0.04)
    group = next(node.node_tree for node in material.node_tree.nodes if node.type == "GROUP")
    assert group["farfield_version"] == FORMER["version"]
    assert describe_tree(group) == FORMER["group"]
    assert describe_tree(material.node_tree) == FORMER["material"]


@pytest.mark.slow
def test_a_saved_cloud_renders_as_it_did_also_next_to_new_clouds(tmp_path):
    material = blender_scenes.create_material("Paint", (0.7, 0.3, 0.1), 0.3)
    level = build(blender_scenes.ball(material=material, segments=12))
    current = render(level)
    replace_by_former_material(level)
    saved = render(level)
    assert np.abs(np.array(saved) - current).max() < 1e-6 and np.array(saved)[..., 3].max() > 0.99
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "former.blend"))
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "former.blend"))

    level = levels()["Ball Cloud L0"]
    assert np.array_equal(render(level), saved)
    shining = blender_scenes.create_material("Shining")
    blender_scenes.shader_of(shining).inputs["Emission Strength"].default_value = 2.0
    new = build(blender_scenes.box("Lit", shining))
    same = build(blender_scenes.box("Plain", blender_scenes.create_material("Plain")))
    assert group_of(same) == group_of(level) != group_of(new)
    assert describe_tree(group_of(level)) == FORMER["group"]
    assert np.array_equal(render(level), saved)
