"""Invalid and unusual input: every error is one clear message and leaves no data behind; unusual but valid input is built."""

import errno
import math
import os
from pathlib import Path

import bpy
import numpy as np
import pytest

import billboards
from farfield.addon.compat import enable_nodes
from farfield.addon.core.errors import FarfieldError, FileError
from lib import atomic_output, command_line

pytestmark = pytest.mark.usefixtures("empty_scene")
SQUARE = [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (1.0, 1.0, 0.0), (0.0, 1.0, 0.0)]


def add(name, vertices, faces, edges=()):
    """Add a selected mesh object."""
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(vertices, edges, faces)
    added = bpy.data.objects.new(name, mesh)
    bpy.context.collection.objects.link(added)
    bpy.context.view_layer.update()
    added.select_set(True)
    bpy.context.view_layer.objects.active = added
    return added


def add_cube(name="Cube", scale=(1.0, 1.0, 1.0)):
    """Add a selected cube of side 2 with a scale."""
    bpy.ops.mesh.primitive_cube_add()
    cube = bpy.context.object
    cube.name, cube.scale = name, scale
    bpy.context.view_layer.update()
    return cube


def build(**properties):
    """Build one coarse level without textures."""
    return bpy.ops.farfield.billboards_build(**({"error": 5.0, "levels": 1, "textures": False} | properties))


def level():
    """Return the only level in the file."""
    (item,) = (item for item in bpy.data.objects if item.get("farfield_kind") == "cloud")
    return item


def counts():
    """Return the number of data-blocks of each type in the file."""
    names = ("objects", "meshes", "materials", "images", "collections", "scenes", "node_groups", "cameras")
    return {name: len(getattr(bpy.data, name)) for name in names}


def error_message(**properties):
    """Return the message of an error that left no data behind."""
    before = counts()
    with pytest.raises(RuntimeError) as caught:
        build(**properties)
    assert counts() == before
    message = str(caught.value).removeprefix("Error: ").strip()
    assert message.endswith(".") and "\n" not in message and "Traceback" not in message
    return message


class TestGeometry:
    """Meshes."""

    def test_empty_mesh(self):
        add("Empty One", [], [])
        assert "Empty One" in error_message()

    def test_no_faces(self):
        add("Wire", SQUARE, [], edges=[(0, 1)])
        assert "Wire (no faces)" in error_message()

    @pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
    def test_non_finite_coordinates(self, value):
        add("Broken", [*SQUARE[:3], (value, 1.0, 0.0)], [(0, 1, 2, 3)])
        message = error_message()
        assert "Broken" in message and "not finite" in message

    def test_only_zero_area_faces(self):
        add("Line", [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (2.0, 0.0, 0.0)], [(0, 1, 2)])
        message = error_message()
        assert "Line" in message and "zero area" in message

    def test_all_vertices_at_one_position(self):
        add("Dot", [(1.0, 1.0, 1.0)] * 3, [(0, 1, 2)])
        assert "same position" in error_message()

    def test_zero_area_faces_among_others_are_dropped(self):
        add("Mixed", [*SQUARE, (0.5, 0.0, 0.0)], [(0, 1, 2, 3), (0, 1, 4)])
        build()
        assert level()["farfield_quads"] == 1

    def test_flat_mesh_is_one_quad(self):
        bpy.ops.mesh.primitive_grid_add(x_subdivisions=8, y_subdivisions=8)
        build()
        assert level()["farfield_quads"] == 1
        assert max(level().dimensions) == pytest.approx(2.0, rel=0.1)

    def test_duplicate_and_non_manifold_faces(self):
        third = (0.5, 0.5, 1.0)
        add("Fan", [*SQUARE, third, (0.5, 0.5, -1.0)], [(0, 1, 2, 3), (0, 1, 4), (0, 1, 5), (1, 0, 4)])
        assert build() == {"FINISHED"}
        assert level()["farfield_quads"] >= 2


