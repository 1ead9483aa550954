"""The operator as scripts and add-ons call it: its result, the objects that it skips, and that nothing else changes."""

import math

import bpy
import mathutils
import numpy as np
import pytest

from farfield.addon.bridge.geometry.mesh_arrays import read_loop_triangles, read_uvs
from farfield.addon.bridge.unwrap import uv_maps
from farfield.addon.bridge.unwrap.stretch_display import save_stretch_image
from farfield.addon.core.geometry.transforms import signed_areas
from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.core.unwrap.overlaps import count_overlaps

pytestmark = pytest.mark.usefixtures("empty_scene", "coarse_packing")
SQUARE = [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (1.0, 1.0, 0.0), (0.0, 1.0, 0.0)]


def add_mesh(name, vertices, faces, edges=()):
    """Add a mesh object; it is selected and active."""
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(vertices, edges, faces)
    return link(bpy.data.objects.new(name, mesh))


def link(item):
    """Add an object to the scene, selected and active."""
    bpy.context.collection.objects.link(item)
    bpy.context.view_layer.update()
    item.select_set(True)
    bpy.context.view_layer.objects.active = item
    return item


def add_sphere(segments=12, rings=6, **options):
    """Add a selected sphere of quads and triangles."""
    bpy.ops.mesh.primitive_uv_sphere_add(segments=segments, ring_count=rings, calc_uvs=False, **options)
    return bpy.context.object


def unwrap(**settings):
    return bpy.ops.farfield.unwrap(**settings)


def unwrap_error(**settings):
    with pytest.raises(RuntimeError) as caught:
        unwrap(**settings)
    return str(caught.value)


def read_corner_uvs(item, uv_map="Unwrap"):
    """Corner UVs (T, 3, 2) of the triangles that Blender draws, and their polygons (T,)."""
    loops, polygons = read_loop_triangles(item.data)
    return read_uvs(item.data.uv_layers[uv_map])[loops].astype(np.float64), polygons


def assert_is_valid(item):
    corner_uvs, _ = read_corner_uvs(item)
    assert np.isfinite(corner_uvs).all() and corner_uvs.min() >= 0.0 and corner_uvs.max() <= 1.0
    assert signed_areas(corner_uvs).min() > 0.0
    assert run_to_end(count_overlaps(corner_uvs)) == 0


def test_a_sphere_gets_its_own_uv_map():
    item = add_sphere()
    item.data.uv_layers.new(name="Old")
    assert unwrap() == {"FINISHED"}
    assert [layer.name for layer in item.data.uv_layers] == ["Old", "Unwrap"]
    assert item.data.uv_layers.active.name == "Unwrap"
    assert_is_valid(item)
    metrics = uv_maps.read_metrics(item.data)
    assert metrics["flips"] == metrics["overlaps"] == 0 and 1.0 < metrics["l2"] < 1.3
    assert item.data[uv_maps.METRICS_PROPERTY]["densities"].to_list() == pytest.approx([1.0, 0.0, 0.0, 0.0])
    stretches = [value.value for value in item.data.attributes[uv_maps.STRETCH_ATTRIBUTE].data]
    farthest = max(metrics["linf"], metrics["max_expansion"])  # Compression or expansion, whichever is larger.
    assert np.exp(np.abs(np.log(stretches)).max()) == pytest.approx(farthest, rel=1e-3)


def test_a_face_has_the_stretch_of_its_triangle_that_is_farthest_from_1():
    item = add_mesh("Quad", SQUARE, [(0, 1, 2, 3)])
    target = uv_maps.read_uv_target(item, None)
    corner_uvs = target.mesh.corners[:, :, :2]
    for stretches, expected in (([1.5, 0.5], 0.5), ([0.9, 4.0], 4.0), ([np.inf, 0.5], np.finfo(np.float32).max)):
        uv_maps.write_uv_map(target, corner_uvs, np.array(stretches), "Unwrap", {})
        assert item.data.attributes[uv_maps.STRETCH_ATTRIBUTE].data[0].value == pytest.approx(expected)


