"""The operators as scripts and other add-ons call them: what they make, what they refuse, and that they change nothing else."""

import math

import bpy
import numpy as np
import pytest

from farfield.addon.core.billboards.settings import BillboardSettings
from farfield.addon.core.cameras import choose_level
from farfield.addon.core.settings import describe
from farfield.addon.operators import long_work, properties
from farfield.addon.operators.billboards_clouds import cloud_for, clouds_in

pytestmark = pytest.mark.usefixtures("empty_scene")
ROUGH = {"error": 5.0, "levels": 2, "textures": False}


def build(**properties_given):
    """Build with few quads and no textures unless asked."""
    return bpy.ops.farfield.billboards_build(**(ROUGH | properties_given))


def cube(name="Cube", location=(0.0, 0.0, 0.0), **how):
    """A cube of side 2, selected."""
    bpy.ops.mesh.primitive_cube_add(location=location, **how)
    bpy.context.object.name = name
    return bpy.context.object


def select(*objects):
    """Select exactly these."""
    bpy.context.view_layer.update()
    for item in bpy.context.view_layer.objects:
        item.select_set(item in objects)
    bpy.context.view_layer.objects.active = objects[0] if objects else None


def levels():
    """Level objects in the file, by name."""
    return {item.name: item for item in bpy.data.objects if item.get("farfield_kind") == "cloud"}


def refusal(**properties_given):
    """The sentence with which building is refused."""
    with pytest.raises(RuntimeError) as caught:
        build(**properties_given)
    assert not levels()
    return str(caught.value)


def test_a_cube_becomes_a_cloud_in_levels():
    source = cube(location=(3.0, 0.0, 0.0))
    assert build() == {"FINISHED"}
    assert list(levels()) == ["Cube Cloud L0", "Cube Cloud L1"]
    first, second = levels().values()
    assert first["farfield_level"] == 0 and first["farfield_quads"] == 6 == len(first.data.polygons)
    assert first["farfield_error"] == pytest.approx(0.05 * 2.0)
    assert second["farfield_error"] == pytest.approx(2 * first["farfield_error"])
    assert not first.hide_render and second.hide_render
    assert not source.hide_render and source.name in bpy.context.scene.objects


def test_the_cloud_stands_where_its_source_stands():
    cube(location=(3.0, -2.0, 1.0), rotation=(0.3, 0.5, 0.7), scale=(1.0, 2.0, 0.5))
    source = bpy.context.object
    build(error=1.0)
    level = levels()["Cube Cloud L0"]
    bpy.context.view_layer.update()
    world = [np.array([owner.matrix_world @ vertex.co for vertex in owner.data.vertices]) for owner in (source, level)]
    assert np.ptp(world[0], axis=0) == pytest.approx(np.ptp(world[1], axis=0), abs=0.05)
    assert world[0].mean(axis=0) == pytest.approx(world[1].mean(axis=0), abs=0.05)


def test_each_selected_object_gets_a_cloud_or_all_get_one():
    first, second = cube("One"), cube("Two", location=(5.0, 3.0, 1.3))
    select(first, second)
    build(levels=1, error=1.0)
    assert {name: level["farfield_quads"] for name, level in levels().items()} == {"One Cloud L0": 6, "Two Cloud L0": 6}
    build(levels=1, error=1.0, together=True)
    assert sorted(level["farfield_quads"] for level in levels().values()) == [6, 6, 12]


def test_what_is_skipped_is_named_with_the_reason(capfd):
    solid = cube("Solid")
    bpy.ops.object.light_add()
    light = bpy.context.object
    wire = bpy.data.objects.new("Wire", bpy.data.meshes.new("Wire"))
    wire.data.from_pydata([(0, 0, 0), (1, 0, 0)], [(0, 1)], [])
    bpy.context.collection.objects.link(wire)
    select(solid, light, wire)
    build(levels=1)
    assert list(levels()) == ["Solid Cloud L0"]
    said = capfd.readouterr().out
    assert "Wire (no faces)" in said and f"{light.name} (a light has no faces)" in said
    bpy.data.objects.remove(levels()["Solid Cloud L0"])
    select(light, wire)
    sentence = refusal()
    assert "Wire (no faces)" in sentence and light.name in sentence


def test_what_is_only_disabled_in_renders_is_built_since_it_was_selected():
    cube().hide_render = True
    build(levels=1)
    assert list(levels()) == ["Cube Cloud L0"]


def test_hidden_objects_are_not_selected_and_so_not_built():
    shown, hidden = cube("Shown"), cube("Hidden")
    select(shown, hidden)
    hidden.hide_set(True)
    build(levels=1)
    assert list(levels()) == ["Shown Cloud L0"]


def test_clouds_are_not_built_from_clouds():
    cube()
    build(levels=1)
    select(*levels().values())
    with pytest.raises(RuntimeError, match="made by Farfield"):
        build()


def test_without_a_selection_the_button_says_what_to_do():
    assert not bpy.ops.farfield.billboards_build.poll()
    with pytest.raises(RuntimeError, match="Select an object"):
        build()


def test_edit_mode_is_served_as_it_stands():
    source = cube()
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.select_all(action="SELECT")
    bpy.ops.transform.resize(value=(3.0, 3.0, 3.0))
    build(levels=1)
    assert levels()["Cube Cloud L0"]["farfield_error"] == pytest.approx(0.05 * 6.0)
    assert source.data.vertices[0].co.length == pytest.approx(3.0 * math.sqrt(3.0))


