"""A billboard cloud as the last level."""

import bpy
import numpy as np
import pytest

from farfield.addon.bridge.texmesh.level_sets import level_sets_in
from glb_reader import read_glb
from textured_scenes import textured_ball

pytestmark = pytest.mark.usefixtures("empty_scene", "few_samples")
SMALL = {"levels": "ratios", "ratios": "0.5,0.2", "views": 1, "max_image": 32, "vertices": "original", "billboard_cloud": True}


def make(**values) -> list[bpy.types.Object]:
    assert bpy.ops.farfield.texmesh_levels(**SMALL | values) == {"FINISHED"}
    bpy.context.view_layer.update()
    (levels,) = level_sets_in(bpy.context.scene)
    return levels.levels


def count_data() -> list[int]:
    images = [image for image in bpy.data.images if image.source != "VIEWER"]
    return [len(blocks) for blocks in (bpy.data.meshes, bpy.data.materials, images, bpy.data.collections, bpy.data.objects)]


@pytest.mark.slow
def test_the_last_level_is_a_billboard_cloud(tmp_path, capsys):
    ball = textured_ball(6, "Ball")
    ball.location, ball.scale, ball.rotation_euler = (5.0, 0.0, 1.0), (2.0, 2.0, 2.0), (0.5, 0.0, 0.0)
    before = count_data()
    *_, coarsest, cloud = make(cloud_quads=6)
    assert 'The last level of "Ball" is a billboard cloud of' in capsys.readouterr().out
    assert 2 <= len(cloud.data.polygons) <= 12 and cloud["farfield_error"] > coarsest["farfield_error"]
    assert cloud.matrix_world == ball.matrix_world
    low, high = (np.array(getattr(np, name)(np.array(cloud.bound_box), axis=0)) for name in ("min", "max"))
    assert np.abs(low + 1.0).max() < 0.5 and np.abs(high - 1.0).max() < 0.5
    assert bpy.ops.farfield.texmesh_export(filepath=str(tmp_path / "ball.glb"), one_file=True) == {"FINISHED"}
    file = read_glb(tmp_path / "ball.glb")
    assert [node.name for node in file.nodes] == [f"Ball_LOD{number}" for number in range(4)]
    assert file.materials[file.meshes[3].primitives[0].material]["alphaMode"] == "MASK"
    assert len(make(billboard_cloud=False)) == 3, "these replace the levels and the cloud"
    assert bpy.ops.farfield.texmesh_remove() == {"FINISHED"}
    assert count_data() == before


def test_deformed_objects_have_no_billboard_cloud(capsys):
    ball = textured_ball(6, "Ball")
    ball.shape_key_add(name="Basis")
    ball.shape_key_add(name="Wide")
    assert len(make()) == 3
    assert "Skipped: the billboard cloud of Ball (it is deformed)." in capsys.readouterr().out


@pytest.mark.slow
def test_a_cloud_of_too_few_quads_is_left_out(capsys):
    textured_ball(5, "Ball")
    assert len(make(cloud_quads=2)) == 3
    assert 'Skipped: the billboard cloud ("Ball" needs at least' in capsys.readouterr().out
