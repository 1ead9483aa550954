"""Operators in scenes where something is missing: each works, or says in one sentence why not and changes nothing."""

import bpy
import pytest

from bridge import blender_scenes
from bridge.operator_scenes import build, cube, is_hidden, levels, select
from farfield.addon.bridge import lod_crossfade
from farfield.addon.bridge.billboards import source_objects
from farfield.addon.bridge.billboards.scene_clouds import clouds_in, find_cloud
from farfield.addon.panels import billboards as panels

pytestmark = pytest.mark.usefixtures("empty_scene")


@pytest.fixture
def camera(empty_scene):
    """The active camera, from which an original would be shown."""
    item = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    empty_scene.collection.objects.link(item)
    item.location.z = 5.0
    empty_scene.camera = item
    return item


def move_to_collection(item, name):
    """Move `item` to a new collection of the scene, and return this collection's entry in the view layer."""
    collection = bpy.data.collections.new(name)
    bpy.context.scene.collection.children.link(collection)
    for old in item.users_collection:
        old.objects.unlink(item)
    collection.objects.link(item)
    return bpy.context.view_layer.layer_collection.children[name]


class TestExcludedOriginal:
    """The collection of the original is excluded from the view layer."""

    @pytest.fixture
    def source(self, camera):
        """The original, whose cloud is shown."""
        source = cube()
        entry = move_to_collection(source, "Originals")
        select(source)
        build(error=1.0)
        entry.exclude = True
        select(levels()["Cube Cloud L0"])
        return source

    def test_cross_fade_shows_the_finest_level_up_to_the_camera(self, source, capfd):
        assert bpy.ops.farfield.billboards_crossfade() == {"FINISHED"}
        (cloud,) = clouds_in(bpy.context.scene)
        assert not source_objects.find_source_proxies(cloud.collection)
        assert cloud.levels[0][lod_crossfade.CROSSFADE][0] == 0.0
        assert "Not in the view layer: Cube." in capfd.readouterr().out

    def test_cross_fade_of_an_original_in_a_hidden_collection(self, source):
        bpy.context.view_layer.layer_collection.children["Originals"].exclude = False
        bpy.data.collections["Originals"].hide_viewport = True
        assert bpy.ops.farfield.billboards_crossfade() == {"FINISHED"}
        assert clouds_in(bpy.context.scene)[0].levels[0][lod_crossfade.CROSSFADE][0] == 0.0

    def test_show_level_keeps_a_level_visible(self, source, capfd):
        assert bpy.ops.farfield.billboards_show_level() == {"FINISHED"}
        assert not is_hidden(levels()["Cube Cloud L0"])
        assert "Not in the view layer: Cube." in capfd.readouterr().out

    def test_show_original_changes_nothing(self, source, capfd):
        assert bpy.ops.farfield.billboards_show(show="SOURCE") == {"CANCELLED"}
        assert is_hidden(source) and not is_hidden(levels()["Cube Cloud L0"])
        assert "Nothing changed. Not in the view layer: Cube." in capfd.readouterr().out

    def test_build_says_what_is_missing(self, source):
        with pytest.raises(RuntimeError, match="Cube is not in the view layer; include its collection"):
            build()
        assert len(levels()) == 2


class TestExcludedCloud:
    """The collection of the cloud is excluded from the view layer, its original is active."""

    @pytest.fixture
    def source(self, camera):
        """The original."""
        source = cube()
        build(error=1.0)
        bpy.ops.farfield.billboards_show(show="SOURCE")
        bpy.context.view_layer.layer_collection.children["Cube Cloud"].exclude = True
        select(source)
        return source

    def test_show_cloud_changes_nothing(self, source, capfd):
        assert bpy.ops.farfield.billboards_show(show="CLOUD") == {"CANCELLED"}
        assert not is_hidden(source)
        assert 'Not in the view layer: "Cube Cloud".' in capfd.readouterr().out

    @pytest.mark.parametrize("operator", ["billboards_show_level", "billboards_crossfade"])
    def test_operators_for_the_camera_finish(self, source, camera, operator, capfd):
        camera.location.z = 1000.0
        assert getattr(bpy.ops.farfield, operator)() == {"FINISHED"}
        assert 'Not in the view layer: "Cube Cloud".' in capfd.readouterr().out


