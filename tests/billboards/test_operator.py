"""The operators as scripts and other add-ons call them: results, rejected input, visibility, undo, and no other changes."""

import math
import time
from unittest.mock import MagicMock

import bpy
import numpy as np
import pytest

from bridge.operator_scenes import build, cube, is_hidden, levels, link_from_library, select
from farfield.addon.bridge.billboards.level_objects import read_level_quads
from farfield.addon.bridge.billboards.scene_clouds import clouds_in, find_cloud
from farfield.addon.bridge.cameras import read_scene_camera
from farfield.addon.core.billboards.settings import BillboardSettings, BuildOptions, CrossfadeSettings
from farfield.addon.core.geometry.cameras import choose_level
from farfield.addon.core.settings import describe
from farfield.addon.operators import long_work, properties
from farfield.addon.operators.billboards import estimates
from farfield.addon.operators.billboards.sources import describe_selection, group_by_parents
from farfield.addon.panels import billboards as panels

pytestmark = pytest.mark.usefixtures("empty_scene")


def error_message(**arguments):
    """Return the message with which building is rejected."""
    with pytest.raises(RuntimeError) as caught:
        build(**arguments)
    assert not levels()
    return str(caught.value)


def test_cube_becomes_cloud_with_levels():
    source = cube(location=(3.0, 0.0, 0.0))
    assert build() == {"FINISHED"}
    assert list(levels()) == ["Cube Cloud L0", "Cube Cloud L1"]
    first, second = levels().values()
    assert first["farfield_level"] == 0 and first["farfield_quads"] == 6 == len(first.data.polygons)
    assert first["farfield_error"] == pytest.approx(0.05 * 2.0)
    assert second["farfield_error"] == pytest.approx(2 * first["farfield_error"])
    assert not first.hide_render and second.hide_render
    assert source.name in bpy.context.scene.objects


def test_cloud_has_position_and_size_of_source():
    cube(location=(3.0, -2.0, 1.0), rotation=(0.3, 0.5, 0.7), scale=(1.0, 2.0, 0.5))
    source = bpy.context.object
    build(error=1.0)
    level = levels()["Cube Cloud L0"]
    bpy.context.view_layer.update()
    world = [np.array([owner.matrix_world @ vertex.co for vertex in owner.data.vertices]) for owner in (source, level)]
    margin = np.sqrt(3.0) * level["farfield_error"]  # A quad is half an error larger on each side, and the cube is rotated.
    assert np.ptp(world[0], axis=0) == pytest.approx(np.ptp(world[1], axis=0), abs=margin)
    assert world[0].mean(axis=0) == pytest.approx(world[1].mean(axis=0), abs=0.05)


def test_objects_that_are_parented_to_each_other_become_one_cloud():
    trunk, crown, rock = cube("Trunk"), cube("Crown", location=(0.0, 0.0, 2.0)), cube("Rock", location=(9.0, 0.0, 0.0))
    crown.parent = trunk
    select(crown, trunk, rock)
    assert describe_selection(bpy.context, False) == "2 clouds, one per object with its children."
    build(levels=1, error=0.2)
    assert {cloud.collection.name: sorted(source.name for source in cloud.sources) for cloud in clouds_in(bpy.context.scene)} == {
        "Trunk Cloud": ["Crown", "Trunk"],
        "Rock Cloud": ["Rock"],
    }


def test_meshes_of_one_armature_become_one_cloud_and_those_of_an_empty_do_not():
    rig, empty = (bpy.data.objects.new(name, data) for name, data in (("Rig", bpy.data.armatures.new("Rig")), ("Empty", None)))
    for parent, expected in ((rig, 1), (empty, 2)):
        bpy.context.scene.collection.objects.link(parent)
        objects = [cube(f"{parent.name} {index}", location=(3.0 * index, 0.0, 0.0)) for index in range(2)]
        for item in objects:
            item.parent = parent
        assert len(group_by_parents(objects)) == expected
        select(*objects)
        assert describe_selection(bpy.context, False).startswith(("One cloud of 2 objects", "2 clouds")[expected - 1])


def test_one_cloud_per_selected_object_or_one_of_all():
    first, second = cube("One"), cube("Two", location=(5.0, 3.0, 1.3))
    select(first, second)
    build(levels=1, error=1.0, keep_original_visible=True)
    assert {name: level["farfield_quads"] for name, level in levels().items()} == {"One Cloud L0": 6, "Two Cloud L0": 6}
    select(first, second)
    build(levels=1, error=1.0, combine_selected=True)
    assert sorted(level["farfield_quads"] for level in levels().values()) == [6, 6, 12]


