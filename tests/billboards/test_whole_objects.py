"""Several objects as one cloud: a house of parts, instances and collections."""

import bpy
import numpy as np
import pytest

import billboards
from bridge import blender_scenes
from bridge.instance_scenes import scatter, shining
from bridge.operator_scenes import build, cube, is_hidden, levels, link_from_library, select
from farfield.addon.bridge.billboards import source_objects
from farfield.addon.bridge.billboards.scene_clouds import clouds_in
from farfield.addon.core.billboards.settings import BillboardSettings, BuildOptions
from farfield.addon.core.errors import GeometryError
from farfield.addon.operators import properties
from farfield.addon.operators.billboards import estimates
from farfield.addon.operators.billboards.sources import describe_selection

pytestmark = pytest.mark.usefixtures("empty_scene")


def combine(**arguments):
    """Build one cloud of the selection, and return it."""
    build(**({"levels": 1, "combine_selected": True} | arguments))
    return clouds_in(bpy.context.scene)[-1]


def empty(name, location=(0.0, 0.0, 0.0), parent=None):
    """Add an Empty."""
    item = bpy.data.objects.new(name, None)
    item.location, item.parent = location, parent
    bpy.context.scene.collection.objects.link(item)
    return item


def collect(name, *objects):
    """Move objects to a new collection of the scene."""
    collection = blender_scenes.collect(*objects, name=name)
    bpy.context.scene.collection.children.link(collection)
    return collection


def colored(item, color):
    """Give an object a material of its own."""
    item.data.materials.append(blender_scenes.create_material(item.name, color))
    return item


def place(cloud):
    """Return the name of the cloud and the location of its finest level."""
    return cloud.collection.name, tuple(cloud.levels[0].location)


class TestNameAndOrigin:
    """The cloud has the name and the origin that a user would give it."""

    @pytest.fixture
    def parts(self):
        return [cube(name, location=(4.0 * index, 1.0, 0.0)) for index, name in enumerate(("Door", "Roof", "Wall"))]

    def test_of_the_nearest_common_parent(self, parts):
        house = empty("House", (2.0, 0.0, -1.0), empty("Street", (0.0, 0.0, 0.5)))
        floor = empty("Floor", (0.0, 5.0, 0.0), house)
        for item, parent in zip(parts, (house, floor, floor), strict=True):
            item.parent = parent
        select(*parts)
        assert place(combine()) == ("House Cloud", (2.0, 0.0, -0.5))

    def test_of_a_part_that_is_the_parent_of_all_others(self, parts):
        parts[0].parent = parts[2].parent = parts[1]
        select(*parts)
        assert place(combine()) == ("Roof Cloud", (4.0, 1.0, 0.0))

    def test_of_the_active_object_otherwise(self, parts):
        select(*parts)
        bpy.context.view_layer.objects.active = parts[2]
        assert place(combine()) == ("Wall Cloud", (8.0, 1.0, 0.0))

    def test_name_of_the_smallest_collection_of_which_they_are_all(self, parts):
        hidden, light = cube("Hidden"), empty("Light")
        hidden.hide_set(True)
        house = collect("House", *parts, hidden, light)
        town = collect("Town", cube("Church"))
        bpy.context.scene.collection.children.unlink(house)
        town.children.link(house)
        select(parts[1], parts[0], parts[2])
        assert place(combine(keep_original_visible=True)) == ("House Cloud", (4.0, 1.0, 0.0))
        select(parts[0], parts[1])
        assert place(combine()) == ("Door Cloud", (0.0, 1.0, 0.0))

    @pytest.mark.parametrize("name", ["Collection", "Collection 2", "Collection.001"])
    def test_collections_that_have_no_name_of_the_user_do_not_count(self, parts, name):
        collect(name, *parts)
        select(parts[1], parts[0], parts[2])
        assert "Collection" not in place(combine())[0]

    def test_of_a_single_object_are_its_own(self, parts):
        collect("House", parts[0])
        parts[0].parent = empty("Root", (1.0, 1.0, 1.0))
        select(parts[0], empty("Other"))
        assert place(combine()) == ("Door Cloud", (1.0, 2.0, 1.0))

    def test_are_the_same_when_it_is_built_again(self, parts):
        select(*parts)
        bpy.context.view_layer.objects.active = parts[2]
        first = combine()
        select(first.levels[0])
        build(levels=1)
        again = clouds_in(bpy.context.scene)[-1]
        assert place(again) == ("Wall Cloud.001", (8.0, 1.0, 0.0))
        assert {item.name for item in again.sources} == {"Door", "Roof", "Wall"}