class TestRemovedParts:
    """Somebody has removed a part of the cloud."""

    def test_removed_material_slots(self, camera):
        cube()
        build(textures=True, samples=1, error=10.0)
        for level in levels().values():
            level.data.materials.clear()
        cloud = find_cloud(bpy.context.scene, levels()["Cube Cloud L0"])
        assert cloud.texture_bytes(0) == 0
        for operator in (bpy.ops.farfield.billboards_crossfade, bpy.ops.farfield.billboards_show_level, bpy.ops.farfield.billboards_show):
            assert operator() == {"FINISHED"}

    def test_removed_quads(self, camera):
        cube()
        build()
        for level in levels().values():
            level.data.clear_geometry()
        for operator in (bpy.ops.farfield.billboards_crossfade, bpy.ops.farfield.billboards_show_level):
            assert operator() == {"FINISHED"}

    @pytest.mark.parametrize("value", [None, "a", float("nan")])
    def test_a_level_without_its_numbers_is_not_a_level(self, value):
        cube()
        build()
        fine, coarse = levels().values()
        for name in ("farfield_level", "farfield_error", "farfield_quads", "farfield_texels"):
            value_before = fine.pop(name)
            if value is not None:
                fine[name] = value
            assert find_cloud(bpy.context.scene, coarse).levels == [coarse], name
            assert find_cloud(bpy.context.scene, fine) is None, name
            select(fine)
            assert not bpy.ops.farfield.billboards_build.poll() and not bpy.ops.farfield.billboards_show.poll(), name
            assert not panels.FARFIELD_PT_billboards_levels.poll(bpy.context), name
            fine[name] = value_before
            assert find_cloud(bpy.context.scene, fine).levels == [fine, coarse]

    def test_an_empty_called_a_cloud(self):
        empty = bpy.data.objects.new("Empty", None)
        bpy.context.collection.objects.link(empty)
        empty["farfield_kind"] = "cloud"
        select(empty)
        assert not bpy.ops.farfield.billboards_build.poll() and not bpy.ops.farfield.billboards_show.poll()


@pytest.fixture(scope="module")
def library(extension, tmp_path_factory):
    """A file with a cloud."""
    blender_scenes.reset_scene()
    cube()
    build(textures=True, samples=1, error=10.0)
    path = tmp_path_factory.mktemp("linked") / "library.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    return path


class TestLinkedCloud:
    """The cloud comes from a library: what is changed is not saved with the file."""

    @pytest.fixture
    def linked(self, library):
        """The linked collection of the cloud in a scene with a camera."""
        scene = blender_scenes.reset_scene()
        scene.camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
        scene.collection.objects.link(scene.camera)
        with bpy.data.libraries.load(str(library), link=True) as (_, target):
            target.collections = ["Cube Cloud"]
        scene.collection.children.link(target.collections[0])
        return target.collections[0]

    @staticmethod
    def states():
        """Return the visibility of all objects and collections, and the number of data-blocks."""
        holders = [*bpy.data.objects, *bpy.data.collections]
        return [(item.name, item.hide_viewport, item.hide_render) for item in holders], blender_scenes.count_data()

    def test_operators_change_nothing(self, linked, capfd):
        select(linked.objects[0])
        before = self.states()
        with pytest.raises(RuntimeError, match="linked from a library; make it local"):
            bpy.ops.farfield.billboards_show()
        for operator in (bpy.ops.farfield.billboards_crossfade, bpy.ops.farfield.billboards_show_level):
            assert operator() == {"CANCELLED"}
            assert 'Nothing changed. Unchanged, linked from a library: "Cube Cloud"' in capfd.readouterr().out
        assert self.states() == before

    def test_an_instance_of_the_collection(self, linked):
        bpy.context.scene.collection.children.unlink(linked)
        instance = bpy.data.objects.new("Instance", None)
        instance.instance_type, instance.instance_collection = "COLLECTION", linked
        bpy.context.collection.objects.link(instance)
        select(instance)
        for operator in ("show", "crossfade", "show_level"):
            assert not getattr(bpy.ops.farfield, f"billboards_{operator}").poll()

    def test_a_library_override_is_shown_but_not_cross_faded(self, linked, capfd):
        override = linked.override_hierarchy_create(bpy.context.scene, bpy.context.view_layer)
        before = blender_scenes.count_data()
        assert bpy.ops.farfield.billboards_crossfade() == {"CANCELLED"}
        assert blender_scenes.count_data() == before
        assert "make local copies first" in capfd.readouterr().out
        bpy.context.scene.camera.location.z = 1e6
        assert bpy.ops.farfield.billboards_show_level() == {"FINISHED"}
        assert [level.hide_render for level in sorted(override.objects, key=lambda item: item["farfield_level"])] == [True, False]

    def test_local_clouds_beside_a_linked_one_are_changed(self, linked, capfd):
        cube("Local")
        build(levels=1)
        bpy.context.scene.camera.location.z = 1000.0
        assert bpy.ops.farfield.billboards_crossfade() == {"FINISHED"}
        assert [cloud.has_crossfade for cloud in clouds_in(bpy.context.scene)] == [False, True]
        assert 'Unchanged, linked from a library: "Cube Cloud"' in capfd.readouterr().out


def test_nothing_is_built_in_a_linked_scene(tmp_path):
    cube()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "scene.blend"))
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    with bpy.data.libraries.load(str(tmp_path / "scene.blend"), link=True) as (_, target):
        target.scenes = ["Scene"]
    with bpy.context.temp_override(scene=target.scenes[0], selected_objects=list(target.scenes[0].objects)):
        assert not bpy.ops.farfield.billboards_build.poll()


def test_an_asset_is_built_like_any_object():
    source = cube()
    source.asset_mark()
    assert build(levels=1) == {"FINISHED"} and is_hidden(source)


def test_uv_maps_may_have_names_of_internal_attributes():
    source = cube()
    source.data.uv_layers[0].name = "../hidden"
    select(source)
    build(error=1.0)
    assert levels()
