"""The operator as scripts and other add-ons call it: what it makes, what it refuses, and that it changes nothing else."""

import json
import math

import bpy
import numpy as np
import pytest

from farfield.addon.bridge import stretch_pictures, uv_maps
from farfield.addon.core.progress import finish
from farfield.addon.core.unwrap.overlaps import overlap_count
from farfield.addon.core.unwrap.plane import signed_areas

pytestmark = pytest.mark.usefixtures("empty_scene")
SQUARE = [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (1.0, 1.0, 0.0), (0.0, 1.0, 0.0)]


def add(name, vertices, faces, edges=()):
    """A selected mesh object, the active one."""
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(vertices, edges, faces)
    return added(bpy.data.objects.new(name, mesh))


def added(item):
    bpy.context.collection.objects.link(item)
    bpy.context.view_layer.update()
    item.select_set(True)
    bpy.context.view_layer.objects.active = item
    return item


def ball(segments=16, rings=8, **how):
    """A ball of quads and triangles, selected."""
    bpy.ops.mesh.primitive_uv_sphere_add(segments=segments, ring_count=rings, calc_uvs=False, **how)
    return bpy.context.object


def unwrap(**given):
    return bpy.ops.farfield.unwrap(**given)


def refusal(**given):
    with pytest.raises(RuntimeError) as caught:
        unwrap(**given)
    return str(caught.value)


def corners_of(item, uv_map="Unwrap"):
    """Corners (T, 3, 2) of the triangles that Blender draws, and their polygons."""
    mesh = item.data
    loops, polygons = uv_maps.drawn_triangles(mesh)
    values = np.empty(2 * len(mesh.loops), np.float32)
    mesh.uv_layers[uv_map].uv.foreach_get("vector", values)
    return values.reshape(-1, 2)[loops].astype(np.float64), polygons


def assert_is_sound(item):
    corners, _ = corners_of(item)
    assert np.isfinite(corners).all() and corners.min() >= 0.0 and corners.max() <= 1.0
    assert signed_areas(corners).min() > 0.0
    assert finish(overlap_count(corners)) == 0


def test_a_ball_is_unwrapped_into_a_map_of_its_own():
    item = ball()
    item.data.uv_layers.new(name="Old")
    assert unwrap() == {"FINISHED"}
    assert [layer.name for layer in item.data.uv_layers] == ["Old", "Unwrap"]
    assert item.data.uv_layers.active.name == "Unwrap"
    assert_is_sound(item)
    figures = uv_maps.figures_of(item.data)
    assert figures["flips"] == figures["overlaps"] == 0 and 1.0 < figures["l2"] < 1.3
    assert json.loads(json.dumps(figures))["densities"] == pytest.approx([1.0, 0.0, 0.0, 0.0])
    shown = [each.value for each in item.data.attributes[uv_maps.STRETCH].data]
    assert max(shown) == pytest.approx(figures["linf"], rel=1e-3)


def test_faces_of_many_corners_stay_whole():
    item = add("House", [*SQUARE, (0.5, 1.6, 0.0), (0.5, 0.5, 1.0)], [(0, 1, 2, 4, 3), (1, 0, 5)])
    unwrap()
    assert_is_sound(item)


def test_unwrapping_again_writes_into_the_same_map():
    item = ball()
    unwrap()
    first, _ = corners_of(item)
    unwrap()
    assert len(item.data.uv_layers) == 1
    assert np.array_equal(first, corners_of(item)[0])


def test_seams_are_followed():
    bpy.ops.mesh.primitive_cube_add(calc_uvs=False)
    cube = bpy.context.object
    for edge in cube.data.edges:
        edge.use_seam = True
    unwrap()
    assert_is_sound(cube)
    assert uv_maps.figures_of(cube.data)["l2"] == pytest.approx(1.0, abs=1e-4)


def test_every_selected_mesh_is_unwrapped_once():
    first, second = ball(), ball(location=(5.0, 0.0, 0.0))
    twin = added(bpy.data.objects.new("Twin", second.data))
    for item in (first, second, twin):
        item.select_set(True)
    unwrap()
    assert_is_sound(first)
    assert_is_sound(second)