def test_skipped_objects_are_reported_with_reason(capfd):
    solid = cube("Solid")
    bpy.ops.object.light_add()
    light = bpy.context.object
    wire = bpy.data.objects.new("Wire", bpy.data.meshes.new("Wire"))
    wire.data.from_pydata([(0, 0, 0), (1, 0, 0)], [(0, 1)], [])
    bpy.context.collection.objects.link(wire)
    select(solid, light, wire)
    build(levels=1)
    assert list(levels()) == ["Solid Cloud L0"]
    output = capfd.readouterr().out
    assert "Wire (no faces)" in output and f"{light.name} (a light has no faces)" in output
    bpy.data.objects.remove(levels()["Solid Cloud L0"])
    select(light, wire)
    message = error_message()
    assert "Wire (no faces)" in message and light.name in message


def test_selected_object_disabled_in_renders_is_built():
    cube().hide_render = True
    build(levels=1)
    assert list(levels()) == ["Cube Cloud L0"]


def test_hidden_objects_are_not_built():
    shown, hidden = cube("Shown"), cube("Hidden")
    select(shown, hidden)
    hidden.hide_set(True)
    build(levels=1)
    assert list(levels()) == ["Shown Cloud L0"]


def test_poll_message_without_selection():
    assert not bpy.ops.farfield.billboards_build.poll()
    with pytest.raises(RuntimeError, match="Select an object"):
        build()


def test_edit_mode_changes_are_included():
    source = cube()
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.select_all(action="SELECT")
    bpy.ops.transform.resize(value=(3.0, 3.0, 3.0))
    build(levels=1)
    assert levels()["Cube Cloud L0"]["farfield_error"] == pytest.approx(0.05 * 6.0)
    assert source.data.vertices[0].co.length == pytest.approx(3.0 * math.sqrt(3.0))


def test_panel_settings_apply_where_the_call_sets_nothing():
    cube()
    group = bpy.context.scene.farfield_billboards
    group.error, group.levels, group.textures = 2.0, 1, False
    assert bpy.ops.farfield.billboards_build() == {"FINISHED"}
    assert levels()["Cube Cloud L0"]["farfield_error"] == pytest.approx(0.02 * 2.0)


def test_shared_meshes_are_only_read():
    first = cube("First")
    second = first.copy()
    second.location.x = 5.0
    bpy.context.collection.objects.link(second)
    select(first, second)
    before = [tuple(vertex.co) for vertex in first.data.vertices]
    build(levels=1)
    assert len(levels()) == 2 and first.data is second.data and first.data.users == 2
    assert [tuple(vertex.co) for vertex in first.data.vertices] == before


def test_mesh_with_only_vertices_is_point_cloud():
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


