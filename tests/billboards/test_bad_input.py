"""Bad and odd input: each refusal is one clear sentence and leaves nothing behind; what only looks odd is built."""

import errno
import math
import os
import subprocess
import sys
from pathlib import Path

import bpy
import numpy as np
import pytest

import billboards
import command_line
import environment
import whole_files
from farfield.addon.core.errors import FarfieldError, FileError

pytestmark = pytest.mark.usefixtures("empty_scene")
SQUARE = [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (1.0, 1.0, 0.0), (0.0, 1.0, 0.0)]


def add(name, vertices, faces, edges=()):
    """A selected mesh object."""
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(vertices, edges, faces)
    added = bpy.data.objects.new(name, mesh)
    bpy.context.collection.objects.link(added)
    bpy.context.view_layer.update()
    added.select_set(True)
    bpy.context.view_layer.objects.active = added
    return added


def add_cube(name="Cube", scale=(1.0, 1.0, 1.0)):
    """A selected cube of side 2 under a scale."""
    bpy.ops.mesh.primitive_cube_add()
    cube = bpy.context.object
    cube.name, cube.scale = name, scale
    bpy.context.view_layer.update()
    return cube


def build(**properties):
    """Build one rough level without textures."""
    return bpy.ops.farfield.billboards_build(**({"error": 5.0, "levels": 1, "textures": False} | properties))


def level():
    """The one level that was made."""
    (made,) = (item for item in bpy.data.objects if item.get("farfield_kind") == "cloud")
    return made


def counts():
    """How much of everything there is in the file."""
    kinds = ("objects", "meshes", "materials", "images", "collections", "scenes", "node_groups", "cameras")
    return {kind: len(getattr(bpy.data, kind)) for kind in kinds}


def refuse(**properties):
    """The sentence of a refusal that left nothing behind."""
    before = counts()
    with pytest.raises(RuntimeError) as caught:
        build(**properties)
    assert counts() == before
    sentence = str(caught.value).removeprefix("Error: ").strip()
    assert sentence.endswith(".") and "\n" not in sentence and "Traceback" not in sentence
    return sentence


class TestGeometry:
    """What a mesh may be."""

    def test_empty_mesh(self):
        add("Empty One", [], [])
        assert "Empty One" in refuse()

    def test_no_faces(self):
        add("Wire", SQUARE, [], edges=[(0, 1)])
        assert "Wire (no faces)" in refuse()

    @pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
    def test_coordinates_that_are_no_numbers(self, value):
        add("Broken", [*SQUARE[:3], (value, 1.0, 0.0)], [(0, 1, 2, 3)])
        sentence = refuse()
        assert "Broken" in sentence and "not finite" in sentence

    def test_only_faces_without_area(self):
        add("Line", [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (2.0, 0.0, 0.0)], [(0, 1, 2)])
        sentence = refuse()
        assert "Line" in sentence and "zero area" in sentence

    def test_all_in_one_place(self):
        add("Dot", [(1.0, 1.0, 1.0)] * 3, [(0, 1, 2)])
        assert "one place" in refuse()

    def test_faces_without_area_among_others_are_dropped(self):
        add("Mixed", [*SQUARE, (0.5, 0.0, 0.0)], [(0, 1, 2, 3), (0, 1, 4)])
        build()
        assert level()["farfield_quads"] == 1

    def test_a_flat_mesh_is_one_quad(self):
        bpy.ops.mesh.primitive_grid_add(x_subdivisions=8, y_subdivisions=8)
        build()
        assert level()["farfield_quads"] == 1
        assert max(level().dimensions) == pytest.approx(2.0, rel=0.1)

    def test_duplicate_and_non_manifold_faces_are_fine(self):
        third = (0.5, 0.5, 1.0)
        add("Fan", [*SQUARE, third, (0.5, 0.5, -1.0)], [(0, 1, 2, 3), (0, 1, 4), (0, 1, 5), (1, 0, 4)])
        assert build() == {"FINISHED"}
        assert level()["farfield_quads"] >= 2


class TestTransforms:
    """Where an object may stand and how it may be scaled."""

    @pytest.mark.parametrize("unit", [1e-6, 1e6])
    def test_tiny_and_enormous_units(self, unit):
        add_cube(scale=(unit, unit, unit))
        build()
        assert level()["farfield_quads"] == 6
        assert level()["farfield_error"] == pytest.approx(0.05 * 2.0 * unit, rel=1e-4)

    @pytest.mark.parametrize("unit", [1e-6, 1e6])
    def test_textures_at_tiny_and_enormous_units(self, unit):
        add_cube(scale=(unit, unit, unit))
        build(textures=True, samples=1)
        image = next(node.image for node in level().data.materials[0].node_tree.nodes if node.label == "Front colour")
        pixels = np.array(image.pixels[:]).reshape(-1, 4)
        assert pixels[:, 3].max() == pytest.approx(1.0, abs=0.02)

    @pytest.mark.parametrize("scale", [(-1.0, 1.0, 1.0), (-1.0, -1.0, -1.0), (1.0, 3.0, 0.2), (-2.0, 1.0, 0.5)])
    def test_mirrored_and_uneven_scale_keep_the_outside_outside(self, scale):
        add_cube(scale=scale)
        build(error=1.0)
        made = level()
        assert made["farfield_quads"] == 6
        for polygon in made.data.polygons:
            assert polygon.normal.dot(polygon.center) > 0.0

    def test_a_scale_of_zero_is_flat_and_becomes_one_quad_or_two(self):
        add_cube(scale=(1.0, 1.0, 0.0))
        build()
        assert 1 <= level()["farfield_quads"] <= 2