def test_scale_counts_and_mirroring_flips_nothing():
    item = ball(scale=(-1.0, 3.0, 1.0))
    unwrap(importance="direction", direction=(0.0, 0.0, 1.0), density_ratio=2.0)
    assert_is_sound(item)
    corners, polygons = corners_of(item)
    up = np.array([face.normal.z > 0.1 for face in item.data.polygons])[polygons]
    down = np.array([face.normal.z < -0.1 for face in item.data.polygons])[polygons]
    assert signed_areas(corners)[up].sum() > 1.4 * signed_areas(corners)[down].sum()


def test_in_edit_mode_selected_faces_alone_are_laid_out_anew():
    item = ball()
    unwrap()
    before, polygons = corners_of(item)
    top = np.array([face.center.z > 0.1 for face in item.data.polygons])
    item.data.polygons.foreach_set("select", top)
    bpy.context.tool_settings.mesh_select_mode = (False, False, True)
    bpy.ops.object.mode_set(mode="EDIT")
    assert unwrap() == {"FINISHED"}
    assert item.mode == "EDIT"
    bpy.ops.object.mode_set(mode="OBJECT")
    after, _ = corners_of(item)
    changed = (before != after).any(axis=(1, 2))
    assert changed[top[polygons]].all() and not changed[~top[polygons]].any()


def test_a_painted_group_gets_the_texels():
    item = ball(segments=32, rings=16)
    group = item.vertex_groups.new(name="Face")
    group.add([vertex.index for vertex in item.data.vertices if vertex.co.x > 0.0], 1.0, "REPLACE")
    unwrap(importance="group", density_ratio=3.0)
    assert uv_maps.figures_of(item.data)["density_ratio"] == pytest.approx(3.0, rel=0.1)


@pytest.mark.parametrize("importance", ["camera", "cameras"])
def test_what_the_camera_sees_gets_the_texels(importance):
    item = ball(segments=32, rings=16)
    bpy.ops.object.camera_add(location=(0.0, 0.0, 8.0), rotation=(0.0, 0.0, 0.0))
    bpy.context.scene.camera = bpy.context.object
    item.select_set(True)
    unwrap(importance=importance, density_ratio=4.0)
    corners, polygons = corners_of(item)
    height = np.array([face.center.z for face in item.data.polygons])[polygons]
    areas = signed_areas(corners)
    assert areas[height > 0.5].sum() > 2.0 * areas[height < -0.5].sum()
    assert_is_sound(item)


@pytest.mark.parametrize("rendered", [True, False])
def test_what_other_objects_hide_from_the_camera_matters_less(rendered):
    bpy.ops.mesh.primitive_plane_add(size=4.0, location=(2.0, 0.0, 3.0))
    bpy.context.object.hide_render = not rendered
    bpy.ops.object.camera_add(location=(0.0, 0.0, 8.0), rotation=(0.0, 0.0, 0.0))
    bpy.context.scene.camera = bpy.context.object
    bpy.ops.object.select_all(action="DESELECT")
    bpy.ops.mesh.primitive_grid_add(x_subdivisions=16, y_subdivisions=16, calc_uvs=False)
    item = bpy.context.object
    unwrap(importance="camera", density_ratio=4.0)
    corners, polygons = corners_of(item)
    across = np.array([face.center.x for face in item.data.polygons])[polygons]
    areas = signed_areas(corners)
    ratio = areas[across < -0.2].sum() / areas[across > 0.2].sum()
    assert ratio > 2.0 if rendered else ratio == pytest.approx(1.0, abs=0.05)


def test_without_a_camera_it_says_so():
    ball()
    assert "no camera" in refusal(importance="camera")


def test_a_panoramic_camera_is_refused():
    item = ball()
    bpy.ops.object.camera_add()
    bpy.context.scene.camera = bpy.context.object
    bpy.context.object.data.type = "PANO"
    item.select_set(True)
    assert "panoramic" in refusal(importance="camera")


def test_a_direction_without_length_is_refused():
    ball()
    assert "no length" in refusal(importance="direction", direction=(0.0, 0.0, 0.0))


def test_a_missing_group_is_named():
    ball()
    assert '"Ears"' in refusal(importance="group", group="Ears")
    assert "no vertex group" in refusal(importance="group")


def test_a_map_with_pins_is_left_alone():
    item = ball()
    unwrap()
    before, _ = corners_of(item)
    item.data.attributes.new(uv_maps.PINS + "Unwrap", "BOOLEAN", "CORNER").data[3].value = True
    assert "pinned" in refusal()
    assert np.array_equal(before, corners_of(item)[0])
    assert unwrap(uv_map="Another") == {"FINISHED"}


