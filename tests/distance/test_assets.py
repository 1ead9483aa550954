"""What levels are made of, and what stays as it is with which reason."""

import bpy
import numpy as np
import pytest

from distance_scenes import add_box, add_camera, add_scatter, attach_levels, shown
from farfield.addon.bridge.distance.assets import Asset, AssetSearch, visible_objects

pytestmark = pytest.mark.usefixtures("empty_scene")


def find(*objects: bpy.types.Object) -> tuple[list[Asset], list[str]]:
    bpy.context.view_layer.update()
    search = AssetSearch(bpy.context.scene, bpy.context.evaluated_depsgraph_get())
    return search.find(objects or list(bpy.context.scene.objects)), search.skipped


def test_linked_duplicates_are_one_asset():
    box = add_box("Box", (1.0, 2.0, 3.0))
    duplicate = box.copy()
    bpy.context.scene.collection.objects.link(duplicate)
    duplicate.location, duplicate.scale = (4.0, 0.0, 0.0), (-2.0, 2.0, 2.0)
    assets, skipped = find()
    assert [(asset.hosts, asset.triangles) for asset in assets] == [([box, duplicate], 12)] and not skipped
    places = assets[0].places
    assert np.allclose(places.centers, [(1.0, 2.0, 3.0), (4.0, 0.0, 0.0)]) and np.allclose(places.scales, [1.0, 2.0])
    assert np.allclose(places.radii, 0.25 * 3.0**0.5 * places.scales)


def test_duplicates_with_modifiers_or_other_materials_are_assets_of_their_own():
    box = add_box("Box")
    for number in range(2):
        duplicate = box.copy()
        bpy.context.scene.collection.objects.link(duplicate)
        if number:
            duplicate.modifiers.new("Subdivision", "SUBSURF")
        else:
            duplicate.material_slots[0].link = "OBJECT"
            duplicate.material_slots[0].material = bpy.data.materials.new("Other")
    assets, _ = find()
    assert [asset.triangles for asset in assets] == [12, 12, 48]


def test_places_of_a_scatter():
    kinds = [add_box("Large", size=0.8, linked=False), add_box("Small", size=0.4, linked=False)]
    scatter = add_scatter([(0.0, y, 0.0) for y in range(5)], kinds)
    scatter.location = (0.0, 0.0, 7.0)
    assets, skipped = find()
    assert {asset.name: len(asset.matrices) for asset in assets} == {"Large": 3, "Small": 2} and not skipped
    large = next(asset for asset in assets if asset.name == "Large")
    assert np.allclose(large.places.centers, [(0.0, 0.0, 7.0), (0.0, 2.0, 7.0), (0.0, 4.0, 7.0)])
    assert np.allclose((large.low, large.high), ((-0.4,) * 3, (0.4,) * 3))


def test_objects_of_equal_boxes_in_one_scatter_stay():
    kinds = [add_box("First", linked=False), add_box("Second", linked=False)]
    add_scatter([(0.0, 1.0, 0.0), (0.0, 2.0, 0.0)], kinds)
    assets, skipped = find()
    assert not assets and len(skipped) == 2 and "same bounding box" in skipped[0]


def test_a_ground_that_a_scatter_reads_stays():
    ground = add_box("Ground", size=10.0)
    scatter = add_scatter([(0.0, 0.0, 0.0)], [ground], "geometry")
    assets, skipped = find(ground)
    assert not assets and skipped == ["Ground (other objects read its mesh)"]
    scatter.modifiers.clear()
    bpy.data.node_groups.remove(bpy.data.node_groups["Scatter"])
    assert [asset.hosts for asset in find(ground)[0]] == [[ground]]


def test_a_cutter_of_a_boolean_modifier_stays_and_a_child_does_not_matter():
    cutter, box, child = add_box("Cutter", (0.2, 0.2, 0.2)), add_box("Box"), add_box("Child")
    box.modifiers.new("Boolean", "BOOLEAN").object = cutter
    child.parent = box
    child.modifiers.new("Subdivision", "SUBSURF")
    assets, skipped = find()
    assert {asset.name for asset in assets} == {"Box", "Child"} and skipped == ["Cutter (other objects read its mesh)"]


@pytest.mark.parametrize("kind", ["ARMATURE", "CLOTH", "COLLISION", "OCEAN"])
def test_what_moves_within_itself_stays(kind):
    add_box("Box").modifiers.new("Moves", kind)
    assert find() == ([], ['Box (its modifier "Moves" needs the mesh)'])


def test_an_instanced_object_stays_where_it_is_itself():
    kind = add_box("Kind")
    scatter = add_scatter([(0.0, 1.0, 0.0)], [kind])
    assets, skipped = find()
    assert [asset.scatterers for asset in assets] == [[scatter]] and skipped == ["Kind (it is instanced elsewhere)"]


def test_a_scatter_with_lights_stays():
    light = bpy.data.objects.new("Light", bpy.data.lights.new("Light", "POINT"))
    add_scatter([(0.0, 1.0, 0.0), (0.0, 2.0, 0.0)], [add_box("Box", linked=False), light])
    assert find() == ([], ["Box in Scatter (it also instances lights, cameras or volumes)"])


def test_levels_are_no_assets():
    add_camera()
    box = add_box("Box", (0.0, 5.0, 0.0))
    attach_levels([box])
    assert [name for name, _ in shown()] == ["Box 0"]
    proxy = next(iter(bpy.data.collections["Box Distance 0"].objects))
    assert find(proxy) == ([], ["Box 0 (made by Farfield)"])


def test_the_selection_counts_or_everything_visible():
    scene, view_layer = bpy.context.scene, bpy.context.view_layer
    camera, first, second, hidden = add_camera(), add_box("First"), add_box("Second"), add_box("Hidden")
    hidden.hide_render = True
    view_layer.update()
    assert visible_objects(scene, view_layer, [camera]) == [first, second]
    assert visible_objects(scene, view_layer, [camera, second]) == [second]
