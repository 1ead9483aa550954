"""The operators as scripts call them: importing cameras, and merging photographs into a texture with a material."""

from functools import cache

import bpy
import numpy as np
import pytest
from mathutils import Matrix

from farfield.addon.bridge.imaging.images import read_pixels
from farfield.addon.bridge.photos.camera_objects import create_cameras
from farfield.addon.bridge.photos.scene_cameras import LENS_PROPERTY, read_lens
from farfield.addon.core.geometry.transforms import signed_areas
from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.core.photos.merging import merge
from farfield.addon.core.photos.previews import draw_overlay
from farfield.addon.core.photos.settings import PhotosSettings
from farfield.addon.core.unwrap.overlaps import count_overlaps
from farfield.addon.operators.photos.previews import OverlayJob
from farfield.addon.operators.photos.sources import find_cameras, open_photographs, read_targets
from image_data import write_image
from photo_scenes import SIZE, camera_at, grid, photograph, ring, smooth_texture

pytestmark = pytest.mark.usefixtures("empty_scene", "quick_merges", "coarse_packing")
FAST = {"size": SIZE, "sharpen": False}


def height(x, y):
    return 0.1 * np.sin(2 * x + y)


def write_cameras(folder, cameras):
    """Write text files like those of COLMAP."""
    folder.mkdir()
    lines, poses = [], []
    for index, camera in enumerate(cameras, start=1):
        lens, pose = camera.lens, (*Matrix(camera.rotation.tolist()).to_quaternion(), *camera.translation)
        lines.append(f"{index} SIMPLE_PINHOLE {lens.size[0]} {lens.size[1]} {lens.focal[0]} {lens.center[0]} {lens.center[1]}")
        poses += [f"{index} {' '.join(repr(float(value)) for value in pose)} {index} {camera.name}", ""]
    (folder / "cameras.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")
    (folder / "images.txt").write_text("\n".join(poses) + "\n", encoding="utf-8")


def add_mesh(name="Wand ü", corner_uvs=True, offset=0.0):
    """The wavy square of `grid` as a selected object; returns it with the arrays."""
    mesh, uvs = grid(10, height)
    data = bpy.data.meshes.new(name)
    data.from_pydata(mesh.vertices.tolist(), [], mesh.triangles.tolist())
    if corner_uvs:
        data.uv_layers.new(name="UVMap").uv.foreach_set("vector", uvs.ravel())
    item = bpy.data.objects.new(name, data)
    bpy.context.collection.objects.link(item)
    item.location.x = offset
    item.select_set(True)
    bpy.context.view_layer.update()
    return item, mesh, uvs


@cache
def take_photographs():
    """The photographs of the wavy square by a ring of three cameras."""
    mesh, uvs = grid(10, height)
    return [photograph(mesh, uvs, smooth_texture(), camera) for camera in ring(3)]


def write_photographs(folder):
    """Write the photographs of the wavy square; returns them."""
    folder.mkdir(parents=True, exist_ok=True)
    for each in take_photographs():
        write_image(folder / each.camera.name, each.pixels[::-1])
    return take_photographs()


@pytest.fixture
def photographs(tmp_path):
    """Three photographs, and cameras in the scene with them."""
    found = write_photographs(tmp_path / "été")
    create_cameras([each.camera for each in found], tmp_path / "été", "Cameras", bpy.context.scene, is_y_up=False)
    return found


@pytest.fixture
def project(tmp_path):
    """A folder like that of COLMAP."""
    folder = tmp_path / "Projekt 樹"
    write_photographs(folder / "images")
    (folder / "sparse").mkdir()
    write_cameras(folder / "sparse" / "0", ring(3))
    return folder


def import_cameras(path, **arguments):
    assert bpy.ops.farfield.photos_import_cameras(filepath=str(path), **arguments) == {"FINISHED"}
    bpy.context.view_layer.update()
    return bpy.data.collections["Photo Cameras"]


def merge_scene(**settings):
    assert bpy.ops.farfield.photos_merge(**(FAST | settings)) == {"FINISHED"}


def merge_error(**settings):
    names = state()
    with pytest.raises(RuntimeError) as caught:
        bpy.ops.farfield.photos_merge(**(FAST | settings))
    message = str(caught.value).removeprefix("Error: ").strip()
    assert "\n" not in message
    assert state() == names, "something was half-made"
    return message