class TestTransforms:
    """Locations and scales of objects."""

    @pytest.mark.parametrize("unit", [1e-6, 1e6])
    def test_extreme_units(self, unit):
        add_cube(scale=(unit, unit, unit))
        build()
        assert level()["farfield_quads"] == 6
        assert level()["farfield_error"] == pytest.approx(0.05 * 2.0 * unit, rel=1e-4)

    @pytest.mark.parametrize("unit", [1e-6, pytest.param(1e6, marks=pytest.mark.exhaustive)])
    def test_textures_at_extreme_units(self, unit):
        add_cube(scale=(unit, unit, unit))
        build(textures=True, samples=1)
        image = next(node.image for node in level().data.materials[0].node_tree.nodes if node.label == "Front color")
        pixels = np.array(image.pixels[:]).reshape(-1, 4)
        assert pixels[:, 3].max() == pytest.approx(1.0, abs=0.02)

    @pytest.mark.parametrize(
        "scale",
        [
            *(pytest.param(scale, marks=pytest.mark.exhaustive) for scale in ((-1.0, 1.0, 1.0), (1.0, 3.0, 0.2))),
            (-1.0, -1.0, -1.0),
            (-2.0, 1.0, 0.5),
        ],
    )
    def test_quads_face_outwards_under_mirrored_and_nonuniform_scale(self, scale):
        add_cube(scale=scale)
        build(error=1.0)
        assert level()["farfield_quads"] == 6
        for polygon in level().data.polygons:
            assert polygon.normal.dot(polygon.center) > 0.0

    @pytest.mark.parametrize("method", ["clusters", "hough", "decimate"])
    def test_small_objects_at_large_distances(self, method):
        """The error is much larger than the objects, but their faces have an area."""
        far = add_cube("Far")
        far.location.x = 1e7
        add_cube().select_set(True)
        far.select_set(True)
        assert build(combine_selected=True, method=method) == {"FINISHED"}
        assert level()["farfield_quads"] >= 1

    @pytest.mark.filterwarnings("error::RuntimeWarning")
    @pytest.mark.parametrize("location", [1e15, 1e30])
    def test_far_from_the_origin(self, location):
        add_cube(scale=(location * 1e-6,) * 3).location.x = location
        assert build() == {"FINISHED"}

    def test_zero_scale_is_flat(self):
        add_cube(scale=(1.0, 1.0, 0.0))
        build()
        assert 1 <= level()["farfield_quads"] <= 2


class TestMaterials:
    """Incomplete materials."""

    def test_missing_image_file_is_named(self, tmp_path):
        cube = add_cube()
        material = bpy.data.materials.new("Painted")
        enable_nodes(material)
        path = tmp_path / "fehlt 無い.png"
        image = bpy.data.images.new("Lost", 4, 4)
        image.filepath_raw, image.file_format = str(path), "PNG"
        image.save()
        image.source, image.filepath = "FILE", str(path)
        path.unlink()
        node = material.node_tree.nodes.new("ShaderNodeTexImage")
        node.image = image
        material.node_tree.links.new(node.outputs["Color"], material.node_tree.nodes["Principled BSDF"].inputs["Base Color"])
        cube.data.materials.append(material)
        message = error_message(textures=True)
        assert "Lost" in message and "Painted" in message and path.name in message
        assert build(textures=False) == {"FINISHED"}

    def test_an_image_path_that_no_disk_can_hold_is_missing_too(self):
        cube = add_cube()
        material = bpy.data.materials.new("Painted")
        enable_nodes(material)
        image = bpy.data.images.new("Lost", 4, 4)
        image.source, image.filepath = "FILE", f"/{'a' * 300}.png"
        material.node_tree.nodes.new("ShaderNodeTexImage").image = image
        cube.data.materials.append(material)
        assert "Lost" in error_message(textures=True)

    def test_empty_material_slots_are_gray(self):
        add_cube().data.materials.append(None)
        build(textures=True, samples=1, error=10.0)
        assert level().data.materials[0] is not None