def test_a_linked_mesh_is_left_alone(tmp_path):
    item = ball()
    path = tmp_path / "büste.blend"
    bpy.data.libraries.write(str(path), {item})
    name = item.name
    bpy.ops.wm.read_factory_settings(use_empty=True)
    with bpy.data.libraries.load(str(path), link=True) as (_, linked):
        linked.objects = [name]
    added(linked.objects[0])
    assert "linked" in refusal()


def test_a_full_mesh_and_a_name_in_use_are_refused():
    item = ball()
    for number in range(8):
        item.data.uv_layers.new(name=f"Map {number}")
    assert "eight" in refusal()
    assert unwrap(uv_map="Map 3") == {"FINISHED"}
    item.data.uv_layers.remove(item.data.uv_layers[0])
    item.data.attributes.new("Wear", "FLOAT", "POINT")
    assert '"Wear"' in refusal(uv_map="Wear")


def test_what_has_no_faces_is_refused_by_name():
    add("Dots", SQUARE, [])
    assert "Dots" in refusal()
    bpy.ops.object.light_add()
    assert "Select a mesh" in refusal()


def test_in_edit_mode_without_a_selection_it_says_so():
    ball()
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.select_all(action="DESELECT")
    assert "selected faces" in refusal()
    bpy.ops.object.mode_set(mode="OBJECT")


@pytest.mark.parametrize("chart", ["one", "atlas"])
def test_all_that_may_be_wrong_with_a_mesh_at_once(chart):
    """Loose parts, a third face at an edge, faces that touch in a vertex, no area, needles, a lone vertex, the other way round."""
    vertices = [*SQUARE, (0.5, 0.5, 1.0), (-1.0, -1.0, 0.0), (-1.0, 0.0, 0.0), (9.0, 9.0, 9.0)]
    vertices += [(5.0, 0.0, 0.0), (6.0, 0.0, 0.0), (7.0, 0.0, 0.0), (5.0, 3.0, 0.0), (6.0, 3.0, 0.0), (5.5, 3.0 + 1e-7, 0.0)]
    faces = [(0, 1, 2), (0, 3, 2), (0, 2, 4), (0, 5, 6), (8, 9, 10), (11, 12, 13)]
    item = add("Ruin", vertices, faces)
    assert unwrap(chart=chart) == {"FINISHED"}
    corners, _ = corners_of(item)
    assert np.isfinite(corners).all() and signed_areas(corners).min() >= 0.0
    assert finish(overlap_count(corners)) == 0


def test_coordinates_that_are_no_numbers_are_refused():
    item = add("Broken", [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)], [(0, 1, 2)])
    item.data.vertices[1].co.x = math.nan
    assert "not finite" in refusal()
    assert not item.data.uv_layers


def test_an_atlas_hardly_stretches():
    item = ball(segments=32, rings=16)
    unwrap(chart="atlas")
    assert uv_maps.figures_of(item.data)["l2"] < 1.05
    assert_is_sound(item)


def test_undo_takes_it_back_in_one_step():
    bpy.ops.ed.undo_push(message="before")
    item = ball()
    bpy.ops.ed.undo_push(message="ball")
    unwrap()
    bpy.ops.ed.undo_push(message="unwrapped")
    name = item.name
    bpy.ops.ed.undo()
    mesh = bpy.data.objects[name].data
    assert not mesh.uv_layers and uv_maps.STRETCH not in mesh.attributes


def test_the_picture_of_stretch(tmp_path):
    item = ball()
    unwrap()
    path = tmp_path / "étirement.png"
    assert bpy.ops.farfield.unwrap_picture(filepath=str(path), size=128) == {"FINISHED"}
    image = bpy.data.images.load(str(path))
    assert tuple(image.size) == (128, 128)
    pixels = np.array(image.pixels[:]).reshape(-1, 4)
    assert len(np.unique(pixels.round(3), axis=0)) > 5
    with pytest.raises(RuntimeError, match="Cannot write"):
        bpy.ops.farfield.unwrap_picture(filepath=str(path / "a.png"), size=128)
    assert [image.name for image in bpy.data.images] == [path.name]
    stretch_pictures.save(item, path, 64)
