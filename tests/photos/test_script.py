"""`scripts/photos.py`: from files to a texture, its maps, the textured mesh and the report."""

import json
from dataclasses import replace
from functools import cache

import bpy
import numpy as np
import pytest

import photos
from farfield.addon.bridge.geometry.mesh_arrays import read_loop_triangles, read_uvs
from farfield.addon.core.errors import FileError, GeometryError, ImageError
from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.core.unwrap.overlaps import count_overlaps
from image_data import read_image, write_image
from lib import command_line
from photo_scenes import SIZE, detailed_texture, grid, photograph, ring, smooth_texture

pytestmark = pytest.mark.usefixtures("empty_scene", "quick_merges", "coarse_packing")


def run(*arguments):
    return photos.main([str(argument) for argument in arguments], command_line.ProgressLine())


def write_cameras(folder, cameras):
    folder.mkdir()
    lens = cameras[0].lens
    numbers = (lens.focal[0], *lens.center)
    (folder / "cameras.txt").write_text(f"1 SIMPLE_PINHOLE {lens.size[0]} {lens.size[1]} {' '.join(map(str, numbers))}\n", encoding="utf-8")
    lines = []
    for index, camera in enumerate(cameras, start=1):
        w = 0.5 * np.sqrt(max(1.0 + np.trace(camera.rotation), 1e-12))
        r = camera.rotation
        quaternion = (w, (r[2, 1] - r[1, 2]) / (4 * w), (r[0, 2] - r[2, 0]) / (4 * w), (r[1, 0] - r[0, 1]) / (4 * w))
        lines += [f"{index} {' '.join(repr(float(v)) for v in (*quaternion, *camera.translation))} 1 {camera.name}", ""]
    (folder / "images.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")


def write_obj(path, mesh, corner_uvs=None):
    lines = [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in mesh.vertices]
    if corner_uvs is not None:
        lines += [f"vt {u:.9g} {v:.9g}" for u, v in corner_uvs.reshape(-1, 2)]
    for index, corners in enumerate(mesh.triangles + 1):
        lines.append("f " + " ".join(f"{c}/{3 * index + k + 1}" if corner_uvs is not None else str(c) for k, c in enumerate(corners)))
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


@cache
def take_photographs():
    """The photographs of the mesh by a ring of three cameras."""
    mesh, uvs = grid(10, lambda x, y: 0.1 * np.sin(2 * x + y))
    return [photograph(mesh, uvs, smooth_texture(), camera) for camera in ring(3)]


@pytest.fixture
def folder(tmp_path):
    """A folder with a mesh, three photographs and their cameras."""
    folder = tmp_path / "été à la mer 樹"
    folder.mkdir()
    mesh, uvs = grid(10, lambda x, y: 0.1 * np.sin(2 * x + y))
    write_cameras(folder / "cameras", ring(3))
    (folder / "images").mkdir()
    for each in take_photographs():
        write_image(folder / "images" / each.camera.name, each.pixels[::-1])
    write_obj(folder / "with uvs.obj", mesh, uvs)
    write_obj(folder / "without.obj", mesh)
    return folder


def inputs(folder, mesh="with uvs.obj"):
    return (folder / mesh, "--cameras", folder / "cameras", "--images", folder / "images", "--size", SIZE)


@pytest.mark.parametrize(
    "extension", [".glb", pytest.param(".obj", marks=pytest.mark.exhaustive), pytest.param(".blend", marks=pytest.mark.exhaustive)]
)
def test_texture_maps_mesh_and_report_are_written(folder, extension):
    texture, out, report = folder / "t.png", folder / f"out{extension}", folder / "report.json"
    assert run(*inputs(folder), "--texture", texture, "--out", out, "--report", report).startswith("Merged 3 photographs into t.png")
    found = read_image(texture)[0][::-1].astype(np.float32) / 255.0
    inner = np.s_[6:-6, 6:-6]
    assert np.sqrt(np.mean((found - smooth_texture())[inner] ** 2)) < 0.02
    for name in ("confidence", "source", "holes"):
        assert read_image(folder / f"t.{name}.png")[0].shape[:2] == (SIZE, SIZE)
    figures = json.loads(report.read_text(encoding="utf-8"))
    assert figures["size"] == SIZE and figures["unwrapped"] == []
    assert [each["name"] for each in figures["photographs"]] == ["0.png", "1.png", "2.png"]
    photos.scene_files.open_scene(out)
    [item] = [item for item in bpy.context.scene.objects if item.type == "MESH"]
    assert len(item.data.polygons) == 200 and item.data.materials


@pytest.mark.slow
def test_stages_are_pictures(folder):
    run(*inputs(folder), "--texture", folder / "t.png", "--stages", folder / "stages")
    names = sorted(path.name for path in (folder / "stages").iterdir())
    assert names == ["classes.png", "interpolated.png", "photographed.png", "used.0.png", "used.1.png", "used.2.png"]
    photographed, interpolated = (read_image(folder / "stages" / f"{name}.png")[0] for name in ("photographed", "interpolated"))
    holes = read_image(folder / "t.holes.png")[0][..., 0] > 0
    assert (photographed[holes] == 0).all() and np.array_equal(photographed[~holes], interpolated[~holes])


