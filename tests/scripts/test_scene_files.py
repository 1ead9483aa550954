"""Files that Blender reads for scripts: broken ones are one sentence, never a crash."""

import os
import struct
from pathlib import Path

import bpy
import pytest

from farfield.addon.bridge.geometry import meshes
from farfield.addon.core.errors import FileError, GeometryError
from farfield.addon.core.files.outputs import Output, check_outputs
from farfield.addon.core.files.ply_headers import read_ply_header
from lib import scene_files

pytestmark = pytest.mark.usefixtures("empty_scene")
VERTEX = "property float x\nproperty float y\nproperty float z\n"


def ply(path, counts, content, file_format="binary_little_endian"):
    """Write a .ply with these elements and contents."""
    header = f"ply\nformat {file_format} 1.0\n{counts}end_header\n"
    path.write_bytes(header.encode() + content)
    return path


@pytest.mark.parametrize(
    "counts",
    [
        f"element vertex 4000000000\n{VERTEX}",
        f"element vertex 2000000000\n{VERTEX}",
        f"element vertex {'9' * 5000}\n{VERTEX}",
        f"element vertex -1\n{VERTEX}",
        f"element vertex many\n{VERTEX}",
        f"element vertex\n{VERTEX}",
        f"element vertex 1\n{VERTEX}element face 1000000\nproperty list uchar int vertex_indices\n",
        "element vertex 1\nproperty quaternion x\n",
        "property float x\n",
        "element vertex 2000000000\n",
    ],
)
@pytest.mark.parametrize("file_format", ["ascii", "binary_little_endian", "binary_big_endian"])
def test_absurd_ply_headers(counts, file_format, tmp_path):
    path = ply(tmp_path / "a.ply", counts, b"0 0 0\n", file_format)
    with pytest.raises(FileError) as caught:
        scene_files.open_scene(path)
    message = str(caught.value)
    assert "header" in message and message.endswith(".") and "\n" not in message and len(message) < 400


@pytest.mark.parametrize("content", [b"", b"ply\n", b"no ply\nend_header\n", b"ply\nformat ascii 1.0\n"])
def test_files_without_a_ply_header(content, tmp_path):
    (tmp_path / "a.ply").write_bytes(content)
    with pytest.raises(FileError, match="no PLY header"):
        read_ply_header(tmp_path / "a.ply")


def test_a_header_with_lines_that_begin_with_a_space(tmp_path):
    """Blender's own reader may end the program."""
    path = ply(tmp_path / "a.ply", f" element vertex 3\n{VERTEX}", b"0 0 0\n1 0 0\n0 1 0\n", "ascii")
    with pytest.raises(FileError, match="begins with a space"):
        read_ply_header(path)


def test_valid_headers_are_read(tmp_path):
    counts = f"comment made by hand\nelement vertex 3\n{VERTEX}element face 1\nproperty list uchar int vertex_indices\n"
    corners = [(0, 0, 0), (1, 0, 0), (0, 1, 0)]
    contents = {
        "ascii": b"0 0 0\n1 0 0\n0 1 0\n3 0 1 2",
        "binary_little_endian": b"".join(struct.pack("<3f", *corner) for corner in corners) + struct.pack("<B3i", 3, 0, 1, 2),
    }
    for file_format, content in contents.items():
        scene_files.open_scene(ply(tmp_path / "a.ply", counts, content, file_format))
        (item,) = bpy.data.objects
        assert len(item.data.polygons) == 1
    with pytest.raises(FileError, match="truncated"):
        scene_files.open_scene(ply(tmp_path / "a.ply", counts, contents["binary_little_endian"][:30]))


def test_input_that_is_not_a_file(tmp_path):
    with pytest.raises(FileError, match="is a folder"):
        scene_files.open_scene(tmp_path)
    with pytest.raises(FileError, match="shorter name"):
        scene_files.open_scene(tmp_path / ("a" * 300 + ".obj"))


@pytest.mark.skipif(os.name == "nt", reason="Windows has no such paths")
@pytest.mark.parametrize("extension", [".stl", ".obj", ".blend", ".glb"])
def test_paths_that_are_no_text(extension, tmp_path, monkeypatch):
    """Blender's operators raise errors of Python for them."""
    path = tmp_path / f"\udcff{extension}"
    path.write_bytes(b"v 0 0 0\n")
    with pytest.raises(FileError, match="not valid UTF-8 text"):
        scene_files.open_scene(path)
    with pytest.raises(FileError, match="not valid UTF-8 text"):
        scene_files.save_scene(path)
    (tmp_path / "\udcfe").mkdir()
    monkeypatch.chdir(tmp_path / "\udcfe")
    with pytest.raises(FileError, match="not valid UTF-8 text"):
        check_outputs([Output("--out", Path("out.blend"))], [])


