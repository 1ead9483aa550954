"""A cloud finds its original again, does not confuse it with another object, and can be built again from it."""

import json

import bpy
import pytest

from bridge.operator_scenes import build, cube, is_hidden, levels, link_from_library, select
from farfield.addon.bridge.billboards import source_objects
from farfield.addon.bridge.billboards.scene_clouds import clouds_in
from farfield.addon.bridge.source_links import SOURCES

pytestmark = pytest.mark.usefixtures("empty_scene")


def add_camera(distance=500.0):
    """Add an active camera that looks at the origin from a distance."""
    bpy.ops.object.camera_add(location=(0.0, 0.0, distance))
    bpy.context.scene.camera = bpy.context.object


def add_ball(name):
    """Add an object that is not a cube."""
    bpy.ops.mesh.primitive_ico_sphere_add(location=(9.0, 0.0, 0.0))
    bpy.context.object.name = name
    return bpy.context.object


def reopen(path):
    """Save the scene and open it again."""
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    bpy.ops.wm.open_mainfile(filepath=str(path))


class TestRenamed:
    """The original has another name, and perhaps another object has its old one."""

    @pytest.fixture
    def scene(self):
        """The cloud of `Oak`, whose original is now called `Tree`, and a ball called `Oak`."""
        oak = cube("Oak")
        build(levels=1)
        oak.name = "Tree"
        return bpy.data.objects["Tree"], add_ball("Oak")

    def test_show_changes_only_the_original(self, scene):
        tree, ball = scene
        select(levels()["Oak Cloud L0"])
        for hidden in (False, True):
            bpy.ops.farfield.billboards_show()
            assert (is_hidden(tree), is_hidden(ball)) == (hidden, False)

    def test_show_level_and_cross_fade_change_only_the_original(self, scene):
        tree, ball = scene
        add_camera()
        tree.hide_render = tree.hide_viewport = False
        bpy.ops.farfield.billboards_show_level()
        assert (is_hidden(tree), is_hidden(ball)) == (True, False)
        bpy.ops.farfield.billboards_crossfade()
        (proxy,) = source_objects.find_source_proxies(clouds_in(bpy.context.scene)[0].collection)
        assert len(proxy.data.vertices) == len(tree.data.vertices) and not is_hidden(ball)

    def test_it_is_found_in_a_reopened_file(self, scene, tmp_path):
        reopen(tmp_path / "grün.blend")
        (cloud,) = clouds_in(bpy.context.scene)
        assert [source.name for source in cloud.sources] == cloud.source_names == ["Tree"]

    def test_it_is_found_after_it_was_renamed_and_moved_in_several_sessions(self, scene, tmp_path):
        tree, _ = scene
        tree.location.x = 7.0
        reopen(tmp_path / "scene.blend")
        tree = bpy.data.objects["Tree"]
        tree.name, tree.location.y = "Baum", 5.0
        assert clouds_in(bpy.context.scene)[0].sources == [tree]
        reopen(tmp_path / "scene.blend")
        tree = bpy.data.objects["Baum"]
        tree.location.z, tree.name = 3.0, "Arbre"
        assert clouds_in(bpy.context.scene)[0].sources == [tree]

    def test_it_is_found_where_it_was_moved_to_in_the_same_session(self, scene):
        tree, _ = scene
        tree.location.x = 7.0
        assert clouds_in(bpy.context.scene)[0].sources == [tree]

    def test_a_new_object_with_the_old_name_is_not_the_original(self, scene, capfd):
        tree, ball = scene
        bpy.data.objects.remove(tree)
        select(levels()["Oak Cloud L0"])
        assert bpy.ops.farfield.billboards_show(show="SOURCE") == {"CANCELLED"}
        assert bpy.ops.farfield.billboards_show(show="CLOUD") == {"FINISHED"}
        assert not is_hidden(ball) and not is_hidden(levels()["Oak Cloud L0"])
        assert 'Original not found: "Oak" of "Oak Cloud"' in capfd.readouterr().out