def test_concave_polygons_are_not_cut():
    item = add_mesh("House", [*SQUARE, (0.5, 1.6, 0.0), (0.5, 0.5, 1.0)], [(0, 1, 2, 4, 3), (1, 0, 5)])
    unwrap()
    assert_is_valid(item)


@pytest.mark.parametrize("islands", ["creases", *(pytest.param(islands, marks=pytest.mark.exhaustive) for islands in ("one", "atlas"))])
def test_quads_that_are_not_flat_are_not_cut(islands):
    """Where a polygon is cut, the map in the mesh is another one than the map that was measured."""
    item = add_sphere()
    offsets = np.random.default_rng(0).normal(scale=0.12, size=(len(item.data.vertices), 3))
    for vertex, offset in zip(item.data.vertices, offsets, strict=True):
        vertex.co += mathutils.Vector(offset)
    unwrap(islands=islands)
    expected = uv_maps.read_metrics(item.data)["texel_density"]
    assert uv_maps.read_texel_densities(item.data)["Unwrap"] == pytest.approx(expected, rel=1e-5)
    assert signed_areas(read_corner_uvs(item)[0]).min() > 0.0


@pytest.mark.slow
def test_unwrapping_again_overwrites_the_same_map():
    item = add_sphere()
    unwrap()
    first, _ = read_corner_uvs(item)
    unwrap()
    assert len(item.data.uv_layers) == 1
    assert np.array_equal(first, read_corner_uvs(item)[0])


def test_seams_are_cut():
    bpy.ops.mesh.primitive_cube_add(calc_uvs=False)
    cube = bpy.context.object
    for edge in cube.data.edges:
        edge.use_seam = True
    unwrap()
    assert_is_valid(cube)
    assert uv_maps.read_metrics(cube.data)["l2"] == pytest.approx(1.0, abs=1e-4)


def test_every_selected_mesh_is_unwrapped_once():
    first, second = add_sphere(), add_sphere(location=(5.0, 0.0, 0.0))
    linked_duplicate = link(bpy.data.objects.new("Linked Duplicate", second.data))
    for item in (first, second, linked_duplicate):
        item.select_set(True)
    unwrap()
    assert_is_valid(first)
    assert_is_valid(second)


def test_scale_is_applied_and_mirroring_flips_nothing():
    item = add_sphere(scale=(-1.0, 3.0, 1.0))
    unwrap(importance="direction", direction=(0.0, 0.0, 1.0), density_ratio=2.0)
    assert_is_valid(item)
    corner_uvs, polygons = read_corner_uvs(item)
    faces_up = np.array([face.normal.z > 0.1 for face in item.data.polygons])[polygons]
    faces_down = np.array([face.normal.z < -0.1 for face in item.data.polygons])[polygons]
    assert signed_areas(corner_uvs)[faces_up].sum() > 1.4 * signed_areas(corner_uvs)[faces_down].sum()


def test_edit_mode_unwraps_only_selected_faces():
    item = add_sphere()
    unwrap()
    before, polygons = read_corner_uvs(item)
    is_top = np.array([face.center.z > 0.1 for face in item.data.polygons])
    item.data.polygons.foreach_set("select", is_top)
    bpy.context.tool_settings.mesh_select_mode = (False, False, True)
    bpy.ops.object.mode_set(mode="EDIT")
    assert unwrap() == {"FINISHED"}
    assert item.mode == "EDIT"
    bpy.ops.object.mode_set(mode="OBJECT")
    after, _ = read_corner_uvs(item)
    has_changed = (before != after).any(axis=(1, 2))
    assert has_changed[is_top[polygons]].all() and not has_changed[~is_top[polygons]].any()