def test_importers_print_nothing_but_the_sentence(tmp_path, capfd):
    for name, content in (("a.usda", b"#usda 1.0\ndef {"), ("a.usd", b"no usd"), ("a.glb", b"no glb"), ("a.blend", b"no blend")):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(FileError) as caught:
            scene_files.open_scene(tmp_path / name)
        assert str(caught.value).endswith(".") and "\n" not in str(caught.value)
    assert capfd.readouterr().err == ""


def test_files_without_anything_to_render(tmp_path):
    with pytest.raises(GeometryError, match="no mesh"):
        scene_files.objects_in_renders(tmp_path / "a.obj")
    bpy.ops.mesh.primitive_cube_add()
    cube = bpy.context.object
    assert scene_files.objects_in_renders(tmp_path) == [cube]
    cube.hide_render = True
    with pytest.raises(GeometryError, match=r"disabled in renders \(Cube\)"):
        scene_files.objects_in_renders(tmp_path)


def test_a_saved_scene_adds_no_library(tmp_path):
    scene_files.save_scene(tmp_path / "a.blend")
    assert not bpy.data.libraries and not bpy.data.filepath


def test_no_python_of_a_scene_runs(tmp_path):
    """Neither text blocks that are registered nor drivers, unless Blender is told to trust the file."""
    marker, path = tmp_path / "marker", tmp_path / "a.blend"
    text = bpy.data.texts.new("run.py")
    text.write(f"open({str(marker)!r}, 'a').close()")
    text.use_module = True
    item = bpy.data.objects.new("Item", None)
    bpy.context.scene.collection.objects.link(item)
    item.driver_add("location", 0).driver.expression = f"1.0 if open({str(marker)!r}, 'a').close() is None else 2.0"
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    marker.unlink(missing_ok=True)
    scene_files.open_scene(path)
    bpy.context.view_layer.update()
    bpy.context.scene.frame_set(2)
    assert not marker.exists()
    bpy.ops.wm.open_mainfile(filepath=str(path), use_scripts=True)
    assert marker.exists(), "the text would have run"


def add_instance(name: str, collection: bpy.types.Collection) -> bpy.types.Object:
    item = bpy.data.objects.new(name, None)
    item.instance_type, item.instance_collection = "COLLECTION", collection
    bpy.context.scene.collection.objects.link(item)
    return item


def test_instances_of_collections_are_surfaces_but_no_meshes():
    collection = bpy.data.collections.new("Parts")
    collection.objects.link(bpy.data.objects.new("Part", bpy.data.meshes.new("Part")))
    item = add_instance("Shown", collection)
    assert scene_files.objects_in_renders(None) == [item]
    with pytest.raises(GeometryError, match=r"There is no mesh in the scene, only instances of collections \(Shown\); make them real"):
        scene_files.objects_in_renders(None, scene_files.is_mesh)
    assert scene_files.describe_unread() == ["Shown (an instance of a collection; make it real)"]


def test_a_missing_library_is_named(tmp_path):
    bpy.ops.mesh.primitive_cube_add()
    collection = bpy.data.collections.new("Parts")
    bpy.context.scene.collection.children.link(collection)
    collection.objects.link(bpy.context.object)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "parts.blend"))
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    with bpy.data.libraries.load(str(tmp_path / "parts.blend"), link=True) as (source, target):
        target.objects, target.collections = source.objects, source.collections
    bpy.context.scene.collection.objects.link(target.objects[0])
    item = add_instance("Shown", target.collections[0])
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "scene.blend"))
    (tmp_path / "parts.blend").unlink()
    scene_files.open_scene(tmp_path / "scene.blend")
    item = bpy.data.objects["Shown"]
    assert meshes.explain_no_faces(item).startswith('no faces, because the library "')
    assert [text.split(" (")[0] for text in scene_files.describe_missing()] == ["Cube", "Parts"]
    with pytest.raises(GeometryError, match=r"There is no mesh in the scene: Cube \(the library .* is missing\)"):
        scene_files.objects_in_renders(None, scene_files.is_mesh)


def test_shapes_of_bones_are_no_meshes_of_the_file():
    bpy.ops.mesh.primitive_ico_sphere_add()
    shape = bpy.context.object
    bpy.ops.object.armature_add()
    bpy.context.object.pose.bones[0].custom_shape = shape
    with pytest.raises(GeometryError, match="There is no mesh in the scene; give a file"):
        scene_files.objects_in_renders(None)