@pytest.mark.slow
def test_photographs_of_one_name_in_several_folders_have_pictures_of_their_own(folder):
    for index in range(3):
        (folder / "images" / f"{index}").mkdir()
        (folder / "images" / f"{index}.png").rename(folder / "images" / f"{index}" / "a.0001.png")
    write_cameras(folder / "named", [replace(camera, name=f"{index}\\a.0001") for index, camera in enumerate(ring(3))])
    arguments = ("--images", folder / "images", "--size", 32, "--texture", folder / "t.png")
    message = run(folder / "with uvs.obj", "--cameras", folder / "named", *arguments, "--stages", folder / "s", "--overlays", folder / "o")
    assert message.startswith("Merged 3 photographs")
    assert sorted(path.name for path in (folder / "o").iterdir()) == [f"a.0001{each}.overlay.png" for each in ("", "_2", "_3")]
    assert {path.name for path in (folder / "s").glob("used.*")} == {f"used.a.0001{each}.png" for each in ("", "_2", "_3")}


@pytest.mark.slow
def test_cameras_are_refined(folder):
    mesh, uvs = grid(10, lambda x, y: 0.1 * np.sin(2 * x + y))
    cameras = ring(3)
    for camera in cameras:
        write_image(folder / "images" / camera.name, photograph(mesh, uvs, detailed_texture(), camera).pixels[::-1])
    wrong = replace(cameras[2], translation=cameras[2].translation + (0.04, -0.03, 0.0))
    write_cameras(folder / "moved", [*cameras[:2], wrong])
    arguments = (folder / "with uvs.obj", "--cameras", folder / "moved", "--images", folder / "images", "--size", SIZE)
    arguments = (*arguments, "--texture", folder / "t.png", "--report", folder / "report.json")
    assert run(*arguments, "--refine", "2.png").startswith("Refined 1 of 1 camera. Merged 3 photographs")
    [moved] = json.loads((folder / "report.json").read_text(encoding="utf-8"))["refined"]
    assert moved["name"] == "2.png" and moved["problem"] is None and moved["pixels_after"] < 0.2 < 3.0 < moved["pixels_before"]
    with pytest.raises(FileError, match=r'--refine names "9\.png"'):
        run(*arguments, "--refine", "9.png")


def test_a_mesh_without_uvs_is_unwrapped(folder):
    report = folder / "report.json"
    run(*inputs(folder, "without.obj"), "--texture", folder / "t.png", "--report", report)
    figures = json.loads(report.read_text(encoding="utf-8"))
    assert figures["unwrapped"] == ["without"] and figures["texels"] > 0.4 * SIZE**2


@pytest.mark.exhaustive
def test_equal_input_gives_equal_bytes(folder):
    for name in ("a.png", "b.png"):
        run(*inputs(folder), "--texture", folder / name, "--method", "best")
    assert (folder / "a.png").read_bytes() == (folder / "b.png").read_bytes()


def test_bad_input_is_one_sentence_and_writes_nothing(folder):
    def fails(kind, words, *arguments):
        with pytest.raises(kind, match=words) as caught:
            run(*arguments, "--texture", folder / "t.png")
        assert "\n" not in str(caught.value) and not list(folder.glob("t.*"))

    fails(FileError, "There are no cameras in", folder / "with uvs.obj", "--cameras", folder, "--images", folder / "images")
    fails(FileError, 'There is no photograph "0.png"', folder / "with uvs.obj", "--cameras", folder / "cameras", "--images", folder)
    write_image(folder / "images" / "1.png", np.zeros((20, 30, 3), np.uint8))
    fails(ImageError, 'photograph "1.png" has 30 x 20 pixels, but its camera 300 x 240', *inputs(folder))
    with pytest.raises(FileError, match=r"must end in \.png"):
        run(*inputs(folder), "--texture", folder / "t.jpg")


@pytest.mark.slow
def test_a_mesh_far_away_says_so(folder):
    mesh, uvs = grid(3)
    mesh.vertices[:] += 100.0
    write_obj(folder / "far.obj", mesh, uvs)
    with pytest.raises(GeometryError, match="No vertex of the mesh lies in the frame"):
        run(*inputs(folder, "far.obj"), "--texture", folder / "t.png", "--overlays", folder / "overlays")
    written = sorted(path.name for path in (folder / "overlays").iterdir())
    assert written == [f"{index}.overlay.png" for index in range(3)], "they show what is wrong"


def test_masked_pixels_are_not_used(folder):
    """The masks of all photographs but the second exclude everything, which that of the second leaves."""
    masks = folder / "masks"
    masks.mkdir()
    black = np.zeros((240, 300, 1), np.uint8)
    write_image(masks / "0.png", black)
    write_image(masks / "2.png.png", black)
    report = folder / "report.json"
    run(*inputs(folder), "--masks", masks, "--texture", folder / "t.png", "--report", report)
    texels = [each["texels"] for each in json.loads(report.read_text(encoding="utf-8"))["photographs"]]
    assert texels[0] == texels[2] == 0 < texels[1]
    write_image(masks / "0.png", black[:100])
    with pytest.raises(ImageError, match=r"has 300 x 100 pixels, but its photograph 300 x 240"):
        run(*inputs(folder), "--masks", masks, "--texture", folder / "u.png")
    with pytest.raises(FileError, match="There is no mask of a photograph in"):
        run(*inputs(folder), "--masks", folder, "--texture", folder / "u.png")


def test_meshes_without_uv_maps_do_not_overlap_in_the_texture(empty_scene):
    for x in (0.0, 3.0):
        bpy.ops.mesh.primitive_plane_add(calc_uvs=False, location=(x, 0.0, 0.0))
    items = list(bpy.context.scene.objects)
    assert photos.unwrap_missing(items, command_line.ProgressLine()) == [item.name for item in items]
    corner_uvs = [read_uvs(item.data.uv_layers["Unwrap"])[read_loop_triangles(item.data)[0]].astype(float) for item in items]
    assert run_to_end(count_overlaps(np.concatenate(corner_uvs))) == 0
