"""Several meshes in one texture: no overlaps, one texel density, and otherwise the same UV maps as without the setting."""

import re

import bpy
import numpy as np
import pytest

from farfield.addon.bridge.geometry.mesh_arrays import read_loop_triangles, read_uvs
from farfield.addon.bridge.unwrap import uv_maps
from farfield.addon.core.geometry.transforms import signed_areas
from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.core.messages import first_sentences, split_sentences
from farfield.addon.core.unwrap.overlaps import count_overlaps
from farfield.addon.operators.results import read_result
from farfield.addon.panels.results import PANEL_CHARS

pytestmark = pytest.mark.usefixtures("empty_scene", "coarse_packing")


def add_cube(name="Cube", location=(0.0, 0.0, 0.0), scale=1.0):
    bpy.ops.mesh.primitive_cube_add(size=1.0, calc_uvs=False, location=location)
    return finish(name, scale)


def add_plane(name, location=(0.0, 0.0, 0.0), scale=1.0):
    bpy.ops.mesh.primitive_plane_add(size=1.0, calc_uvs=False, location=location)
    return finish(name, scale)


def finish(name, scale):
    item = bpy.context.object
    item.name, item.scale = name, np.broadcast_to(scale, 3)
    bpy.context.view_layer.update()
    return item


def select(*items):
    bpy.ops.object.select_all(action="DESELECT")
    for item in items:
        item.select_set(True)
        bpy.context.view_layer.objects.active = item


def unwrap(*items, combine_selected=True, **settings):
    """Unwrap the objects; returns the corner UVs (T, 3, 2) of each."""
    select(*items)
    assert bpy.ops.farfield.unwrap(combine_selected=combine_selected, **settings) == {"FINISHED"}
    return [read_corner_uvs(item) for item in items]


def read_corner_uvs(item):
    return read_uvs(item.data.uv_layers["Unwrap"])[read_loop_triangles(item.data)[0]].astype(np.float64)


def sum_area(corner_uvs):
    return float(signed_areas(corner_uvs).sum())


def sentences():
    return read_result(bpy.context.scene, "unwrap")


@pytest.mark.parametrize("islands", ["creases", *(pytest.param(name, marks=pytest.mark.exhaustive) for name in ("one", "atlas"))])
def test_cubes_of_two_sizes_get_the_same_texel_density_and_do_not_overlap(islands):
    maps = unwrap(add_cube(), add_cube("Large", (5.0, 0.0, 0.0), 2.0), islands=islands)
    corner_uvs = np.concatenate(maps)
    assert run_to_end(count_overlaps(corner_uvs)) == 0
    assert corner_uvs.min() >= 0.0 and corner_uvs.max() <= 1.0
    small, large = (uv_maps.read_metrics(bpy.data.objects[name].data) for name in ("Cube", "Large"))
    assert small["texel_density"] == pytest.approx(large["texel_density"], rel=1e-3)
    assert sum_area(maps[1]) == pytest.approx(4.0 * sum_area(maps[0]), rel=2e-3)
    assert small["fill"] == large["fill"] == pytest.approx(sum_area(corner_uvs), rel=1e-5)


@pytest.mark.slow
def test_without_the_setting_each_fills_its_own_texture():
    maps = unwrap(add_cube(), add_cube("Large", (5.0, 0.0, 0.0), 2.0), combine_selected=False)
    assert sum_area(maps[0]) == pytest.approx(sum_area(maps[1]), rel=1e-3)
    assert run_to_end(count_overlaps(np.concatenate(maps))) > 0


@pytest.mark.slow
@pytest.mark.parametrize("settings", [{}, {"stack_equal_islands": True, "max_tiles": 3}, {"importance": "gradual", "islands": "one"}])
def test_one_object_is_unwrapped_as_without_the_setting(settings):
    bpy.ops.mesh.primitive_cylinder_add(vertices=12, calc_uvs=False, scale=(1.0, 2.0, -1.0))
    item = bpy.context.object
    [alone] = unwrap(item, combine_selected=False, **settings)
    expected, message = uv_maps.read_metrics(item.data), sentences()
    [together] = unwrap(item, **settings)
    assert np.array_equal(alone, together)
    assert uv_maps.read_metrics(item.data) == expected and sentences() == message


