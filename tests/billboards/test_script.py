"""`scripts/billboards.py`: all input and output formats, the report, and the exit codes."""

import io
import json
import os
import signal
import subprocess
import sys
import time

import bpy
import numpy as np
import pytest

import billboards
from farfield.addon.bridge.lod_crossfade import CROSSFADE
from farfield.addon.core.errors import FileError, GeometryError
from farfield.addon.core.jobs.progress import Progress
from lib import command_line, environment, scene_files
from mesh_files import CUBE

pytestmark = pytest.mark.usefixtures("empty_scene")
SCRIPT = environment.ROOT / "scripts" / "billboards.py"
REPORT_KEYS = {
    "source_triangles",
    "dropped_triangles",
    "triangles",
    "mesh_triangles",
    "quads",
    "texels",
    "levels",
    "max_plane_distance",
    "faces_beyond_normal_bound",
    "uncovered_faces",
    "notes",
    "skipped",
    "seconds",
    "peak_memory_mb",
}


@pytest.fixture
def cube(tmp_path):
    """A file with a cube of side 2, whose path has spaces and non-ASCII characters."""
    folder = tmp_path / "été à la mer"
    folder.mkdir()
    path = folder / "würfel 立方体.obj"
    path.write_text(CUBE, encoding="utf-8")
    return path


def main(*arguments):
    """Run the script in this process; raises its errors. Returns its result."""
    return billboards.main([str(argument) for argument in arguments], command_line.ProgressLine())


def cloud_levels():
    """Return the level objects in the open file, finest first."""
    return sorted((item for item in bpy.data.objects if item.get("farfield_kind") == "cloud"), key=lambda item: item.name)


@pytest.mark.slow
def test_invalid_input_is_one_line_and_code_2(cube):
    command = [sys.executable, str(SCRIPT), str(cube.with_name("nowhere.obj")), "--out", str(cube.with_name("out.blend"))]
    missing = subprocess.run(command, capture_output=True, text=True, check=False)
    assert missing.returncode == 2
    assert missing.stderr.strip().count("\n") == 0 and "nowhere.obj" in missing.stderr and "Traceback" not in missing.stderr
    assert list(cube.parent.iterdir()) == [cube]


def test_blend_output_with_report(cube):
    out, figures = cube.with_name("wolke Ω.blend"), cube.with_name("figures.json")
    main(cube, "--out", out, "--error", "10%", "--levels", "2", "--nested-levels", "--samples", "1", "--report", figures)
    assert sorted(path.name for path in cube.parent.iterdir()) == sorted([cube.name, out.name, figures.name])

    report = json.loads(figures.read_text(encoding="utf-8"))
    assert set(report) == REPORT_KEYS
    assert report["source_triangles"] == 12 and report["dropped_triangles"] == 0 and report["uncovered_faces"] == 0
    assert report["quads"] == report["levels"][0]["quads"] == 6
    assert report["triangles"] == report["levels"][0]["triangles"] == 12
    assert report["notes"] == ['The cloud of "würfel 立方体" has 12 triangles, its source 12: no error would make it lighter.']
    assert report["max_plane_distance"] <= 1.0
    assert [set(level) for level in report["levels"]] == [
        {
            "error",
            "triangles",
            "mesh_triangles",
            "quads",
            "texels",
            "atlas_use",
            "switch_distance",
            "visible_difference",
            "decimate_visible_difference",
        }
    ] * 2
    assert all(level["visible_difference"] is None for level in report["levels"]), "the levels are as heavy as the source"
    assert report["levels"][0]["error"] == pytest.approx(0.2) and report["levels"][1]["error"] == pytest.approx(0.4)
    assert {"read", "capture", "objects", "write"} <= set(report["seconds"]) and report["peak_memory_mb"] > 10

    bpy.ops.wm.open_mainfile(filepath=str(out))
    levels = cloud_levels()
    assert [level["farfield_quads"] for level in levels] == [level["quads"] for level in report["levels"]]
    assert len(bpy.data.meshes) == 3 and not levels[0].hide_render and levels[1].hide_render