@pytest.mark.slow
def test_a_painted_vertex_group_gets_more_texels():
    item = add_sphere(segments=20, rings=10)
    group = item.vertex_groups.new(name="Face")
    group.add([vertex.index for vertex in item.data.vertices if vertex.co.x > 0.0], 1.0, "REPLACE")
    unwrap(importance="vertex_group", density_ratio=3.0)
    assert uv_maps.read_metrics(item.data)["density_ratio"] == pytest.approx(3.0, rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("importance", ["camera", "cameras"])
def test_faces_visible_to_the_camera_get_more_texels(importance):
    item = add_sphere(segments=16, rings=8)
    bpy.ops.object.camera_add(location=(0.0, 0.0, 8.0), rotation=(0.0, 0.0, 0.0))
    bpy.context.scene.camera = bpy.context.object
    item.select_set(True)
    unwrap(importance=importance, density_ratio=4.0)
    corner_uvs, polygons = read_corner_uvs(item)
    height = np.array([face.center.z for face in item.data.polygons])[polygons]
    areas = signed_areas(corner_uvs)
    assert areas[height > 0.5].sum() > 2.0 * areas[height < -0.5].sum()
    assert_is_valid(item)


@pytest.mark.parametrize("is_rendered", [True, False])
def test_faces_hidden_by_rendered_objects_get_fewer_texels(is_rendered):
    bpy.ops.mesh.primitive_plane_add(size=4.0, location=(2.0, 0.0, 3.0))
    bpy.context.object.hide_render = not is_rendered
    bpy.ops.object.camera_add(location=(0.0, 0.0, 8.0), rotation=(0.0, 0.0, 0.0))
    bpy.context.scene.camera = bpy.context.object
    bpy.ops.object.select_all(action="DESELECT")
    bpy.ops.mesh.primitive_grid_add(x_subdivisions=10, y_subdivisions=10, calc_uvs=False)
    item = bpy.context.object
    unwrap(importance="camera", density_ratio=4.0)
    corner_uvs, polygons = read_corner_uvs(item)
    x = np.array([face.center.x for face in item.data.polygons])[polygons]
    areas = signed_areas(corner_uvs)
    ratio = areas[x < -0.2].sum() / areas[x > 0.2].sum()
    assert ratio > 2.0 if is_rendered else ratio == pytest.approx(1.0, abs=0.05)


def test_camera_importance_without_a_camera_is_an_error():
    add_sphere()
    assert "no camera" in unwrap_error(importance="camera")


def test_a_panoramic_camera_is_an_error():
    item = add_sphere()
    bpy.ops.object.camera_add()
    bpy.context.scene.camera = bpy.context.object
    bpy.context.object.data.type = "PANO"
    item.select_set(True)
    assert "panoramic" in unwrap_error(importance="camera")


def test_a_direction_without_length_is_an_error():
    add_sphere()
    assert "no length" in unwrap_error(importance="direction", direction=(0.0, 0.0, 0.0))


def test_a_missing_vertex_group_is_named():
    add_sphere()
    assert '"Ears"' in unwrap_error(importance="vertex_group", vertex_group="Ears")
    assert "no vertex group" in unwrap_error(importance="vertex_group")


def test_a_uv_map_with_pinned_vertices_is_skipped():
    item = add_sphere()
    unwrap()
    before, _ = read_corner_uvs(item)
    item.data.attributes.new(uv_maps.PIN_PREFIX + "Unwrap", "BOOLEAN", "CORNER").data[3].value = True
    assert "pinned" in unwrap_error()
    assert np.array_equal(before, read_corner_uvs(item)[0])
    assert unwrap(uv_map="Another") == {"FINISHED"}


def test_a_mesh_linked_from_a_library_is_skipped(tmp_path):
    item = add_sphere()
    path = tmp_path / "büste.blend"
    bpy.data.libraries.write(str(path), {item})
    name = item.name
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    with bpy.data.libraries.load(str(path), link=True) as (_, linked):
        linked.objects = [name]
    link(linked.objects[0])
    assert "linked" in unwrap_error()


def test_a_mesh_with_eight_uv_maps_and_a_name_in_use_are_skipped():
    item = add_sphere()
    for index in range(8):
        item.data.uv_layers.new(name=f"Map {index}")
    assert "eight" in unwrap_error()
    assert unwrap(uv_map="Map 3") == {"FINISHED"}
    item.data.uv_layers.remove(item.data.uv_layers[0])
    item.data.attributes.new("Wear", "FLOAT", "POINT")
    assert '"Wear"' in unwrap_error(uv_map="Wear")


def test_objects_without_faces_are_named():
    add_mesh("Dots", SQUARE, [])
    assert "Dots" in unwrap_error()
    bpy.ops.object.light_add()
    assert "Select a mesh" in unwrap_error()


def test_edit_mode_without_a_selection_is_an_error():
    add_sphere()
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.select_all(action="DESELECT")
    assert "selected faces" in unwrap_error()
    bpy.ops.object.mode_set(mode="OBJECT")


@pytest.mark.slow
@pytest.mark.parametrize("islands", ["one", pytest.param("atlas", marks=pytest.mark.exhaustive)])
def test_a_mesh_with_all_defects_is_unwrapped(islands):
    """Loose parts, a non-manifold edge, faces that touch in a vertex, opposite winding, no area, slivers, an unused vertex."""
    vertices = [*SQUARE, (0.5, 0.5, 1.0), (-1.0, -1.0, 0.0), (-1.0, 0.0, 0.0), (9.0, 9.0, 9.0)]
    vertices += [(5.0, 0.0, 0.0), (6.0, 0.0, 0.0), (7.0, 0.0, 0.0), (5.0, 3.0, 0.0), (6.0, 3.0, 0.0), (5.5, 3.0 + 1e-7, 0.0)]
    faces = [(0, 1, 2), (0, 3, 2), (0, 2, 4), (0, 5, 6), (8, 9, 10), (11, 12, 13)]
    item = add_mesh("Defects", vertices, faces)
    assert unwrap(islands=islands) == {"FINISHED"}
    corner_uvs, _ = read_corner_uvs(item)
    assert np.isfinite(corner_uvs).all() and signed_areas(corner_uvs).min() >= 0.0
    assert run_to_end(count_overlaps(corner_uvs)) == 0


def test_nan_coordinates_are_an_error():
    item = add_mesh("Broken", [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)], [(0, 1, 2)])
    item.data.vertices[1].co.x = math.nan
    assert "not finite" in unwrap_error()
    assert not item.data.uv_layers