def test_islands_of_objects_that_touch_have_the_margin_between_them():
    """Within one mesh, doubled vertices count as one, and both squares would be one island."""
    first, second = unwrap(add_plane("First"), add_plane("Second", (1.0, 0.0, 0.0)), texture_size=(256, 256), margin=6)
    gaps = np.maximum(first.min(axis=(0, 1)) - second.max(axis=(0, 1)), second.min(axis=(0, 1)) - first.max(axis=(0, 1)))
    assert gaps.max() * 256.0 >= 6.0 - 1e-3


def test_linked_duplicates_get_one_set_of_islands():
    cube, other = add_cube(), add_plane("Other", (0.0, 5.0, 0.0))
    copy = bpy.data.objects.new("Copy", cube.data)
    bpy.context.collection.objects.link(copy)
    maps = unwrap(cube, copy, other)
    assert np.array_equal(maps[0], maps[1])
    assert sum_area(maps[0]) == pytest.approx(6.0 * sum_area(maps[2]), rel=1e-3)
    assert sentences()[0].startswith("Unwrapped 2 meshes into one texture: ")


def test_equal_objects_have_the_same_place_if_islands_are_stacked():
    cube, copy, plane = add_cube(), add_cube("Copy", (3.0, 0.0, 0.0)), add_plane("Plane", (0.0, 3.0, 0.0), 2.0)
    copy.rotation_euler.z = 0.4
    bpy.context.view_layer.update()
    maps = unwrap(cube, copy, plane, stack_equal_islands=True)
    assert np.allclose(np.sort(maps[0].reshape(-1, 2), axis=0), np.sort(maps[1].reshape(-1, 2), axis=0), atol=1e-5)
    assert run_to_end(count_overlaps(np.concatenate([maps[0], maps[2]]))) == run_to_end(count_overlaps(maps[0]))
    counts = [uv_maps.read_metrics(item.data) for item in (cube, copy, plane)]
    assert counts[0]["stacked"] < counts[0]["islands"] == counts[1]["islands"] == counts[1]["stacked"]
    assert counts[1]["texel_density"] == pytest.approx(counts[2]["texel_density"], rel=1e-3)
    assert counts[0]["fill"] == counts[1]["fill"] < sum_area(maps[0]) + sum_area(maps[2])


def test_what_a_camera_shows_smaller_gets_fewer_texels():
    """One plane is twice as far away, so that it has half as many pixels per meter; alone, each is equally important everywhere."""
    near, far = add_plane("Near", (-1.0, 0.0, 0.0)), add_plane("Far", (2.0, 0.0, -8.0))
    bpy.ops.object.camera_add(location=(0.0, 0.0, 8.0))
    bpy.context.scene.camera = bpy.context.object
    near_map, far_map = unwrap(near, far, importance="camera", density_ratio=8.0)
    assert np.sqrt(sum_area(near_map) / sum_area(far_map)) == pytest.approx(2.0, rel=0.05)


def test_selected_objects_hide_each_other_from_a_camera():
    roof, floor = add_plane("Roof", (0.0, 0.0, 1.0), 2.0), add_plane("Floor")
    bpy.ops.object.camera_add(location=(0.0, 0.0, 8.0))
    bpy.context.scene.camera = bpy.context.object
    seen, hidden = unwrap(roof, floor, importance="camera", density_ratio=3.0)
    assert sum_area(seen) / 4.0 / sum_area(hidden) == pytest.approx(3.0, rel=0.01)


def test_a_mirrored_object_has_its_texels_on_the_side_that_faces_the_direction():
    up, mirrored = add_plane("Up"), add_plane("Mirrored", (3.0, 0.0, 0.0), (1.0, 1.0, -1.0))
    maps = unwrap(up, mirrored, importance="direction", direction=(0.0, 0.0, 1.0), density_ratio=2.0)
    assert sum_area(maps[0]) / sum_area(maps[1]) == pytest.approx(2.0, rel=0.01)
    assert signed_areas(np.concatenate(maps)).min() > 0.0