class TestVisibility:
    """Either the source or its cloud is visible, so that the two do not flicker in the same place."""

    def test_build_shows_cloud_and_hides_source(self):
        source = cube()
        build()
        fine, coarse = levels().values()
        assert [is_hidden(item) for item in (source, fine, coarse)] == [True, False, True]
        assert bpy.context.active_object == fine and fine.select_get(), "the panel shows the cloud of the active object"

    def test_keep_original_visible_shows_both(self):
        source = cube()
        build(keep_original_visible=True)
        fine, coarse = levels().values()
        assert [is_hidden(item) for item in (source, fine, coarse)] == [False, False, True]
        assert bpy.context.active_object == source and source.select_get()

    def test_toggle_shows_original_and_cloud_again(self):
        source = cube()
        build()
        fine, coarse = levels().values()
        coarse.hide_viewport = coarse.hide_render = False
        fine.hide_viewport = fine.hide_render = True
        bpy.context.view_layer.objects.active = coarse
        assert bpy.ops.farfield.billboards_show() == {"FINISHED"}
        assert [is_hidden(item) for item in (source, fine, coarse)] == [False, True, True]
        assert bpy.context.active_object == source and source.select_get()
        assert bpy.ops.farfield.billboards_show() == {"FINISHED"}
        assert [is_hidden(item) for item in (source, fine, coarse)] == [True, True, False], "the level that was visible before"
        assert bpy.context.active_object == coarse

    def test_show_sets_the_requested_state(self):
        source = cube()
        build(keep_original_visible=True, levels=1)
        (level,) = levels().values()
        for _ in range(2):
            bpy.ops.farfield.billboards_show(show="CLOUD")
            assert (is_hidden(source), is_hidden(level)) == (True, False)
        for _ in range(2):
            bpy.ops.farfield.billboards_show(show="SOURCE")
            assert (is_hidden(source), is_hidden(level)) == (False, True)

    def test_all_selected_clouds_are_toggled_and_no_others(self):
        sources = [cube(name, location=(5.0 * index, 0.0, 0.0)) for index, name in enumerate(("One", "Two", "Three"))]
        select(*sources)
        build(levels=1)
        first, second, third = (levels()[f"{source.name} Cloud L0"] for source in sources)
        select(first, third)
        assert bpy.ops.farfield.billboards_show() == {"FINISHED"}
        assert [is_hidden(source) for source in sources] == [False, True, False]
        assert [is_hidden(level) for level in (first, second, third)] == [True, False, True]

    def test_combined_sources_are_toggled_together(self):
        sources = cube("One"), cube("Two", location=(5.0, 0.0, 0.0))
        select(*sources)
        build(levels=1, combine_selected=True)
        assert all(is_hidden(source) for source in sources)
        bpy.ops.farfield.billboards_show()
        assert not any(is_hidden(source) for source in sources)

    def test_cross_fade_survives_showing_the_original(self):
        source = cube()
        build()
        bpy.ops.object.camera_add(location=(0.0, -10.0, 0.0))
        bpy.context.scene.camera = bpy.context.object
        bpy.ops.farfield.billboards_crossfade()
        select(levels()["Cube Cloud L0"])
        bpy.ops.farfield.billboards_show()
        assert not is_hidden(source) and all(is_hidden(level) for level in levels().values())
        bpy.ops.farfield.billboards_show()
        assert is_hidden(source) and not any(is_hidden(level) for level in levels().values())
        assert clouds_in(bpy.context.scene)[0].has_crossfade

    def test_cross_fade_is_switched_per_object_and_for_all(self):
        items = [cube("One"), cube("Two", location=(5.0, 0.0, 0.0))]
        select(*items)
        build()
        bpy.ops.object.camera_add(location=(0.0, -4000.0, 0.0))
        bpy.context.scene.camera = bpy.context.object
        one, two = clouds_in(bpy.context.scene)
        select(one.levels[0])
        bpy.ops.farfield.billboards_crossfade(selected=True)
        assert one.has_crossfade and not two.has_crossfade
        bpy.ops.farfield.billboards_crossfade()
        assert one.has_crossfade and two.has_crossfade
        select(two.levels[0])
        bpy.ops.farfield.billboards_crossfade(selected=True, enable=False)
        assert one.has_crossfade and not two.has_crossfade
        assert [is_hidden(level) for level in two.levels] == [True] * (len(two.levels) - 1) + [False], "the camera is far away"
        bpy.ops.farfield.billboards_crossfade(enable=False)
        assert not one.has_crossfade

    def test_undo_restores_visibility_in_one_step(self):
        cube()
        bpy.context.preferences.edit.use_global_undo = True
        bpy.ops.ed.undo_push(message="Add cube")
        build(levels=1)
        bpy.ops.ed.undo_push(message="Build")
        bpy.ops.farfield.billboards_show()
        bpy.ops.ed.undo_push(message="Show")
        bpy.ops.ed.undo()
        assert is_hidden(bpy.data.objects["Cube"]) and not is_hidden(levels()["Cube Cloud L0"])
        bpy.ops.ed.undo()
        assert not is_hidden(bpy.data.objects["Cube"]) and not levels()

    def test_without_cloud_there_is_nothing_to_show(self):
        select(cube())
        assert not bpy.ops.farfield.billboards_show.poll()

    def test_cloud_without_original_stays_visible(self, capfd):
        source = cube()
        build(levels=1)
        bpy.data.objects.remove(source)
        select(*levels().values())
        assert bpy.ops.farfield.billboards_show(show="SOURCE") == {"CANCELLED"}
        assert not is_hidden(levels()["Cube Cloud L0"])
        assert 'Original not found: "Cube" of "Cube Cloud"' in capfd.readouterr().out

    def test_linked_source_stays_as_it_is_and_is_reported(self, tmp_path, capfd):
        linked = link_from_library(tmp_path / "bibliothèque été.blend")
        build(levels=1)
        assert list(levels()) == ["Linked Cloud L0"]
        assert not is_hidden(linked)
        message = "Visibility unchanged, linked from a library: Linked."
        assert message in capfd.readouterr().out
        level = levels()["Linked Cloud L0"]
        select(level)
        for hidden in (True, False):
            assert bpy.ops.farfield.billboards_show() == {"FINISHED"}
            assert not is_hidden(linked) and is_hidden(level) == hidden
            assert message in capfd.readouterr().out
            select(linked)
        bpy.ops.object.camera_add(location=(0.0, 0.0, 500.0))
        bpy.context.scene.camera = bpy.context.object
        for show in (bpy.ops.farfield.billboards_show_level, bpy.ops.farfield.billboards_crossfade):
            assert show() == {"FINISHED"}
            assert not is_hidden(linked) and message in capfd.readouterr().out