@pytest.mark.slow
def test_an_atlas_has_little_stretch():
    item = add_sphere(segments=24, rings=12)
    unwrap(islands="atlas")
    assert uv_maps.read_metrics(item.data)["l2"] < 1.05
    assert_is_valid(item)


def test_undo_takes_one_step():
    bpy.ops.ed.undo_push(message="before")
    item = add_sphere()
    bpy.ops.ed.undo_push(message="sphere")
    unwrap()
    bpy.ops.ed.undo_push(message="unwrapped")
    name = item.name
    bpy.ops.ed.undo()
    mesh = bpy.data.objects[name].data
    assert not mesh.uv_layers and uv_maps.STRETCH_ATTRIBUTE not in mesh.attributes


def test_the_stretch_image_is_saved(tmp_path):
    item = add_sphere()
    unwrap()
    path = tmp_path / "étirement.png"
    assert bpy.ops.farfield.unwrap_stretch_image(filepath=str(path), resolution=128) == {"FINISHED"}
    image = bpy.data.images.load(str(path))
    assert tuple(image.size) == (128, 128)
    pixels = np.array(image.pixels[:]).reshape(-1, 4)
    assert len(np.unique(pixels.round(3), axis=0)) > 5
    (tmp_path / "folder.png").mkdir()
    for name, reason in (("folder.png", "is a folder"), (path.name + "/a.png", "is not a folder"), ("\udcff.png", "not valid UTF-8")):
        with pytest.raises(RuntimeError, match=reason):
            bpy.ops.farfield.unwrap_stretch_image(filepath=str(tmp_path / name), resolution=128)
    assert [image.name for image in bpy.data.images] == [path.name]
    save_stretch_image(item, path, 64)


LINE = [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (2.0, 0.0, 0.0)]  # A triangle without area.