def test_selected_faces_of_several_objects_in_edit_mode():
    items = add_cube(), add_cube("Large", (5.0, 0.0, 0.0), 2.0)
    unwrap(*items, combine_selected=False)
    before = [read_corner_uvs(item) for item in items]
    for item in items:
        item.data.polygons.foreach_set("select", [index < 3 for index in range(6)])
    bpy.context.tool_settings.mesh_select_mode = (False, False, True)
    bpy.ops.object.mode_set(mode="EDIT")
    assert bpy.ops.farfield.unwrap(combine_selected=True) == {"FINISHED"}
    bpy.ops.object.mode_set(mode="OBJECT")
    after = [read_corner_uvs(item) for item in items]
    assert all(np.array_equal(old[6:], new[6:]) for old, new in zip(before, after, strict=True))
    chosen = [corner_uvs[:6] for corner_uvs in after]
    assert run_to_end(count_overlaps(np.concatenate(chosen))) == 0
    assert sum_area(chosen[1]) == pytest.approx(4.0 * sum_area(chosen[0]), rel=2e-3)


@pytest.mark.slow
def test_a_texel_density_counts_for_all_and_tiles_are_shared():
    cubes = [add_cube(f"Cube {index}", (3.0 * index, 0.0, 0.0)) for index in range(4)]
    maps = unwrap(*cubes, texture_size=(512, 512), margin=2, texel_density=100.0, max_tiles=4)
    tiles = np.floor(np.concatenate(maps)).max(axis=(0, 1)) + 1
    assert tiles.prod() > 1 and run_to_end(count_overlaps(np.concatenate(maps))) == 0
    assert [uv_maps.read_metrics(cube.data)["texel_density"] for cube in cubes] == pytest.approx([100.0] * 4, rel=1e-3)
    assert f"{tiles.prod():.0f} UDIM tiles" in sentences()[0] and not any("lowered" in sentence for sentence in sentences())
    unwrap(*cubes, texture_size=(512, 512), margin=2, texel_density=1000.0)
    assert sentences()[1].startswith("The texel density was lowered to ")


def test_undo_takes_one_step():
    items = add_cube(), add_cube("Large", (5.0, 0.0, 0.0), 2.0)
    bpy.ops.ed.undo_push(message="before")
    unwrap(*items)
    bpy.ops.ed.undo_push(message="unwrapped")
    bpy.ops.ed.undo()
    assert not any(bpy.data.objects[name].data.uv_layers for name in ("Cube", "Large"))


@pytest.mark.slow
def test_the_message_of_several_meshes_is_short_and_the_figures_of_each_follow():
    items = [add_plane(f"Brett {index}", (5.0 * index, 0.0, 0.0), 1.0 + index) for index in range(10)]
    unwrap(*items, combine_selected=False)
    shown = split_sentences(first_sentences(" ".join(sentences()), PANEL_CHARS))
    figures = r"stretch 1\.000, 10 UV islands, [\d,.]+ to [\d,.]+ px/m\."
    assert re.fullmatch(f"Unwrapped 10 meshes: {figures}", shown[0])
    assert shown[1:] == ["Each mesh has its own texture; One Texture for All packs them into one."]
    details = sentences()[2:]
    assert [sentence.partition(":")[0] for sentence in details] == [f'"Brett {index}"' for index in range(10)]
    assert all(re.search(r": stretch 1\.000, 1 UV island, .*px/m, \d+% filled\.$", sentence) for sentence in details)
    unwrap(*items)
    first, *details = sentences()
    assert re.fullmatch(r"Unwrapped 10 meshes into one texture: stretch 1\.000, \d+ UV islands, .*[\d,.]+ px/m, \d+% filled\.", first)
    assert len(details) == 10 and not any("filled" in sentence for sentence in details)


def test_one_mesh_keeps_its_message():
    unwrap(add_plane("Brett"), combine_selected=False)
    [message] = sentences()
    assert re.fullmatch(r'Unwrapped "Brett" \(stretch 1\.000, 1 UV island, .*px/m, \d+% filled\)\.', message)