def test_show_level_depends_on_projected_error():
    source = cube()
    build(levels=2, error=1.0)
    assert not bpy.ops.farfield.billboards_show_level.poll()
    bpy.ops.object.camera_add()
    camera = bpy.context.scene.camera = bpy.context.object
    fine, coarse = levels().values()
    for distance, shown in ((10.0, source), (60.0, fine), (1000.0, coarse)):
        camera.location = (0.0, -distance, 0.0)
        assert bpy.ops.farfield.billboards_show_level() == {"FINISHED"}
        assert [item for item in (source, fine, coarse) if not is_hidden(item)] == [shown]
    assert find_cloud(bpy.context.scene, bpy.context.active_object) is None, "the camera is active"
    camera.location = (0.0, -10.0, 0.0)
    bpy.ops.farfield.billboards_show_level()
    bpy.context.view_layer.objects.active = source
    camera.location = (0.0, -1000.0, 0.0)
    bpy.ops.farfield.billboards_show_level()
    assert bpy.context.active_object == coarse and coarse.select_get(), "the panel shows the cloud of the active object"
    bpy.data.objects.remove(source)
    camera.location = (0.0, -10.0, 0.0)
    bpy.ops.farfield.billboards_show_level()
    assert not fine.hide_render and coarse.hide_render


def test_show_level_shows_a_cloud_that_was_hidden():
    source = cube()
    build(levels=1)
    bpy.ops.farfield.billboards_show(show="SOURCE")
    bpy.ops.object.camera_add(location=(0.0, -1000.0, 0.0))
    bpy.context.scene.camera = bpy.context.object
    bpy.ops.farfield.billboards_show_level()
    assert is_hidden(source) and not is_hidden(levels()["Cube Cloud L0"])


def test_level_in_scene_is_the_level_of_core():
    cube()
    build(levels=3, error=1.0)
    bpy.ops.object.camera_add(location=(0.0, 0.0, 150.0))
    bpy.context.scene.camera = bpy.context.object
    bpy.context.view_layer.update()
    (cloud,) = clouds_in(bpy.context.scene)
    camera = read_scene_camera(bpy.context.scene)
    expected = choose_level(cloud.errors, cloud.distance(camera.position), camera)
    assert cloud.show_level_for(camera, bpy.context.view_layer) == expected