def test_an_object_without_area_is_named_and_the_others_are_unwrapped(capfd):
    line, flat, item = add_mesh("Line", LINE, [(0, 1, 2)]), add_mesh("Dot", [(1.0, 1.0, 1.0)] * 3, [(0, 1, 2)]), add_sphere()
    for other in (line, flat):
        other.select_set(True)
    assert unwrap() == {"FINISHED"}
    assert_is_valid(item)
    assert not line.data.uv_layers and not flat.data.uv_layers
    output = capfd.readouterr().out
    assert 'Every face of "Line" has zero area' in output and 'All vertices of "Dot" are at the same position' in output


def test_an_object_without_area_alone_is_an_error():
    add_mesh("Line", LINE, [(0, 1, 2)])
    assert 'Every face of "Line" has zero area; choose an object with a surface.' in unwrap_error()


@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_a_broken_scale_is_named_and_the_others_are_unwrapped(capfd):
    broken, item = [add_sphere() for _ in range(3)], add_sphere()
    for each, name, scale in zip(broken, ("Nan", "Inf", "Flat"), (math.nan, math.inf, 0.0), strict=True):
        each.name, each.scale.x = name, scale
        if scale == 0.0:
            each.scale = (0.0, 0.0, 0.0)
    bpy.context.view_layer.update()
    for each in broken:
        each.select_set(True)
    assert unwrap() == {"FINISHED"}
    assert_is_valid(item)
    output = capfd.readouterr()
    assert all(f'"{each.name}"' in output.out and not each.data.uv_layers for each in broken) and not output.err


def test_objects_that_are_not_in_the_view_layer_are_named():
    from farfield.addon.core.errors import GeometryError
    from farfield.addon.core.unwrap.settings import UnwrapSettings
    from farfield.addon.operators.unwrap.job import prepare

    item = add_sphere()
    collection = bpy.data.collections.new("Off")
    bpy.context.scene.collection.children.link(collection)
    bpy.context.collection.objects.unlink(item)
    collection.objects.link(item)
    bpy.context.view_layer.layer_collection.children["Off"].exclude = True
    bpy.context.view_layer.update()
    with pytest.raises(GeometryError, match="excluded from the view layer"):
        prepare(bpy.context, [item], UnwrapSettings())


def test_an_attribute_named_like_the_stretch_is_kept():
    item = add_sphere()
    item.data.attributes.new(uv_maps.STRETCH_ATTRIBUTE, "FLOAT", "POINT")
    assert uv_maps.STRETCH_ATTRIBUTE in unwrap_error()
    assert not item.data.uv_layers


def test_objects_of_other_types_are_named():
    empty = bpy.data.objects.new("line\nbreak", None)
    bpy.context.scene.collection.objects.link(empty)
    empty.select_set(True)
    add_mesh("Line", LINE, [(0, 1, 2)])
    empty.select_set(True)
    assert "Nothing to unwrap: line break (an empty has no UV map);" in unwrap_error()


class TestChangesWhileUnwrapping:
    """The user changes meshes while UVs are computed."""

    @staticmethod
    def finish_after(change):
        """Unwrap the selected objects and call `change` before the UV maps are written."""
        from farfield.addon.core.unwrap.settings import UnwrapSettings
        from farfield.addon.operators.unwrap.job import prepare

        job = prepare(bpy.context, bpy.context.selected_objects, UnwrapSettings())
        results = run_to_end(job.core_steps())
        change()
        return run_to_end(job.scene_steps(results))

    def test_a_renamed_mesh_is_written(self):
        item = add_sphere()

        def change():
            item.data.name = item.name = "Other"

        self.finish_after(change)
        assert_is_valid(item)

    @pytest.mark.parametrize("change", ["fill", "remove", "edit", "take_name"])
    def test_no_mesh_is_written_when_one_cannot_be(self, change):
        from farfield.addon.core.errors import GeometryError

        first, second = (add_mesh(name, SQUARE, [(0, 1, 2, 3)]) for name in ("First", "Second"))
        changes = {
            "fill": lambda: [second.data.uv_layers.new(name=f"Map {index}") for index in range(8)],
            "remove": lambda: bpy.data.objects.remove(second) or bpy.data.meshes.remove(bpy.data.meshes[-1]),
            "edit": lambda: second.data.clear_geometry(),
            "take_name": lambda: second.data.attributes.new("Unwrap", "FLOAT", "POINT"),
        }
        with pytest.raises(GeometryError, match="while it was being unwrapped"):
            self.finish_after(changes[change])
        assert not first.data.uv_layers and uv_maps.STRETCH_ATTRIBUTE not in first.data.attributes