class TestHouse:
    """Parts with transforms, modifiers and materials of their own, and objects that are no parts."""

    @pytest.fixture
    def house(self, tmp_path):
        """Select a house: two walls, one mirrored, a fence from a modifier, a text, an instance of a collection, a linked part, a hidden
        part, a camera and a light."""
        linked = link_from_library(tmp_path / "part.blend", "Linked")
        red = colored(cube("Red", location=(-6.0, 0.0, 0.0), rotation=(0.0, 0.0, 0.4)), (0.8, 0.0, 0.0))
        green = colored(cube("Green", location=(6.0, 0.0, 0.0)), (0.0, 0.6, 0.0))
        green.scale = (-1.0, 2.0, 1.0)
        fence = cube("Fence", location=(0.0, -6.0, 0.0))
        fence.scale = (0.2, 0.2, 0.5)
        fence.modifiers.new("Array", "ARRAY").count = 3
        bpy.ops.object.text_add(location=(0.0, 6.0, 2.0))
        text = bpy.context.object
        asset = bpy.data.collections.new("Asset")
        part = colored(cube("Blue"), (0.0, 0.0, 0.7))
        bpy.context.collection.objects.unlink(part)
        asset.objects.link(part)
        instance = empty("Instance", (0.0, 12.0, 0.0))
        instance.instance_type, instance.instance_collection = "COLLECTION", asset
        bpy.ops.object.camera_add()
        camera = bpy.context.object
        bpy.ops.object.light_add()
        light = bpy.context.object
        hidden = cube("Hidden", location=(0.0, 0.0, 40.0))
        parts = [red, green, fence, text, instance, linked]
        select(*parts, camera, light, hidden)
        hidden.hide_set(True)
        return parts

    @pytest.mark.slow
    def test_is_one_cloud_with_the_materials_of_all_parts(self, house, capfd):
        assert describe_selection(bpy.context, True) == "One cloud of 6 objects. 2 objects without a surface."
        assert describe_selection(bpy.context, False) == "6 clouds, one per object. 2 objects without a surface."
        before = {item: tuple(map(tuple, item.matrix_world)) for item in house}
        cloud = combine(textures=True, samples=1, error=2.0)
        output = capfd.readouterr().out
        assert "Camera (a camera has no faces)" in output and "Point (a light has no faces)" in output
        assert "Visibility unchanged, linked from a library: Linked." in output
        assert len(clouds_in(bpy.context.scene)) == 1 and set(cloud.sources) == set(house)
        assert [is_hidden(item) for item in house] == [True] * 5 + [False]
        assert {item: tuple(map(tuple, item.matrix_world)) for item in house} == before
        (level,) = cloud.levels
        corners = np.array([level.matrix_world @ vertex.co for vertex in level.data.vertices])
        assert corners[:, 2].max() < 5.0, "the hidden part is no part"
        assert corners[:, :2].min(axis=0) == pytest.approx([-7.3, -6.2], abs=0.3)
        assert corners[:, :2].max(axis=0) == pytest.approx([7.0, 13.0], abs=0.3)
        image = next(node.image for node in level.data.materials[0].node_tree.nodes if node.label == "Front color")
        texels = np.array(image.pixels).reshape(-1, 4)
        texels = texels[texels[:, 3] > 0.99, :3]
        for channel in range(3):
            others = [index for index in range(3) if index != channel]
            assert ((texels[:, channel] > 0.5) & (texels[:, others].max(axis=1) < 0.1)).any()

    def test_shows_all_parts_or_the_cloud(self, house):
        cloud = combine()
        bpy.ops.farfield.billboards_show()
        assert [is_hidden(item) for item in (*house, cloud.levels[0])] == [False] * 6 + [True]
        bpy.ops.farfield.billboards_show()
        assert [is_hidden(item) for item in (*house, cloud.levels[0])] == [True] * 5 + [False] * 2

    def test_all_originals_are_selected_when_they_are_shown(self, house):
        cloud = combine()
        select(cloud.levels[0])
        bpy.ops.farfield.billboards_show(show="SOURCE")
        assert set(bpy.context.selected_objects) == set(cloud.sources) == set(house)
        assert bpy.context.active_object == cloud.sources[0]

    def test_undo_takes_one_step(self, house):
        bpy.context.preferences.edit.use_global_undo = True
        bpy.ops.ed.undo_push(message="House")
        combine()
        bpy.ops.ed.undo_push(message="Build")
        bpy.ops.ed.undo()
        assert not levels() and not any(is_hidden(bpy.data.objects[name]) for name in ("Red", "Green", "Fence", "Instance"))

    def test_cross_fade_has_a_proxy_per_part(self, house):
        bpy.context.scene.camera = next(item for item in bpy.data.objects if item.type == "CAMERA")
        cloud = combine()
        bpy.ops.farfield.billboards_crossfade()
        assert len(source_objects.find_source_proxies(cloud.collection)) == 6