def test_hidden_levels_keep_their_place_in_a_reopened_file(tmp_path):
    """Blender does not compute world matrices of objects that are hidden when a file is opened."""
    cube(location=(30.0, 0.0, 0.0))
    build(levels=2)
    bpy.ops.farfield.billboards_show(show="SOURCE")
    path = str(tmp_path / "hidden.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path)
    bpy.ops.wm.open_mainfile(filepath=path)
    (cloud,) = clouds_in(bpy.context.scene)
    assert cloud.distance(np.array([40.0, 0.0, 0.0])) == pytest.approx(9.0, abs=0.5)
    for level in cloud.levels:
        assert np.concatenate(read_level_quads(level).corners).mean(axis=0) == pytest.approx([30.0, 0.0, 0.0], abs=0.2)


class TestEstimates:
    """Estimates are stored until the selection, the settings or the objects change."""

    def key(self):
        group = bpy.context.scene.farfield_billboards
        return estimates.estimate_key(bpy.context, properties.read(BillboardSettings, group))

    def test_operator_reports_and_changes_nothing(self):
        cube()
        before = sorted(item.name for item in bpy.data.objects)
        assert bpy.ops.farfield.billboards_estimate() == {"FINISHED"}
        assert sorted(item.name for item in bpy.data.objects) == before
        assert estimates.cache.find(self.key()).levels

    @pytest.mark.slow
    def test_other_settings_need_another_estimate(self):
        cube()
        bpy.ops.farfield.billboards_estimate()
        bpy.context.scene.farfield_billboards.error = 7.0
        assert estimates.cache.find(self.key()) is None

    def test_clear_discards_results_and_the_scheduled_estimate(self):
        cube()
        bpy.ops.farfield.billboards_estimate()
        assert estimates.cache.request(self.key()) and estimates.cache.request(self.key())
        assert bpy.app.timers.is_registered(estimates.cache._timer)
        estimates.cache.clear()
        assert estimates.cache.find(self.key()) is None and not bpy.app.timers.is_registered(estimates.cache._timer)

    def test_estimates_of_the_panel_are_computed_in_the_background(self):
        """A further setting cancels the one that runs."""
        cube()
        group = bpy.context.scene.farfield_billboards
        for error in (3.0, 5.0):
            group.error = error
            assert estimates.cache.request(self.key())
            assert estimates.cache._advance_pending() == estimates.POLL_SECONDS
        while estimates.cache._advance_pending() is not None:
            time.sleep(0.01)
        assert estimates.cache.find(self.key()).levels[0].quads == 6
        estimates.cache.clear()

    @pytest.mark.slow
    def test_estimates_of_deleted_objects_are_evicted(self):
        item = cube()
        bpy.ops.farfield.billboards_estimate()
        key = self.key()
        bpy.data.objects.remove(item)
        assert estimates.cache.find(key) is None
        assert estimates.cache._result is None and estimates.cache._trials is None


@pytest.mark.parametrize("item", describe(BillboardSettings), ids=lambda item: item.name)
def test_settings_round_trip_through_blender(item):
    group = bpy.context.scene.farfield_billboards
    for value in [*item.choices, item.default] if item.choices else [item.minimum, item.maximum, item.default]:
        if value is not None:
            setattr(group, item.name, properties.to_blender(item, value))
            back = getattr(properties.read(BillboardSettings, group), item.name)
            assert back == (pytest.approx(value, rel=1e-5, abs=1e-9) if item.type is float else value)


class TestPanel:
    """The panel and its sub-panels, drawn into a layout that records the calls."""

    def draw(self):
        """Draw all visible panels; returns the texts of buttons and labels and the drawn properties."""
        layout = MagicMock()
        for nested in ("row", "column", "box"):
            getattr(layout, nested).return_value = layout
        for panel in panels.CLASSES:
            if not hasattr(panel, "poll") or panel.poll(bpy.context):
                plain = type(panel.__name__, panel.__bases__[:-1], {key: item for key, item in vars(panel).items() if key[:2] != "__"})
                drawn = plain()
                drawn.layout = layout
                drawn.draw(bpy.context)
        texts = {call.kwargs.get("text") for called in (layout.operator, layout.label) for call in called.call_args_list}
        return texts, [call.args[1] for call in layout.prop.call_args_list]

    def test_every_setting_is_drawn_once(self):
        cube()
        build()
        _, drawn = self.draw()
        assert sorted(drawn) == sorted(item.name for item in describe(BillboardSettings, BuildOptions, CrossfadeSettings))

    def test_levels_that_were_left_out_are_named(self):
        cube()
        build(nested_levels=False)
        texts, _ = self.draw()
        assert {"12", "6", "Tris", "in Mesh", "Quads"} <= texts
        (cloud,) = clouds_in(bpy.context.scene)
        assert f"Details ({len(cloud.notes)} notes)" in texts
        assert "with an error of 10% is" in " ".join(cloud.notes) and 'The cloud of "Cube" has 12' in " ".join(cloud.notes)

    @pytest.mark.slow
    def test_triangles_of_decimated_meshes_are_shown(self):
        bpy.ops.mesh.primitive_uv_sphere_add(segments=24, ring_count=12)
        build(error=4.0, levels=1, nested_levels=False)
        (level,) = levels().values()
        count = level["farfield_mesh_triangles"]
        faces = len(level.data.polygons) if count else 0
        assert 0 < count <= faces and {f"{count:,}", "in Mesh"} <= self.draw()[0]
        del level["farfield_mesh_triangles"]  # As in files of former versions.
        assert "-" in self.draw()[0]

    def test_buttons_follow_the_state(self):
        texts, _ = self.draw()
        assert "Select an object with a surface" in texts and "Cross-Fade" not in texts
        cube()
        texts, _ = self.draw()
        assert {"Build", "Estimate"} <= texts and "Show Original" not in texts
        build()
        texts, _ = self.draw()
        assert {"Show Original", "Cross-Fade", "All Clouds", "From", "The scene has no active camera"} <= texts
        bpy.ops.farfield.billboards_show()
        texts, _ = self.draw()
        assert "Show Cloud" in texts and "Show Original" not in texts


def test_only_one_job_at_a_time(monkeypatch):
    class Busy:
        title = "Other work"

    cube()
    monkeypatch.setattr(long_work, "_current", Busy())
    assert not bpy.ops.farfield.billboards_build.poll()
    with pytest.raises(RuntimeError, match="Other work is still running"):
        build()