def state():
    kinds = ("objects", "meshes", "materials", "images", "cameras", "scenes", "collections")
    uvs = [(mesh.name, layer.name) for mesh in bpy.data.meshes for layer in mesh.uv_layers]
    return {kind: sorted(item.name for item in getattr(bpy.data, kind)) for kind in kinds}, uvs


def shown_image(item):
    """The image in the only material of an object."""
    [slot] = item.material_slots
    [image] = [node.image for node in slot.material.node_tree.nodes if node.type == "TEX_IMAGE"]
    return image


class TestImport:
    """*Import Cameras*."""

    @pytest.mark.parametrize(
        "chosen",
        [
            "",
            pytest.param("sparse/0", marks=pytest.mark.exhaustive),
            "sparse/0/cameras.txt",
            pytest.param("sparse/0/images.txt", marks=pytest.mark.exhaustive),
        ],
    )
    def test_cameras_and_photographs(self, project, chosen):
        collection = import_cameras(project / chosen)
        cameras = [item for item in collection.objects if item.type == "CAMERA"]
        [parent] = [item for item in collection.objects if item.type == "EMPTY"]
        assert [item.name for item in cameras] == ["0", "1", "2"] and all(item.parent == parent for item in cameras)
        assert bpy.context.scene.camera == cameras[0] and all(LENS_PROPERTY in item.data for item in cameras)
        images = [item.data.background_images[0].image for item in cameras]
        assert [bpy.path.abspath(image.filepath) for image in images] == [str(project / "images" / f"{index}.png") for index in range(3)]
        assert not any(image.has_data for image in images)

    def test_the_render_size_changes_only_on_request(self, project):
        before = bpy.context.scene.render.resolution_x, bpy.context.scene.render.resolution_y
        import_cameras(project)
        assert (bpy.context.scene.render.resolution_x, bpy.context.scene.render.resolution_y) == before
        import_cameras(project, set_render_size=True)
        assert (bpy.context.scene.render.resolution_x, bpy.context.scene.render.resolution_y) == (300, 240)

    def test_sizes_that_the_file_lacks_are_read_from_the_photographs(self, project, capfd):
        (project / "model.nvm").write_text("NVM_V3\n1\n1.png 280 1 0 0 0 0 0 0 0 0\n", encoding="utf-8")
        camera = import_cameras(project / "model.nvm").objects["1"]
        lens = read_lens(camera.data)
        assert lens.size == (300, 240) and lens.center == (150.0, 120.0) and lens.model == "INVERSE_RADIAL"
        (project / "images" / "1.png").unlink()
        with pytest.raises(RuntimeError, match=r'There is no photograph "1\.png"'):
            bpy.ops.farfield.photos_import_cameras(filepath=str(project / "model.nvm"))

    def test_paths_are_relative_in_a_saved_file(self, project):
        bpy.ops.wm.save_as_mainfile(filepath=str(project / "project.blend"))
        collection = import_cameras(project)
        image = collection.objects["1"].data.background_images[0].image
        assert image.filepath == "//images/1.png" and tuple(image.size) == (300, 240)

    def test_missing_photographs_are_counted(self, project, tmp_path, capfd):
        (project / "images" / "1.png").unlink()
        collection = import_cameras(project)
        assert len([item for item in collection.objects if item.type == "CAMERA"]) == 3
        assert "1 photograph not found" in "".join(capfd.readouterr())
        import_cameras(project, images=str(tmp_path))
        assert "3 photographs not found" in "".join(capfd.readouterr())

    def test_invalid_files_are_one_sentence(self, project, tmp_path):
        before = state()
        for path in (tmp_path / "nowhere", tmp_path, ""):
            with pytest.raises(RuntimeError) as caught:
                bpy.ops.farfield.photos_import_cameras(filepath=str(path))
            assert "\n" not in str(caught.value).strip()
        assert state() == before

    def test_undo(self, project):
        bpy.ops.ed.undo_push(message="before")
        before = state()
        import_cameras(project)
        bpy.ops.ed.undo_push(message="Import Cameras")
        bpy.ops.ed.undo()
        assert state() == before