@pytest.mark.parametrize(("scale_length", "system"), [(1.0, "METRIC"), (0.01, "METRIC"), (0.01, "NONE")])
def test_the_texel_density_counts_pixels_per_meter(scale_length, system):
    item = add_mesh("Square", [(10.0 * x, 10.0 * y, z) for x, y, z in SQUARE], [(0, 1, 2, 3)])
    units = bpy.context.scene.unit_settings
    units.system, units.scale_length = system, scale_length
    meters = 10.0 if system == "NONE" else 10.0 * scale_length
    assert unwrap(texture_size=(512, 512), margin=6) == {"FINISHED"}
    assert uv_maps.read_metrics(item.data)["texel_density"] == pytest.approx(500.0 / meters)
    assert uv_maps.read_metrics(item.data)["fill"] == pytest.approx((500.0 / 512.0) ** 2)
    unwrap(texture_size=(512, 512), texel_density=100.0 / meters, uv_map="Small")
    corner_uvs, _ = read_corner_uvs(item, "Small")
    assert np.ptp(corner_uvs, axis=(0, 1)) * 512.0 == pytest.approx([100.0, 100.0], rel=1e-5)
    assert uv_maps.read_texel_densities(item.data) == pytest.approx({"Unwrap": 500.0 / meters, "Small": 100.0 / meters})


@pytest.mark.slow
def test_a_lowered_texel_density_is_reported(capfd):
    add_sphere()
    unwrap(texture_size=(256, 256), texel_density=1e4)
    assert 'The texel density of "Sphere" was lowered to' in capfd.readouterr().out


def test_islands_are_written_to_udim_tiles():
    item = add_sphere()
    unwrap(texture_size=(256, 256), islands="atlas", texel_density=100.0, max_tiles=12)
    corner_uvs, _ = read_corner_uvs(item)
    tiles = np.floor(corner_uvs)
    assert (tiles == tiles[:, :1]).all() and len(np.unique(tiles[:, 0], axis=0)) > 1
    assert uv_maps.read_metrics(item.data)["texel_density"] == pytest.approx(100.0, rel=1e-3)
    assert run_to_end(count_overlaps(corner_uvs)) == 0


def test_the_texel_density_of_a_uv_map_becomes_the_setting():
    add_mesh("Square", SQUARE, [(0, 1, 2, 3)])
    unwrap(texture_size=(512, 512), texel_density=200.0)
    bpy.context.scene.farfield_unwrap.texture_size = (1024, 1024)
    assert bpy.ops.farfield.unwrap_texel_density() == {"FINISHED"}
    assert bpy.context.scene.farfield_unwrap.texel_density == pytest.approx(400.0, rel=1e-4)


def test_stacked_islands_are_counted(capfd):
    bpy.ops.mesh.primitive_cone_add(vertices=12)  # Vertices of spheres have another order in each process.
    bpy.ops.object.duplicate()
    bpy.context.object.location.x = 5.0
    bpy.context.scene.objects["Cone"].select_set(True)
    bpy.ops.object.join()
    item = bpy.context.object
    unwrap(stack_equal_islands=True)
    counts = uv_maps.read_metrics(item.data)
    assert (counts["stacked"], counts["islands"]) == (2, 4) and counts["overlaps"] == 0
    assert f"{counts['islands']} UV islands of which {counts['stacked']} stacked" in capfd.readouterr().out