def test_panel_settings_count_where_the_call_says_nothing():
    cube()
    group = bpy.context.scene.farfield_billboards
    group.error, group.levels, group.textures = 2.0, 1, False
    assert bpy.ops.farfield.billboards_build() == {"FINISHED"}
    assert levels()["Cube Cloud L0"]["farfield_error"] == pytest.approx(0.02 * 2.0)


def test_source_is_hidden_from_render_only_if_asked():
    source = cube()
    build(hide_source_from_render=True)
    assert source.hide_render and not source.hide_viewport


def test_linked_and_shared_meshes_are_only_read():
    first = cube("First")
    second = first.copy()
    second.location.x = 5.0
    bpy.context.collection.objects.link(second)
    select(first, second)
    before = [tuple(vertex.co) for vertex in first.data.vertices]
    build(levels=1)
    assert len(levels()) == 2 and first.data is second.data and first.data.users == 2
    assert [tuple(vertex.co) for vertex in first.data.vertices] == before


def test_library_objects_are_served(tmp_path):
    cube("Linked")
    library = tmp_path / "bibliothèque été.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(library))
    bpy.ops.wm.read_factory_settings(use_empty=True)
    with bpy.data.libraries.load(str(library), link=True) as (_, target):
        target.objects = ["Linked"]
    bpy.context.collection.objects.link(target.objects[0])
    select(target.objects[0])
    build(levels=1)
    assert list(levels()) == ["Linked Cloud L0"]


def test_a_mesh_of_vertices_alone_is_a_point_cloud():
    angles = np.linspace(0.0, 2.0 * np.pi, 40, endpoint=False)
    around = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(40)])
    rings = [around * [r, r, 1.0] for r in np.linspace(0.2, 1.0, 8)]
    mesh = bpy.data.meshes.new("Points")
    mesh.from_pydata(np.concatenate(rings).tolist(), [], [])
    points = bpy.data.objects.new("Points", mesh)
    bpy.context.collection.objects.link(points)
    select(points)
    build(levels=1)
    assert levels()["Points Cloud L0"]["farfield_quads"] >= 1


def test_textures_are_captured_and_packed():
    cube()
    build(textures=True, levels=1, error=20.0, samples=1)
    images = [node.image for node in levels()["Cube Cloud L0"].data.materials[0].node_tree.nodes if node.type == "TEX_IMAGE"]
    assert len(images) == 6 and all(image.packed_file for image in images)
    assert [scene.name for scene in bpy.data.scenes] == ["Scene"]


def test_show_level_follows_the_projected_error():
    source = cube()
    build(levels=2, error=1.0)
    assert not bpy.ops.farfield.billboards_show_level.poll()
    bpy.ops.object.camera_add()
    camera = bpy.context.scene.camera = bpy.context.object
    fine, coarse = levels().values()
    for distance, shown in ((10.0, source), (60.0, fine), (1000.0, coarse)):
        camera.location = (0.0, -distance, 0.0)
        assert bpy.ops.farfield.billboards_show_level() == {"FINISHED"}
        assert [item for item in (source, fine, coarse) if not item.hide_render] == [shown]
        assert [item for item in (source, fine, coarse) if not item.hide_viewport] == [shown]
    assert cloud_for(bpy.context.scene, bpy.context.active_object) is None, "the camera is active"
    camera.location = (0.0, -10.0, 0.0)
    bpy.ops.farfield.billboards_show_level()
    bpy.context.view_layer.objects.active = source
    camera.location = (0.0, -1000.0, 0.0)
    bpy.ops.farfield.billboards_show_level()
    assert bpy.context.active_object == coarse and coarse.select_get(), "the panel goes by the active object"
    bpy.data.objects.remove(source)
    camera.location = (0.0, -10.0, 0.0)
    bpy.ops.farfield.billboards_show_level()
    assert not fine.hide_render and coarse.hide_render


def test_choice_in_the_scene_is_the_choice_of_the_core():
    from farfield.addon.bridge.cameras import scene_camera

    cube()
    build(levels=3, error=1.0)
    bpy.ops.object.camera_add(location=(0.0, 0.0, 150.0))
    bpy.context.scene.camera = bpy.context.object
    bpy.context.view_layer.update()
    (cloud,) = clouds_in(bpy.context.scene)
    camera = scene_camera(bpy.context.scene)
    expected = choose_level(cloud.errors, cloud.distance(camera.position), camera)
    assert cloud.show_for(camera) == expected


def test_estimate_reports_and_changes_nothing():
    cube()
    before = sorted(item.name for item in bpy.data.objects)
    assert bpy.ops.farfield.billboards_estimate() == {"FINISHED"}
    assert sorted(item.name for item in bpy.data.objects) == before


@pytest.mark.parametrize("item", describe(BillboardSettings), ids=lambda item: item.name)
def test_every_setting_goes_through_blender_and_back(item):
    group = bpy.context.scene.farfield_billboards
    for value in [*item.choices, item.default] if item.choices else [item.minimum, item.maximum, item.default]:
        if value is not None:
            setattr(group, item.name, properties.to_blender(item, value))
            back = getattr(properties.read(BillboardSettings, group), item.name)
            assert back == (pytest.approx(value, rel=1e-5, abs=1e-9) if item.type is float else value)


def test_only_one_job_at_a_time(monkeypatch):
    class Busy:
        title = "Other work"

    cube()
    monkeypatch.setattr(long_work, "_current", Busy())
    assert not bpy.ops.farfield.billboards_build.poll()
    with pytest.raises(RuntimeError, match="Other work is still running"):
        build()