class TestOverlays:
    """*Draw Overlays*."""

    def test_each_photograph_gets_one_image_which_a_second_run_replaces(self, photographs, capfd):
        item, mesh, _ = add_mesh()
        assert bpy.ops.farfield.photos_draw_overlays() == {"FINISHED"}
        assert "Drew 3 overlays" in capfd.readouterr().out
        names = [f"{index}.png Overlay" for index in range(3)]
        first = read_pixels(bpy.data.images[names[0]])
        assert np.abs(first[..., :3] - draw_overlay(mesh, photographs[0])).mean() < 0.01
        item.location.x += 50.0
        bpy.context.view_layer.update()
        assert bpy.ops.farfield.photos_draw_overlays() == {"FINISHED"}
        overlays = sorted(image.name for image in bpy.data.images if "Overlay" in image.name)
        assert overlays == names
        second = read_pixels(bpy.data.images[names[0]])
        assert second[..., :3].mean() < first[..., :3].mean(), "the mesh has left the photographs, which are dimmed"

    def test_images_of_others_are_kept(self, photographs):
        own = bpy.data.images.new("0.png Overlay", 2, 2)
        add_mesh()
        assert bpy.ops.farfield.photos_draw_overlays() == {"FINISHED"}
        assert bpy.data.images["0.png Overlay"] == own
        assert len(bpy.data.images["0.png Overlay.001"].pixels) > 16

    def test_a_cancelled_job_leaves_only_the_earlier_overlays(self, photographs):
        add_mesh()
        assert bpy.ops.farfield.photos_draw_overlays() == {"FINISHED"}
        before = {image.name: image.session_uid for image in bpy.data.images}
        _, instances, _ = read_targets(bpy.context)
        job = OverlayJob(instances, open_photographs(bpy.context))
        steps = job.scene_steps(run_to_end(job.core_steps()))
        next(steps), next(steps)
        assert len(bpy.data.images) == len(before) + 1
        steps.close()
        assert {image.name: image.session_uid for image in bpy.data.images} == before