class TestDuplicates:
    """Duplicates of the original copy its custom properties."""

    @staticmethod
    def duplicate(item, x):
        """Return a duplicate of `item`, moved along X."""
        item.hide_viewport = item.hide_render = False
        select(item)
        bpy.ops.object.duplicate()
        bpy.context.object.location.x += x
        return bpy.context.object

    def test_the_original_is_found_beside_its_duplicate(self):
        oak = cube("Oak")
        build(levels=1)
        duplicate = self.duplicate(oak, 3.0)
        assert clouds_in(bpy.context.scene)[0].sources == [oak] != [duplicate]

    @pytest.mark.parametrize("reopened", [False, True])
    def test_a_moved_duplicate_is_not_the_original(self, reopened, tmp_path):
        oak = cube("Oak")
        build(levels=1)
        self.duplicate(oak, 3.0)
        bpy.data.objects.remove(oak)
        if reopened:
            reopen(tmp_path / "scene.blend")
        (cloud,) = clouds_in(bpy.context.scene)
        assert cloud.sources == [] and cloud.missing_source_names == ["Oak"]

    def test_the_renamed_original_is_found_beside_duplicates(self, tmp_path):
        oak = cube("Oak", location=(1.0, 2.0, 3.0))
        build(levels=1)
        self.duplicate(oak, 3.0)
        oak.name = "Tree"
        reopen(tmp_path / "scene.blend")
        assert [source.name for source in clouds_in(bpy.context.scene)[0].sources] == ["Tree"]

    def test_a_duplicate_has_a_cloud_of_its_own(self):
        oak = cube("Oak")
        build(levels=1)
        duplicate = self.duplicate(oak, 3.0)
        build(levels=1)
        oak.name, duplicate.name = "First", "Second"
        assert [cloud.sources for cloud in clouds_in(bpy.context.scene)] == [[oak], [duplicate]]


class TestLinked:
    """Objects from a library cannot keep a custom property of this file."""

    def test_a_linked_original_is_found_in_a_reopened_file(self, tmp_path):
        link_from_library(tmp_path / "library.blend")
        build(levels=1)
        reopen(tmp_path / "scene.blend")
        assert [source.name for source in clouds_in(bpy.context.scene)[0].sources] == ["Linked"]

    def test_a_library_override_is_found_in_a_reopened_file(self, tmp_path):
        override = link_from_library(tmp_path / "library.blend").override_create(remap_local_usages=True)
        override.name = "Ours"
        select(override)
        build(levels=1)
        reopen(tmp_path / "scene.blend")
        (cloud,) = clouds_in(bpy.context.scene)
        assert [(source.name, source.library) for source in cloud.sources] == [("Ours", None)]
        assert is_hidden(cloud.sources[0])


BROKEN_ENTRIES = '["Oak", 7, {}, {"name": 1, "token": "a"}, {"name": "Oak", "library": [1, 2]}]'


@pytest.mark.parametrize("text", ["{", "7", '"Oak"', BROKEN_ENTRIES, "[" * 99_999], ids=["cut", "number", "text", "entries", "nested"])
def test_sources_that_are_not_a_list_of_objects_count_as_missing(text):
    cube("Oak")
    build(levels=1)
    (cloud,) = clouds_in(bpy.context.scene)
    for broken in (text, 7):
        cloud.collection[SOURCES] = broken
        assert cloud.sources == [] == cloud.source_names
    select(levels()["Oak Cloud L0"])
    assert bpy.ops.farfield.billboards_show(show="SOURCE") == {"CANCELLED"}


def test_the_record_names_no_pointer():
    cube("Oak")
    build(levels=1)
    (entry,) = json.loads(clouds_in(bpy.context.scene)[0].collection[SOURCES])
    assert entry["name"] == "Oak" and entry["token"] == bpy.data.objects["Oak"]["farfield_source_token"]


