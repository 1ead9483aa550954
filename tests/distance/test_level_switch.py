"""Each place shows the level that its distance to the active camera requires, in viewports and renders."""

import bpy
import numpy as np
import pytest

from distance_scenes import DISTANCES, add_box, add_camera, add_scatter, attach_levels, rendered, shown
from farfield.addon.bridge import lod_crossfade
from farfield.addon.bridge.active_camera import follow_viewport
from farfield.addon.core.geometry.cameras import Camera

pytestmark = pytest.mark.usefixtures("empty_scene")


@pytest.fixture
def camera():
    return add_camera()


def level_at(distance: float) -> int:
    return max(number for number, start in enumerate(DISTANCES) if start <= distance)


@pytest.mark.parametrize("scale", [pytest.param(1.0, marks=pytest.mark.exhaustive), 3.0])
def test_an_object_is_the_level_of_its_distance(camera, scale):
    box = add_box("Box")
    box.scale = (scale,) * 3
    attach_levels([box])
    for distance in (5.0, 19.0, 21.5, 49.0, 51.5, 1000.0):
        box.location.y = scale * distance
        assert [name for name, _ in shown()] == [f"Box {level_at(distance)}"] == [name for name, _ in rendered()]


def test_the_level_follows_the_camera_and_its_lens(camera):
    box = add_box("Box", (0.0, 30.0, 0.0))
    attach_levels([box])
    names = []
    for y, angle in ((0.0, 0.5), (0.0, 0.25), (-30.0, 0.5), (25.0, 0.5)):
        camera.location.y, camera.data.angle = y, 2.0 * float(np.arctan(angle))
        names += [name for name, _ in shown()]
    assert names == ["Box 1", "Box 0", "Box 2", "Box 0"]


def test_the_level_follows_an_animated_camera_in_renders(camera):
    attach_levels([add_box("Box", (0.0, 30.0, 0.0))])
    for frame, y in ((1, 25.0), (2, -40.0)):
        camera.location.y = y
        camera.keyframe_insert("location", frame=frame)
    names = []
    for frame in (1, 2):
        bpy.context.scene.frame_set(frame)
        names += [name for name, _ in rendered()]
    assert names == ["Box 0", "Box 2"]


def test_an_orthographic_camera_shows_one_level_at_all_distances(camera):
    camera.data.type, camera.data.ortho_scale = "ORTHO", 30.0  # A pixel is 0.03.
    attach_levels([add_box("Box", (0.0, 5.0, 0.0)), add_box("Far", (0.0, 500.0, 0.0))])
    assert [name for name, _ in shown()] == ["Box 1", "Far 1"]


@pytest.mark.parametrize("way", [pytest.param("separate", marks=pytest.mark.exhaustive), "nested"])
def test_a_scatter_of_two_kinds(camera, way):
    kinds = [add_box("Large", size=0.8, linked=False), add_box("Small", size=0.4, linked=False)]
    points = [(0.0, 10.0 * number, 0.0) for number in range(1, 9)]
    scatter = add_scatter(points, kinds, way)
    chains = attach_levels([scatter])
    assert sorted(chain.name for chain in chains) == ["Large", "Small"]
    expected = []
    for number, (_, y, _) in enumerate(points):
        names = ["Large", "Small"][number % 2 :][:1] if way == "separate" else ["Large", "Small"]
        expected += [(f"{name} {level_at(y - 0.7)}", (0, round(y), 0)) for name in names]
    assert shown() == sorted(expected) == rendered()


def test_a_scatter_of_the_geometry_of_an_object_keeps_its_own_surface(camera):
    kind = add_box("Kind", (3.0, 3.0, 0.0))
    scatter = add_scatter([(0.0, 10.0, 0.0), (1.0, 10.0, 0.0), (0.0, 60.0, 0.0)], [kind], "geometry")
    scatter.data.clear_geometry()
    scatter.data.from_pydata([(0.0, 10.0, 0.0), (1.0, 10.0, 0.0), (0.0, 60.0, 0.0)], [], [(0, 1, 2)])
    join = scatter.modifiers[0].node_group
    node = join.nodes.new("GeometryNodeJoinGeometry")
    join.links.new(next(item for item in join.nodes if item.type == "INSTANCE_ON_POINTS").outputs[0], node.inputs[0])
    join.links.new(next(item for item in join.nodes if item.type == "GROUP_INPUT").outputs[0], node.inputs[0])
    join.links.new(node.outputs[0], next(item for item in join.nodes if item.type == "GROUP_OUTPUT").inputs[0])
    attach_levels([scatter, kind])
    assert [name for name, _ in shown()] == ["Kind 0", "Kind 0", "Kind 2"]
    geometry = scatter.evaluated_get(bpy.context.evaluated_depsgraph_get()).evaluated_geometry()
    assert len(geometry.mesh.polygons) == 1 and not kind.modifiers