class TestMerge:
    """*Merge*."""

    def test_the_texture_is_that_of_the_core(self, photographs):
        item, mesh, uvs = add_mesh()
        old = bpy.data.materials.new("Old")
        item.data.materials.append(old)
        merge_scene(method="best", sharpen=True)
        image = shown_image(item)
        expected = run_to_end(merge(mesh, uvs, photographs, PhotosSettings(size=SIZE, method="best")))
        found = read_pixels(image)
        assert image.packed_files and tuple(image.size) == (SIZE, SIZE) and image.colorspace_settings.name == "sRGB"
        difference = np.abs(found[..., :3] - expected.colors)
        assert difference.mean() < 1e-3 and np.percentile(difference, 99.0) < 0.01 and (found[..., 3] == 1.0).all()
        assert old.use_fake_user and image.name == "Wand ü Photo Texture"
        assert np.sqrt(np.mean((found[..., :3] - smooth_texture())[6:-6, 6:-6] ** 2)) < 0.02
        merge_scene()
        assert len(item.material_slots) == 1 and shown_image(item) != image
        assert not any(material.use_fake_user for material in bpy.data.materials if material != old)

    def test_maps_and_transparent_holes_on_request(self, photographs):
        item, _, _ = add_mesh()
        for camera in [item for item in bpy.data.objects if item.type == "CAMERA"][1:]:
            camera.hide_set(True)
        bpy.data.objects["0"].data[LENS_PROPERTY] = bpy.data.objects["0"].data[LENS_PROPERTY].replace("300.0", "900.0")  # a narrow view
        merge_scene(maps=True, fill="none")
        image = shown_image(item)
        holes = read_pixels(image)[..., 3] == 0.0
        assert 0.05 < holes.mean() < 0.95
        maps = {name: bpy.data.images[f"{image.name} {name}"] for name in ("Confidence", "Source", "Holes")}
        assert all(each.colorspace_settings.is_data and each.use_fake_user for each in maps.values())
        assert np.array_equal(read_pixels(maps["Holes"])[..., 0] > 0.5, holes)
        assert (read_pixels(maps["Source"])[..., 0][holes] == 0.0).all()
        assert any(link.to_socket.name == "Alpha" for link in item.material_slots[0].material.node_tree.links)

    def test_a_mesh_without_a_uv_map_is_unwrapped(self, photographs):
        item, _, _ = add_mesh(corner_uvs=False)
        merge_scene()
        assert [layer.name for layer in item.data.uv_layers] == ["Unwrap"]
        colors = sample_texture(item)
        assert np.sqrt(np.mean((colors - expected_colors()) ** 2)) < 0.03

    def test_several_meshes_are_unwrapped_into_one_texture(self, tmp_path):
        first, _, _ = add_mesh(corner_uvs=False)
        second, _, _ = add_mesh("Second", corner_uvs=False, offset=2.5)
        second.scale = (-1.0, 1.0, 1.0)
        cameras = [camera_at((x, y, 3.5), target=(1.25, 0.0, 0.0), name=f"{x}.png", focal=200.0) for x, y in ((0.0, 0.4), (2.5, 0.4))]
        folder = tmp_path / "gray"
        folder.mkdir()
        for camera in cameras:
            write_image(folder / camera.name, np.full((240, 300, 3), 90, np.uint8))
        create_cameras(cameras, folder, "Cameras", bpy.context.scene, is_y_up=False)
        merge_scene()
        assert shown_image(first) == shown_image(second)
        corner_uvs = [read_uvs(item).astype(float) for item in (first, second)]
        assert run_to_end(count_overlaps(np.concatenate(corner_uvs))) == 0
        areas = [np.abs(signed_areas(uvs)).sum() for uvs in corner_uvs]
        assert areas[0] == pytest.approx(areas[1], rel=1e-3) and min(areas) > 0.2, "both are equal, seen as large by mirrored cameras"
        assert sample_texture(first) == pytest.approx(90 / 255, abs=0.01)
        assert sample_texture(second) == pytest.approx(90 / 255, abs=0.01)

    @pytest.mark.parametrize("scale", [pytest.param((2.0, 2.0, 2.0), marks=pytest.mark.exhaustive), (-1.0, 1.0, 1.0)])
    def test_scaled_and_mirrored_objects(self, photographs, scale):
        """The mesh is scaled back, so that the photographs show it."""
        item, _, _ = add_mesh()
        for vertex in item.data.vertices:
            vertex.co = [value / factor for value, factor in zip(vertex.co, scale, strict=True)]
        if scale[0] < 0.0:
            item.data.flip_normals()
        item.scale = scale
        merge_scene()
        assert np.sqrt(np.mean((sample_texture(item) - expected_colors()) ** 2)) < 0.03

    def test_selected_cameras_are_used_and_otherwise_all_visible_ones(self, photographs, capfd):
        add_mesh()
        bpy.data.objects["1"].select_set(True)
        merge_scene()
        assert "Merged 1 photograph " in "".join(capfd.readouterr())
        bpy.data.objects["1"].select_set(False)
        bpy.data.objects["2"].hide_set(True)
        assert [item.name for item in find_cameras(bpy.context)] == ["0", "1"]
        bpy.data.objects["Cameras"].select_set(True)
        assert [item.name for item in find_cameras(bpy.context)] == ["0", "1", "2"]

    def test_other_objects_are_skipped_and_named(self, photographs, capfd):
        add_mesh()
        light = bpy.data.objects.new("Lampe", bpy.data.lights.new("Lampe", "POINT"))
        bpy.context.collection.objects.link(light)
        light.select_set(True)
        merge_scene()
        assert "Skipped: Lampe (a light" in "".join(capfd.readouterr())

    def test_undo_restores_material_and_uv_maps(self, photographs):
        item, _, _ = add_mesh(corner_uvs=False)
        item.data.materials.append(bpy.data.materials.new("Old"))
        bpy.ops.ed.undo_push(message="before")
        before = state()
        merge_scene()
        bpy.ops.ed.undo_push(message="Merge")
        bpy.ops.ed.undo()
        assert state() == before and bpy.data.objects["Wand ü"].material_slots[0].material.name == "Old"

    def test_settings_come_from_the_panel(self, photographs):
        item, _, _ = add_mesh()
        bpy.context.scene.farfield_photos.size, bpy.context.scene.farfield_photos.maps = 64, True
        assert bpy.ops.farfield.photos_merge() == {"FINISHED"}
        assert tuple(shown_image(item).size) == (64, 64) and len(bpy.data.images) == 3 + 4

    @pytest.mark.slow
    def test_linked_materials_and_object_slots(self, photographs):
        item, _, _ = add_mesh()
        item.data.materials.append(None)
        item.material_slots[0].link = "OBJECT"
        item.material_slots[0].material = bpy.data.materials.new("On Object")
        merge_scene()
        assert item.material_slots[0].material == item.data.materials[0] and shown_image(item)
        assert bpy.data.materials["On Object"].use_fake_user