class TestBuildAgain:
    """Build with a cloud selected: a new cloud from its original, and the old one stays, hidden."""

    def test_the_old_cloud_is_hidden_and_stays(self, capfd):
        source = cube()
        build(levels=1)
        old = levels()["Cube Cloud L0"]
        select(old)
        assert build(levels=2) == {"FINISHED"}
        new = levels()["Cube Cloud.001 L0"]
        assert new["farfield_error"] == pytest.approx(0.05 * 2.0), "the error is relative to the original"
        assert [is_hidden(item) for item in (source, old, new)] == [True, True, False]
        assert bpy.context.active_object == new
        assert "Hidden: Cube Cloud." in capfd.readouterr().out
        assert [cloud.sources for cloud in clouds_in(bpy.context.scene)] == [[source], [source]]

    def test_show_original_shows_the_original_instead_of_the_new_cloud(self):
        source = cube()
        build(levels=1)
        select(levels()["Cube Cloud L0"])
        build(levels=1)
        bpy.ops.farfield.billboards_show(show="SOURCE")
        assert not is_hidden(source) and all(is_hidden(level) for level in levels().values())

    def test_keep_original_visible_shows_it(self):
        source = cube()
        build(levels=1)
        select(levels()["Cube Cloud L0"])
        build(levels=1, keep_original_visible=True)
        assert not is_hidden(source)

    def test_combined_originals_become_one_cloud_again(self):
        select(cube("One"), cube("Two", location=(5.0, 3.0, 1.3)))
        build(levels=1, error=1.0, combine_selected=True)
        (level,) = levels().values()
        select(level)
        build(levels=1, error=1.0)
        assert [item["farfield_quads"] for item in levels().values()] == [12, 12]

    def test_cloud_and_object_are_built_side_by_side_or_combined(self):
        cube("One")
        build(levels=1, error=1.0)
        other = cube("Two", location=(5.0, 3.0, 1.3))
        select(levels()["One Cloud L0"], other)
        build(levels=1, error=1.0, keep_original_visible=True)
        assert sorted(levels()) == ["One Cloud L0", "One Cloud.001 L0", "Two Cloud L0"]
        select(levels()["One Cloud.001 L0"], other)
        build(levels=1, error=1.0, combine_selected=True)
        assert sorted(item["farfield_quads"] for item in levels().values()) == [6, 6, 6, 12]

    def test_cloud_with_its_original_is_built_once(self):
        source = cube()
        build(levels=1, keep_original_visible=True)
        select(source, levels()["Cube Cloud L0"])
        build(levels=1)
        assert len(levels()) == 2

    def test_all_objects_of_a_point_cloud_are_read(self):
        mesh = bpy.data.meshes.new("Points")
        mesh.from_pydata([(x, y, 0.1 * x * y) for x in range(12) for y in range(12)], [], [])
        points = bpy.data.objects.new("Points", mesh)
        bpy.context.collection.objects.link(points)
        select(points)
        build(levels=1)
        select(*levels().values())
        build(levels=1)
        assert len(levels()) == 2 and is_hidden(points)

    @pytest.mark.slow
    def test_the_estimate_is_that_of_the_original(self, capfd):
        cube()
        bpy.ops.farfield.billboards_estimate()
        expected = capfd.readouterr().out
        build(levels=1)
        select(*levels().values())
        bpy.ops.farfield.billboards_estimate()
        assert "quads" in expected and expected in capfd.readouterr().out
        assert is_hidden(bpy.data.objects["Cube"])

    def test_without_its_original_a_cloud_cannot_be_built(self):
        source = cube()
        build(levels=1)
        bpy.data.objects.remove(source)
        select(*levels().values())
        with pytest.raises(RuntimeError, match='of this cloud its original "Cube" was not found'):
            build()

    def test_undo_takes_one_step(self):
        cube()
        bpy.context.preferences.edit.use_global_undo = True
        build(levels=1)
        bpy.ops.ed.undo_push(message="Build")
        select(*levels().values())
        bpy.ops.ed.undo_push(message="Select")
        build(levels=1)
        bpy.ops.ed.undo_push(message="Build again")
        bpy.ops.ed.undo()
        (level,) = levels().values()
        assert not is_hidden(level) and is_hidden(bpy.data.objects["Cube"])