def test_mirrored_and_scaled_instances_keep_their_matrices(camera):
    scatter = add_scatter([(0.0, 40.0, 0.0)], [add_box("Box", linked=False)])
    on_points = next(node for node in scatter.modifiers[0].node_group.nodes if node.type == "INSTANCE_ON_POINTS")
    on_points.inputs["Scale"].default_value = (-3.0, 3.0, 3.0)
    on_points.inputs["Rotation"].default_value = (0.3, 0.2, 0.1)
    bpy.context.view_layer.update()

    def matrix() -> np.ndarray:
        (found,) = [np.array(item.matrix_world) for item in bpy.context.evaluated_depsgraph_get().object_instances if item.is_instance]
        return found

    before = matrix()
    attach_levels([scatter])
    assert shown() == [("Box 0", (0, 40, 0))], "the size of three times at a distance of 40 is that of once at 13.3"
    assert np.allclose(matrix(), before, atol=1e-5) and np.linalg.det(before[:3, :3]) < 0.0
    scatter.location.y = 30.0
    assert shown() == [("Box 1", (0, 70, 0))]


def test_what_the_camera_does_not_see_is_coarser_and_never_the_original(camera):
    behind, aside, ahead = add_box("Behind", (0.0, -2.0, 0.0)), add_box("Aside", (30.0, 5.0, 0.0)), add_box("Ahead", (0.0, 5.0, 0.0))
    around = add_box("Around", (0.0, -1.0, 0.0), size=4.0)
    attach_levels([behind, aside, ahead, around])
    assert [name for name, _ in shown()] == ["Ahead 0", "Around 0", "Aside 2", "Behind 1"]
    assert [name for name, _ in rendered()] == ["Ahead 0", "Around 0", "Aside 2", "Behind 1"]


def test_renders_have_both_levels_within_the_fade_range(camera):
    box = add_box("Box")
    attach_levels([box], fade_range=0.2)
    for distance, in_render in ((15.0, [0]), (21.0, [0, 1]), (23.5, [0, 1]), (26.0, [1]), (55.0, [1, 2]), (62.0, [2])):
        box.location.y = distance
        assert [name for name, _ in rendered()] == [f"Box {number}" for number in in_render]
        assert len(shown()) == 1


def test_an_error_of_two_pixels_shows_levels_at_half_the_distance(camera):
    attach_levels([add_box("Box", (0.0, 11.0, 0.0))], max_error=2.0)
    assert shown() == rendered() == [("Box 1", (0, 11, 0))]


def test_only_places_within_the_fade_range_have_materials_that_fade(camera):
    attach_levels([add_scatter([(0.0, y, 0.0) for y in (15.0, 22.0, 35.0, 70.0)], [add_box("Box", linked=False)])], fade_range=0.2)
    expected = [("Box 0", 15), ("Box 0 Fading", 22), ("Box 1", 35), ("Box 1 Fading", 22), ("Box 2", 70)]
    assert [(name, place[1]) for name, place in rendered(named_fading=True)] == expected
    fading, plain = (bpy.data.objects[name].material_slots[0].material for name in ("Box 1 Fading", "Box 1"))
    assert fading != plain and not any(map(lod_crossfade.is_crossfade, plain.node_tree.nodes))
    assert any(map(lod_crossfade.is_crossfade, fading.node_tree.nodes))


def test_without_a_camera_everything_is_the_original():
    attach_levels([add_box("Box", (0.0, 500.0, 0.0))])
    assert [name for name, _ in shown()] == ["Box 0"]


def test_moved_objects_change_their_level(camera):
    box = add_box("Box", (0.0, 5.0, 0.0))
    attach_levels([box])
    parent = bpy.data.objects.new("Parent", None)
    bpy.context.scene.collection.objects.link(parent)
    box.parent, parent.location = parent, (0.0, 20.0, 0.0)
    assert shown() == [("Box 1", (0, 25, 0))]


def test_a_subdivided_kind_is_recognized_where_renders_subdivide_it_more(camera):
    kinds = [add_box("Kind", linked=False), add_box("Other", size=0.8, linked=False)]
    subdivision = kinds[0].modifiers.new("Subdivision", "SUBSURF")
    subdivision.levels, subdivision.render_levels = 1, 3
    attach_levels([add_scatter([(0.0, 60.0, 0.0), (0.0, 61.0, 0.0)], kinds)])
    assert [name for name, _ in shown()] == ["Kind 2", "Other 2"] == [name for name, _ in rendered()]


def test_a_viewport_that_is_followed_shows_its_own_levels_and_renders_those_of_the_camera(camera):
    attach_levels([add_box("Box", (0.0, 60.0, 0.0)), add_box("Behind", (0.0, -30.0, 0.0))])
    before = shown()
    assert [name for name, _ in before] == ["Behind 2", "Box 2"]
    follow_viewport(Camera(np.array([0.0, 50.0, 0.0]), 1000, camera.data.angle))
    assert [name for name, _ in shown()] == ["Behind 2", "Box 0"] and rendered() == before
    follow_viewport(None)
    assert shown() == before