class TestMergeErrors:
    """What cannot be merged is one sentence, and nothing is half-made."""

    def test_nothing_to_merge(self, photographs):
        assert "Select a mesh object" in merge_error()
        item, _, _ = add_mesh()
        for camera in [item for item in bpy.data.objects if item.type == "CAMERA"]:
            camera.hide_set(True)
        assert "Import cameras" in merge_error()
        bpy.context.view_layer.objects.active = item
        bpy.ops.object.mode_set(mode="EDIT")
        assert "Switch to Object Mode" in merge_error()

    def test_photographs_that_cannot_be_used(self, photographs, tmp_path):
        add_mesh()
        write_image(tmp_path / "été" / "1.png", np.zeros((20, 30, 3), np.uint8))
        assert 'photograph "1.png" has 30 x 20 pixels, but its camera 300 x 240' in merge_error()
        (tmp_path / "été" / "1.png").unlink()
        assert "1.png" in merge_error()
        bpy.data.objects["1"].data.type = "ORTHO"
        assert 'The camera "1" is orthographic' in merge_error()

    def test_a_mesh_out_of_view(self, photographs):
        item, _, _ = add_mesh(corner_uvs=False)
        item.location.x = 1000.0
        assert "No vertex of the mesh lies in the frame" in merge_error()

    def test_a_uv_map_that_overlaps_itself_is_refused_and_the_faces_are_selected(self, photographs):
        item, _, uvs = add_mesh()
        moved = uvs.copy()
        moved[:40] = uvs[100:140]
        item.data.uv_layers[0].uv.foreach_set("vector", moved.ravel())
        item.data.polygons.foreach_set("select", np.ones(len(item.data.polygons), bool))
        message = merge_error()
        assert 'The UV map of "Wand ü" overlaps itself: 80 triangles share texels' in message and "selected in Edit Mode" in message
        selected = [polygon.index for polygon in item.data.polygons if polygon.select]
        assert selected == [*range(40), *range(100, 140)]
        assert sum(vertex.select for vertex in item.data.vertices) < len(item.data.vertices)
        item.data.uv_layers[0].uv.foreach_set("vector", uvs.ravel())
        merge_scene()

    def test_a_mirrored_uv_map_of_a_modifier_is_refused(self, photographs):
        item, _, _ = add_mesh()
        item.modifiers.new("Mirror", "MIRROR")
        item.location.x = 1.0
        message = merge_error()
        assert "overlaps itself: 400 triangles" in message and "Mirror" in message

    def test_uv_maps_that_do_not_fit_together(self, photographs):
        add_mesh()
        second, _, _ = add_mesh("Second", offset=2.5)
        assert 'The UV maps of "Wand ü" and "Second" overlap' in merge_error()
        second.data.uv_layers.remove(second.data.uv_layers[0])
        second.data.update_tag()
        assert '"Second" has no UV map, but "Wand ü" has one' in merge_error()

    def test_modifiers_that_change_faces_of_a_mesh_without_uvs(self, photographs):
        item, _, _ = add_mesh(corner_uvs=False)
        item.modifiers.new("Subdivision", "SUBSURF")
        assert '"Wand ü" cannot be unwrapped together with its modifiers' in merge_error()


def read_uvs(item):
    uvs = np.empty(2 * len(item.data.loops), np.float32)
    item.data.uv_layers.active.uv.foreach_get("vector", uvs)
    return uvs.reshape(-1, 3, 2)


def sample_texture(item):
    """Colors (T, 3) of the texture at the centers of the triangles of an object."""
    pixels = read_pixels(shown_image(item))[..., :3]
    columns, rows = np.floor(read_uvs(item).mean(axis=1) * SIZE).astype(int).clip(0, SIZE - 1).T
    return pixels[rows, columns]


def expected_colors():
    """Colors (T, 3) of the true texture at the centers of the triangles of the wavy square."""
    columns, rows = np.floor(grid(10, height)[1].mean(axis=1) * SIZE).astype(int).T
    return smooth_texture()[rows, columns]