def test_proxies_of_instances_keep_the_attributes_of_instances():
    card = cube("Card")
    card.data.materials.append(shining())
    row = scatter("Row", card)
    row["tint"] = (9.0, 9.0, 9.0)
    collection = bpy.data.collections.new("Proxies")
    bpy.context.scene.collection.children.link(collection)
    bpy.context.view_layer.update()
    source_objects.add_source_proxies([row], collection, bpy.context.evaluated_depsgraph_get())
    proxies = [item for item in source_objects.find_source_proxies(collection) if len(item.data.polygons)]
    reds = sorted(item["tint"][0] for item in proxies)
    assert reds == pytest.approx([0.0, 0.25, 0.5, 0.75])


class TestEstimate:
    """The panel says what a build of the selection makes, and estimates that."""

    def key(self):
        return estimates.estimate_key(bpy.context, properties.read(BillboardSettings, bpy.context.scene.farfield_billboards))

    def test_nothing_is_said_about_a_single_object(self):
        select(cube())
        assert describe_selection(bpy.context, False) == ""
        build(levels=1)
        select(*levels().values())
        assert describe_selection(bpy.context, False) == ""

    def test_selected_clouds_count(self):
        cube("One")
        build(levels=1)
        select(*levels().values(), cube("Two", location=(5.0, 0.0, 0.0)))
        assert describe_selection(bpy.context, False) == "2 clouds, one per object."

    @pytest.mark.slow
    def test_it_takes_the_same_setting_as_the_build(self):
        group = bpy.context.scene.farfield_billboards
        group.levels = 1
        select(cube("One"), cube("Two", location=(40.0, 0.0, 0.0)))
        quads = []
        for group.combine_selected in (False, True):
            bpy.ops.farfield.billboards_estimate()
            quads.append(estimates.cache.find(self.key()).levels[0].error)
        assert quads == pytest.approx([0.02, 0.42])

    def test_many_clouds_are_estimated_on_request_only(self):
        select(*(cube(f"Part {index}", location=(3.0 * index, 0.0, 0.0)) for index in range(estimates.MAX_AUTOMATIC_CLOUDS + 1)))
        assert not estimates.cache.request(self.key())
        bpy.context.scene.farfield_billboards.combine_selected = True
        assert estimates.cache.request(self.key())
        estimates.cache.clear()

    def test_collections_count_with_their_faces(self, monkeypatch):
        asset = bpy.data.collections.new("Asset")
        asset.objects.link(cube())
        instance = empty("Instance")
        instance.instance_type, instance.instance_collection = "COLLECTION", asset
        select(instance)
        key = self.key()
        assert key.objects[0][:3] == ("Instance", 8, 6)
        monkeypatch.setattr(estimates, "MAX_AUTOMATIC_FACES", 5)
        assert not estimates.cache.request(key)


class TestCollectionOfScript:
    """`--collection` of the script."""

    OPTIONS = BuildOptions(combine_selected=True)

    @pytest.fixture
    def street(self):
        inner = collect("Inner", cube("Chimney", location=(0.0, 0.0, 3.0)))
        house = collect("House", cube("Wall"), cube("Window", location=(3.0, 0.0, 0.0)), empty("Root"))
        bpy.context.scene.collection.children.unlink(inner)
        house.children.link(inner)
        bpy.data.objects["Window"].hide_render = True
        collect("Trees", cube("Tree", location=(20.0, 0.0, 0.0)))
        collect("Nothing", empty("Alone"))

    def test_its_objects_become_one_cloud_with_its_name(self, street):
        job = billboards.prepare_input(None, BillboardSettings(), self.OPTIONS, "House")
        (source,) = job.sources
        assert source.name == "House" and {instance.name for instance in source.instances} == {"Wall", "Chimney"}
        assert job.skipped == ["Window (disabled in renders)"]

    def test_all_objects_have_the_name_of_the_file(self, street, tmp_path):
        (source,) = billboards.prepare_input(tmp_path / "street.blend", BillboardSettings(), self.OPTIONS).sources
        assert source.name == "street" and len(source.instances) == 3

    def test_a_single_object_keeps_its_name(self, street):
        (source,) = billboards.prepare_input(None, BillboardSettings(), self.OPTIONS, "Trees").sources
        assert source.name == "Tree"

    @pytest.mark.parametrize("name, message", [("Hosue", "it has House, Inner, Trees, Nothing. Correct"), ("Nothing", "has a surface")])
    def test_what_is_wrong_is_said(self, street, name, message):
        with pytest.raises(GeometryError, match=message):
            billboards.prepare_input(None, BillboardSettings(), self.OPTIONS, name)