def test_cross_fade_needs_camera_and_blend_output(cube):
    scene_files.open_scene(cube)
    with pytest.raises(GeometryError, match="the file has none"):
        main(cube, "--out", cube.with_name("out.blend"), "--cross-fade")
    scene_files.open_scene(cube)
    bpy.ops.object.camera_add()
    bpy.context.scene.camera = bpy.context.object
    with_camera, out = cube.with_name("kamera.blend"), cube.with_name("out.blend")
    bpy.ops.wm.save_as_mainfile(filepath=str(with_camera))
    with pytest.raises(FileError, match=r"end in \.blend"):
        main(with_camera, "--out", cube.with_name("out.glb"), "--cross-fade")
    flags = ("--levels", "2", "--nested-levels", "--error", "5%", "--samples", "1", "--cross-fade", "--fade-range", "50%")
    main(with_camera, "--out", out, *flags)
    bpy.ops.wm.open_mainfile(filepath=str(out))
    assert [level[CROSSFADE][2] for level in cloud_levels()] == [0.5, 0.5]
    assert not any(level.hide_render for level in cloud_levels())


@pytest.mark.parametrize("keep", [False, True])
def test_source_is_hidden_unless_kept(cube, keep):
    out = cube.with_name("out.blend")
    summary = main(cube, "--out", out, "--no-textures", "--levels", "1", *(["--keep-original-visible"] if keep else []))
    assert summary.startswith("Built ")
    bpy.ops.wm.open_mainfile(filepath=str(out))
    (level,) = cloud_levels()
    (source,) = (item for item in bpy.data.objects if item != level)
    assert source.hide_viewport == source.hide_render == (not keep)
    assert not level.hide_viewport and not level.hide_render


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="Windows has no SIGINT to send to one process")
def test_cancelling_is_code_130_and_leaves_no_files(cube):
    out = cube.with_name("out.blend")
    process = subprocess.Popen(
        [sys.executable, "-u", str(SCRIPT), str(cube), "--out", str(out), "--error", "5%", "--levels", "1", "--samples", "1", "--verbose"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    for line in process.stdout:
        if "Saved" in line:  # the first capture is done
            break
    process.send_signal(signal.SIGINT)
    started = time.monotonic()
    _, errors = process.communicate(timeout=120)
    assert process.returncode == 130, errors
    assert errors.strip() == "Cancelled."
    assert time.monotonic() - started < 60
    assert [path.name for path in cube.parent.iterdir()] == [cube.name]


@pytest.mark.slow
@pytest.mark.parametrize("extension", [".blend", ".ply", ".stl", ".glb", ".gltf", ".fbx", ".usd"])
def test_input_formats(extension, cube):
    scene_files.open_scene(cube)
    path = cube.with_name(f"cube 立方体{extension}")
    export = {
        ".blend": lambda: bpy.ops.wm.save_as_mainfile(filepath=str(path)),
        ".ply": lambda: bpy.ops.wm.ply_export(filepath=str(path)),
        ".stl": lambda: bpy.ops.wm.stl_export(filepath=str(path)),
        ".glb": lambda: bpy.ops.export_scene.gltf(filepath=str(path), export_format="GLB"),
        ".gltf": lambda: bpy.ops.export_scene.gltf(filepath=str(path), export_format="GLTF_SEPARATE"),
        ".fbx": lambda: bpy.ops.export_scene.fbx(filepath=str(path)),
        ".usd": lambda: bpy.ops.wm.usd_export(filepath=str(path)),
    }[extension]
    export()
    figures = cube.with_name("figures.json")
    main(path, "--out", cube.with_name("out.blend"), "--no-textures", "--error", "5%", "--levels", "1", "--report", figures)
    report = json.loads(figures.read_text(encoding="utf-8"))
    assert report["source_triangles"] == 12 and report["quads"] == 6


def test_point_cloud_input(cube):
    height, angle = np.meshgrid(np.linspace(0.0, 1.0, 20), np.linspace(0.0, 2.0 * np.pi, 60, endpoint=False))
    points = np.column_stack([np.cos(angle).ravel(), np.sin(angle).ravel(), height.ravel()])
    path, figures = cube.with_name("points.ply"), cube.with_name("figures.json")
    head = f"ply\nformat ascii 1.0\nelement vertex {len(points)}\nproperty float x\nproperty float y\nproperty float z\nend_header\n"
    path.write_text(head + "\n".join(" ".join(f"{value:.6f}" for value in point) for point in points) + "\n")
    main(path, "--out", cube.with_name("out.blend"), "--no-textures", "--error", "5%", "--levels", "1", "--report", figures)
    report = json.loads(figures.read_text(encoding="utf-8"))
    assert report["quads"] >= 3 and report["uncovered_faces"] == 0


def test_obj_output_has_the_same_quads(cube):
    out = cube.with_name("cloud out.obj")
    main(cube, "--out", out, "--error", "10%", "--levels", "2", "--nested-levels", "--samples", "1")
    corners = [sorted(tuple(np.round(level.matrix_basis @ v.co, 4)) for v in level.data.vertices) for level in cloud_levels()]
    names = {path.name for path in cube.parent.iterdir()}
    assert names == {cube.name, out.name, "cloud out.mtl", *(path.name for path in cube.parent.glob("cloud out_*_L[01].png"))}
    assert len(names) == 5

    scene_files.open_scene(out)
    objects = sorted(bpy.data.objects, key=lambda item: item.name)
    assert len(objects) == 2
    for item, expected in zip(objects, corners, strict=True):
        assert len(item.data.polygons) == 6 and item.data.uv_layers
        read = sorted(tuple(np.round(item.matrix_world @ v.co, 4)) for v in item.data.vertices)
        assert np.allclose(read, expected, atol=1e-3)
        textures = [node.image for node in item.data.materials[0].node_tree.nodes if node.type == "TEX_IMAGE"]
        assert textures and all(image.has_data or image.size[0] for image in textures)

    materials = out.with_suffix(".mtl")
    assert materials.read_text(encoding="utf-8").startswith("# Farfield\n"), "by which a later run recognizes its own file"
    for path in (out, materials):
        path.write_text("# of the user\n", encoding="utf-8")
    with pytest.raises(FileError, match=r"would replace .*cloud out\.mtl.*which Farfield did not write"):
        main(cube, "--out", out)
    assert materials.read_text(encoding="utf-8") == "# of the user\n"


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", [pytest.param("cloud.glb", marks=pytest.mark.exhaustive), "...glb"]
)  # Blender's exporter finds no extension in the second
def test_glb_output_has_textures_and_properties(cube, name):
    out = cube.with_name(name)
    main(cube, "--out", out, "--error", "10%", "--levels", "2", "--nested-levels", "--samples", "1")
    figures = [level["farfield_quads"] for level in cloud_levels()]
    before = {path.name for path in cube.parent.iterdir()}
    assert before == {cube.name, out.name}

    scene_files.open_scene(out)
    levels = cloud_levels()
    assert [level["farfield_quads"] for level in levels] == figures
    for level in levels:
        nodes = level.data.materials[0].node_tree.nodes
        assert any(node.type == "TEX_IMAGE" and node.image.size[0] > 1 for node in nodes)
        assert max(level.dimensions) == pytest.approx(2.0, abs=0.5)


def test_glb_output_for_an_orthographic_camera(tmp_path):
    """It always shows the error of these levels: their switch distance is infinite, which no .glb can store."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    bpy.ops.mesh.primitive_cube_add()
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    camera.data.type, camera.data.ortho_scale = "ORTHO", 0.5
    bpy.context.scene.collection.objects.link(camera)
    bpy.context.scene.camera = camera
    scene_files.save_scene(tmp_path / "in.blend")
    result = main(tmp_path / "in.blend", "--out", tmp_path / "out.glb", "--error", "10%", "--levels", "1", "--samples", "1")
    assert result.endswith('The .glb lacks farfield_switch_distance of "Cube Cloud L0".')
    scene_files.open_scene(tmp_path / "out.glb")
    (level,) = cloud_levels()
    assert "farfield_error" in level and "farfield_switch_distance" not in level


@pytest.mark.exhaustive  # `test_build` compares the clouds of equal seeds.
def test_equal_seeds_give_equal_reports(cube):
    reports = []
    for index in range(2):
        figures = cube.with_name(f"{index}.json")
        main(cube, "--out", cube.with_name("out.blend"), "--no-textures", "--error", "3%", "--seed", "7", "--report", figures)
        report = json.loads(figures.read_text(encoding="utf-8"))
        reports.append({key: value for key, value in report.items() if key not in {"seconds", "peak_memory_mb"}})
    assert reports[0] == reports[1]


@pytest.mark.parametrize("name", ["out.txt", "out", "out.gltf"])
def test_unknown_output_extension_is_rejected(cube, name):
    with pytest.raises(FileError, match=r"\.blend, \.obj, \.glb"):
        main(cube, "--out", cube.with_name(name))


def test_progress_line_is_shown_only_on_terminals(monkeypatch):
    class Terminal(io.StringIO):
        def isatty(self):
            return True

    for stream, expected in ((Terminal(), True), (io.StringIO(), False)):
        monkeypatch.setattr(sys, "stderr", stream)
        line = command_line.ProgressLine()
        line.show(Progress(0.5, "Clustering"))
        line.show(Progress(0.5, "Clustering"))
        line.clear()
        assert ("50% Clustering" in stream.getvalue()) is expected
        assert stream.getvalue().count("Clustering") == int(expected)


def test_first_ctrl_c_cancels_at_next_step_and_second_immediately():
    line = command_line.ProgressLine()
    line.show(Progress(0.5, "Clustering"))
    line.request_cancel(signal.SIGINT, None)  # must not raise: Cycles would swallow the exception
    with pytest.raises(KeyboardInterrupt):
        line.show(Progress(0.6, "Clustering"))
    with pytest.raises(KeyboardInterrupt):
        line.request_cancel(signal.SIGINT, None)


@pytest.mark.parametrize(
    "flags",
    [
        ("--out", "würfel 立方体.obj"),
        ("--out", "out.blend", "--report", "out.blend"),
        ("--out", "out.blend", "--report", "würfel 立方体.obj"),
        ("--out", "out.obj", "--report", "out.mtl"),
    ],
)
def test_outputs_replace_neither_each_other_nor_the_input(cube, flags):
    with pytest.raises(FileError, match="same file"):
        main(cube, *(flag if flag.startswith("--") else cube.with_name(flag) for flag in flags), "--no-textures")
    assert [path.name for path in cube.parent.iterdir()] == [cube.name] and cube.read_text(encoding="utf-8") == CUBE


def test_a_scene_is_changed_in_place(cube):
    scene_files.open_scene(cube)
    path = cube.with_name("scene.blend")
    scene_files.save_scene(path)
    main(path, "--out", path, "--no-textures", "--levels", "1", "--error", "10%")
    scene_files.open_scene(path)
    assert len(cloud_levels()) == 1


def test_names_in_a_scene_choose_no_paths_and_break_no_lines(cube):
    scene_files.open_scene(cube)
    bpy.data.objects[0].name = "../A/B\nnewmtl C"
    path, out = cube.with_name("names.blend"), cube.with_name("o\nut.obj")
    scene_files.save_scene(path)
    main(path, "--out", out, "--error", "10%", "--levels", "2", "--nested-levels", "--samples", "1")
    names = {item.name for item in cube.parent.iterdir()}
    pictures = {name for name in names if name.endswith(".png")}
    assert names == {cube.name, path.name, out.name, "o_ut.mtl"} | pictures and len(pictures) == 2
    scene_files.open_scene(out)
    assert len(bpy.data.objects) == 2
    for item in bpy.data.objects:
        nodes = item.data.materials[0].node_tree.nodes
        assert all(node.image.size[0] for node in nodes if node.type == "TEX_IMAGE")


@pytest.mark.skipif(sys.platform != "linux", reason="other systems have no file names that are not Unicode")
def test_an_output_name_that_is_not_unicode_is_refused(cube, capsys):
    """Neither Blender nor a JSON report can name it."""
    with pytest.raises(SystemExit, match="2"):
        main(cube, "--out", cube.with_name("\udcff.obj"), "--error", "10%", "--levels", "1", "--no-textures")
    assert "is not valid UTF-8 text" in capsys.readouterr().err
    assert [path.name for path in cube.parent.iterdir()] == [cube.name]


def test_an_object_that_is_disabled_in_renders_is_named(cube):
    scene_files.open_scene(cube)
    bpy.data.objects[0].hide_render = True
    path = cube.with_name("hidden.blend")
    scene_files.save_scene(path)
    with pytest.raises(GeometryError, match="disabled in renders"):
        main(path, "--out", cube.with_name("out.blend"))
    cube.with_name("empty.obj").write_text("# nothing\n")
    with pytest.raises(GeometryError, match="no mesh"):
        main(cube.with_name("empty.obj"), "--out", cube.with_name("out.blend"))
    cube.with_name("empty.obj").write_text("")
    with pytest.raises(FileError, match="is empty"):
        main(cube.with_name("empty.obj"), "--out", cube.with_name("out.blend"))