class TestMaterials:
    """What a material may lack."""

    def test_missing_image_files_are_named_before_any_work(self, tmp_path):
        cube = add_cube()
        material = bpy.data.materials.new("Painted")
        if material.node_tree is None:
            material.use_nodes = True
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
        sentence = refuse(textures=True)
        assert "Lost" in sentence and "Painted" in sentence and path.name in sentence
        assert build(textures=False) == {"FINISHED"}

    def test_empty_material_slots_are_grey(self):
        add_cube().data.materials.append(None)
        build(textures=True, samples=1, error=10.0)
        assert level().data.materials[0] is not None


class TestSettings:
    """What a setting may be, in a script."""

    @pytest.mark.parametrize("flag", ["--error=0", "--error=-1%", "--error=5000%", "--error=nan", "--levels=0", "--samples=0"])
    def test_absurd_numbers(self, flag, cube_file):
        with pytest.raises(FarfieldError, match=flag.split("=")[0]):
            main(cube_file, "--out", cube_file.with_name("out.blend"), flag)
        assert [path.name for path in cube_file.parent.iterdir()] == [cube_file.name]


class TestFiles:
    """What a file or folder may be."""

    @pytest.mark.parametrize("name", ["nothing.obj", "nothing.blend"])
    def test_missing_input(self, name, cube_file):
        with pytest.raises(FileError, match=name):
            main(cube_file.with_name(name), "--out", cube_file.with_name("out.blend"))

    @pytest.mark.parametrize(
        ("name", "content"), [("a.blend", b"no blend"), ("a.glb", b"no glb"), ("a.gltf", b"{}"), ("a.stl", b""), ("a.xyz", b"")]
    )
    def test_input_that_cannot_be_read(self, name, content, cube_file):
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

    def test_out_below_a_file(self, cube_file):
        with pytest.raises(FileError, match="not a folder"):
            main(cube_file, "--out", cube_file / "below" / "out.blend")

    def test_out_is_a_folder(self, cube_file):
        folder = cube_file.with_name("folder.blend")
        folder.mkdir()
        with pytest.raises(FileError, match="is a folder"):
            main(cube_file, "--out", folder)

    @pytest.mark.skipif(os.name == "nt", reason="Windows folders have no mode bits")
    def test_folder_that_must_not_be_written(self, cube_file, monkeypatch):
        locked = cube_file.with_name("locked")
        locked.mkdir()
        locked.chmod(0o500)
        if os.access(locked, os.W_OK):  # the superuser may write anywhere
            monkeypatch.setattr(whole_files.os, "access", lambda path, _: Path(path) != locked)
        with pytest.raises(FileError, match="read-only"):
            main(cube_file, "--out", locked / "out.blend")
        assert list(locked.iterdir()) == []

    @pytest.mark.parametrize("ending", ["blend", "obj", "glb"])
    def test_full_disk(self, ending, cube_file):
        """A limit on the size of files is met like the end of a disk, by Blender's own writers too."""
        resource = pytest.importorskip("resource")
        out = cube_file.with_name(f"out.{ending}")
        script, flags = environment.ROOT / "scripts" / "billboards.py", ["--no-textures", "--error", "2%", "--levels", "1"]
        outcome = subprocess.run(
            [sys.executable, str(script), str(cube_file), "--out", str(out), *flags],
            preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (64, 64)),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
            env=os.environ | {"PYTHONDONTWRITEBYTECODE": "1"},
            check=False,
        )
        assert outcome.returncode == 2, outcome.stderr
        assert "Traceback" not in outcome.stderr and outcome.stderr.strip()
        assert [path.name for path in cube_file.parent.iterdir()] == [cube_file.name]

    def test_no_space_left_is_said_and_the_old_file_stays(self, tmp_path):
        old = tmp_path / "report.json"
        old.write_text("old")
        with pytest.raises(FileError, match="No space left"), whole_files.whole_file(old) as temporary:
            temporary.write_text("half")
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        assert [path.name for path in tmp_path.iterdir()] == ["report.json"] and old.read_text() == "old"

    def test_stopping_while_writing_leaves_the_old_file(self, tmp_path):
        old = tmp_path / "report.json"
        old.write_text("old")
        with pytest.raises(KeyboardInterrupt), whole_files.whole_file(old) as temporary:
            temporary.write_text("half")
            raise KeyboardInterrupt
        assert [path.name for path in tmp_path.iterdir()] == ["report.json"] and old.read_text() == "old"


@pytest.fixture
def cube_file(tmp_path):
    """A cube in a file in a folder of its own."""
    add_cube()
    folder = tmp_path / "with spaces äß"
    folder.mkdir()
    path = folder / "cube.obj"
    bpy.ops.wm.obj_export(filepath=str(path), export_materials=False)
    return path


def main(*arguments):
    """The script in this process; raises what it would have said."""
    billboards.main([str(argument) for argument in arguments], command_line.ProgressLine())
