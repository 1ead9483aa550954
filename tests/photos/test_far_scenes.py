"""Scenes at the coordinates of maps, where single precision is too coarse: mesh and cameras are moved to a local origin."""

import json
from dataclasses import replace

import bpy
import numpy as np
import pytest

import photos
from farfield.addon.bridge.imaging.images import read_pixels
from farfield.addon.bridge.photos.camera_objects import import_mesh
from farfield.addon.core.errors import FileError
from farfield.addon.core.files.far_meshes import find_file_origin, near_origin
from farfield.addon.core.geometry.local_origin import find_local_origin
from image_data import read_image, write_image
from lib import command_line
from photo_scenes import SIZE, grid, photograph, ring, smooth_texture

pytestmark = pytest.mark.usefixtures("empty_scene", "quick_merges")
ORIGIN = np.array([500_000.0, 4_500_000.0, 100.0])
MOVED = "were moved by (-500,000; -4,500,000; -100), since their coordinates are too large for single precision."


@pytest.fixture
def scene(tmp_path):
    """A folder with the square of `grid` at ORIGIN as .obj file, three photographs and their cameras."""
    mesh, uvs = grid(10)
    frames = []
    (tmp_path / "images").mkdir()
    for camera in ring(3):
        write_image(tmp_path / "images" / camera.name, photograph(mesh, uvs, smooth_texture(), camera).pixels[::-1])
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = camera.rotation.T @ np.diag([1.0, -1.0, -1.0]), camera.position + ORIGIN
        frames.append({"file_path": f"images/{camera.name}", "transform_matrix": matrix.tolist()})
    lens = {"w": camera.lens.size[0], "h": camera.lens.size[1], "fl_x": camera.lens.focal[0]}
    (tmp_path / "transforms.json").write_text(json.dumps(lens | {"frames": frames}), encoding="utf-8")
    (tmp_path / "mesh.mtl").write_text("newmtl Holz\nmap_Kd -bm 1 0.png\n", encoding="utf-8")
    write_image(tmp_path / "0.png", np.full((2, 2, 3), 9, np.uint8))
    write_obj(tmp_path / "mesh.obj", replace(mesh, vertices=mesh.vertices + ORIGIN), uvs)
    return tmp_path


def write_obj(path, mesh, uvs):
    lines = ["mtllib mesh.mtl", *(f"v {x!r} {y!r} {z!r} 0.5 0.5 0.5" for x, y, z in mesh.vertices.tolist())]
    lines += ["usemtl Holz"]
    lines += [f"vt {u:.9g} {v:.9g}" for u, v in uvs.reshape(-1, 2)]
    for index, corners in enumerate(mesh.triangles + 1):
        lines.append("f " + " ".join(f"{corner}/{3 * index + k + 1}" for k, corner in enumerate(corners)))
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def signal_to_noise(found):
    """Of a texture (H, W, 3), row 0 at the bottom, in decibels."""
    inner = np.s_[8:-8, 8:-8]
    return -10.0 * np.log10(np.mean((found - smooth_texture())[inner] ** 2))


@pytest.mark.slow
def test_the_script_moves_mesh_and_cameras(scene):
    texture, out = scene / "t.png", scene / "out.blend"
    arguments = ("--cameras", scene / "transforms.json", "--images", scene / "images", "--texture", texture, "--out", out, "--size", SIZE)
    message = photos.main([str(each) for each in (scene / "mesh.obj", *arguments)], command_line.ProgressLine())
    assert message.endswith(f"Mesh and cameras {MOVED}")
    assert signal_to_noise(read_image(texture)[0][::-1, :, :3] / 255.0) > 45.0
    photos.scene_files.open_scene(out)
    [item] = [item for item in bpy.context.scene.objects if item.type == "MESH"]
    assert np.abs([vertex.co for vertex in item.data.vertices]).max() == 1.0


def test_the_operator_imports_cameras_with_their_mesh(scene, capfd):
    imported = {"filepath": str(scene / "transforms.json"), "mesh": str(scene / "mesh.obj"), "draw_overlays": False}
    assert bpy.ops.farfield.photos_import_cameras(**imported) == {"FINISHED"}
    assert f"Mesh and cameras {MOVED}" in capfd.readouterr().out
    assert list(bpy.data.objects["Photo Cameras"]["farfield_origin"]) == ORIGIN.tolist()
    bpy.context.view_layer.update()
    assert bpy.ops.farfield.photos_merge(size=SIZE) == {"FINISHED"}
    assert signal_to_noise(read_pixels(bpy.data.images["mesh Photo Texture"])[..., :3]) > 45.0


def test_cameras_alone_are_moved_too(scene, capfd):
    assert bpy.ops.farfield.photos_import_cameras(filepath=str(scene / "transforms.json")) == {"FINISHED"}
    assert "Cameras were moved by (-500,000; -4,500,000; -100)" in capfd.readouterr().out
    bpy.context.view_layer.update()
    found = [list(item.matrix_world.translation) for item in bpy.data.objects["Photo Cameras"].children]
    assert found == pytest.approx(np.array([camera.position for camera in ring(3)]), abs=1e-5)