class TestSettings:
    """Settings of the script."""

    @pytest.mark.parametrize("flag", ["--error=0", "--error=-1%", "--error=5000%", "--error=nan", "--levels=0", "--samples=0"])
    def test_out_of_range_numbers(self, flag, cube_file):
        with pytest.raises(FarfieldError, match=flag.split("=")[0]):
            main(cube_file, "--out", cube_file.with_name("out.blend"), flag)
        assert [path.name for path in cube_file.parent.iterdir()] == [cube_file.name]


class TestFiles:
    """Files and folders."""

    @pytest.mark.parametrize("name", ["nothing.obj", "nothing.blend"])
    def test_missing_input(self, name, cube_file):
        with pytest.raises(FileError, match=name):
            main(cube_file.with_name(name), "--out", cube_file.with_name("out.blend"))

    @pytest.mark.parametrize(
        ("name", "content"), [("a.blend", b"no blend"), ("a.glb", b"no glb"), ("a.gltf", b"{}"), ("a.stl", b""), ("a.xyz", b"")]
    )
    def test_unreadable_input(self, name, content, cube_file):
        path = cube_file.with_name(name)
        path.write_bytes(content)
        with pytest.raises(FarfieldError) as caught:
            main(path, "--out", cube_file.with_name("out.blend"))
        assert str(caught.value).endswith(".")

    def test_input_without_a_surface(self, cube_file):
        path = cube_file.with_name("bare.obj")
        path.write_text("v 0 0 0\nv 1 0 0\nl 1 2\n")
        with pytest.raises(FarfieldError):
            main(path, "--out", cube_file.with_name("out.blend"))

    def test_output_inside_a_file(self, cube_file):
        with pytest.raises(FileError, match="not a folder"):
            main(cube_file, "--out", cube_file / "below" / "out.blend")

    def test_output_is_a_folder(self, cube_file):
        folder = cube_file.with_name("folder.blend")
        folder.mkdir()
        with pytest.raises(FileError, match="is a folder"):
            main(cube_file, "--out", folder)

    @pytest.mark.skipif(os.name == "nt", reason="Windows folders have no mode bits")
    def test_read_only_folder(self, cube_file, monkeypatch):
        locked = cube_file.with_name("locked")
        locked.mkdir()
        locked.chmod(0o500)
        if os.access(locked, os.W_OK):  # the superuser can write anywhere
            monkeypatch.setattr(os, "access", lambda path, _: Path(path) != locked)
        with pytest.raises(FileError, match="read-only"):
            main(cube_file, "--out", locked / "out.blend")
        assert list(locked.iterdir()) == []

    def test_no_space_left_keeps_the_old_file(self, tmp_path):
        old = tmp_path / "report.json"
        old.write_text("old")
        with pytest.raises(FileError, match="No space left"), atomic_output.atomic_file(old) as temporary:
            temporary.write_text("half")
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        assert [path.name for path in tmp_path.iterdir()] == ["report.json"] and old.read_text() == "old"

    def test_cancelling_while_writing_keeps_the_old_file(self, tmp_path):
        old = tmp_path / "report.json"
        old.write_text("old")
        with pytest.raises(KeyboardInterrupt), atomic_output.atomic_file(old) as temporary:
            temporary.write_text("half")
            raise KeyboardInterrupt
        assert [path.name for path in tmp_path.iterdir()] == ["report.json"] and old.read_text() == "old"


@pytest.fixture
def cube_file(tmp_path):
    """A file with a cube, in its own folder."""
    add_cube()
    folder = tmp_path / "with spaces äß"
    folder.mkdir()
    path = folder / "cube.obj"
    bpy.ops.wm.obj_export(filepath=str(path), export_materials=False)
    return path


def main(*arguments):
    """Run the script in this process; raises its errors."""
    billboards.main([str(argument) for argument in arguments], command_line.ProgressLine())