@pytest.mark.slow
def test_a_mesh_that_blender_has_rounded_is_named(scene, capfd):
    bpy.ops.wm.obj_import(filepath=str(scene / "mesh.obj"), forward_axis="Y", up_axis="Z")
    bpy.ops.farfield.photos_import_cameras(filepath=str(scene / "transforms.json"), draw_overlays=False)
    bpy.data.objects["Photo Cameras"].location = ORIGIN
    bpy.context.view_layer.update()
    assert bpy.ops.farfield.photos_merge(size=16) == {"FINISHED"}
    assert "rounded its coordinates to multiples of 0.5" in capfd.readouterr().out


def test_materials_keep_their_images(scene):
    photos.read_objects(scene / "mesh.obj", None)
    assert [image.filepath for image in bpy.data.images if image.source == "FILE"] == [str(scene / "0.png")]


def ply_header(kind, number):
    lines = ["ply", f"format {kind} 1.0", "comment made by hand", "element vertex 4", *(f"property {number} {axis}" for axis in "xyz")]
    lines += ["property uchar red", "element face 1", "property list uchar int vertex_indices", "end_header"]
    return "\n".join(lines).encode() + b"\n"


SQUARE = np.array([[0.25, 0.5, 0.0], [7.0, 0.125, 0.0], [7.0, 9.0, 0.0], [0.0, 9.0, 1.0]])


def write_ply(path, kind, number="double"):
    vertices = SQUARE + ORIGIN
    if kind == "ascii":
        body = "".join(f"{x!r} {y!r} {z!r} 7\n" for x, y, z in vertices.tolist()) + "4 0 1 2 3\n"
        path.write_bytes(ply_header(kind, number) + body.encode())
        return
    order = "<" if kind == "binary_little_endian" else ">"
    size = "f8" if number == "double" else "f4"
    rows = np.zeros(4, [("x", order + size), ("y", order + size), ("z", order + size), ("red", "u1")])
    for index, axis in enumerate("xyz"):
        rows[axis] = vertices[:, index]
    face = np.array([0, 1, 2, 3], order + "i4").tobytes()
    path.write_bytes(ply_header(kind, number) + rows.tobytes() + b"\x04" + face)


@pytest.mark.parametrize("kind", ["ascii", "binary_little_endian", "binary_big_endian"])
def test_ply_files_keep_their_digits(tmp_path, kind):
    write_ply(tmp_path / "a.ply", kind)
    with near_origin(tmp_path / "a.ply") as (path, origin):
        assert origin == pytest.approx(ORIGIN)
        bpy.ops.wm.ply_import(filepath=str(path))
    mesh = bpy.context.object.data
    assert np.array([vertex.co for vertex in mesh.vertices]) == pytest.approx(SQUARE, abs=1e-6)
    assert [list(polygon.vertices) for polygon in mesh.polygons] == [[0, 1, 2, 3]]


def test_files_that_need_no_move_are_read_as_they_are(tmp_path):
    write_ply(tmp_path / "single.ply", "binary_little_endian", "float")
    mesh, uvs = grid(3)
    write_obj(tmp_path / "near.obj", mesh, uvs)
    (tmp_path / "damaged.obj").write_text("v 500000 x 1\n", encoding="utf-8")
    (tmp_path / "damaged.ply").write_bytes(ply_header("ascii", "double") + b"500000\n")
    (tmp_path / "a.glb").write_bytes(b"")
    for path in tmp_path.iterdir():
        assert find_file_origin(path) is None
        with near_origin(path) as (near, origin):
            assert (near, origin) == (path, None)


@pytest.mark.parametrize(
    ("points", "origin"),
    [
        ([[0.0, 0.0, 0.0], [1.0, 1.0, 1.0]], None),
        ([[100.0, 0.0, 0.0], [103.0, 1.0, 1.0]], None),
        ([[500_003.0, 4_500_001.0, 7.0], [500_018.0, 4_500_010.0, 9.0]], [500_000.0, 4_500_000.0, 0.0]),
        ([[500_000.0, 0.0, 0.0], [600_000.0, 1.0, 1.0]], None),
        ([[5e5, 5e5, 0.0]], None),
        ([[np.nan, 0.0, 0.0]], None),
    ],
)
def test_the_local_origin_has_few_digits(points, origin):
    found = find_local_origin(np.array(points))
    assert (found is None) if origin is None else found.tolist() == origin


def test_a_mesh_with_an_impossible_header_is_refused(tmp_path):
    """Blender's reader would end the program."""
    header = ply_header("binary_little_endian", "double").replace(b"vertex 4", b"vertex 2000000000")
    (tmp_path / "a.ply").write_bytes(header)
    with pytest.raises(FileError, match="more than the file can hold"):
        import_mesh(tmp_path / "a.ply", is_y_up=False)
