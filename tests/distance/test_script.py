"""`scripts/distance.py`: the scene that it writes, the report, and invalid input."""

import json

import bpy
import pytest

import distance
from distance_scenes import add_box, add_camera, shown
from farfield.addon.core.errors import GeometryError, SettingsError
from lib import command_line
from textured_scenes import textured_ball

pytestmark = pytest.mark.usefixtures("empty_scene", "few_samples", "quick_levels")


def run(*arguments: object) -> str:
    return distance.main([str(argument) for argument in arguments], command_line.ProgressLine())


@pytest.fixture
def scene_file(tmp_path):
    """A ball far away from the camera, in a file whose path has spaces and non-ASCII letters."""
    add_camera()
    textured_ball(5, "Balle").location = (0.0, 5000.0, 0.0)
    path = tmp_path / "forêt à la mer.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    return path


@pytest.mark.slow
def test_the_scene_and_the_report(scene_file):
    out, report = scene_file.with_name("ready.blend"), scene_file.with_name("report.json")
    message = run(scene_file, "--out", out, "--report", report, "--min-triangles", "10", "--no-billboard-cloud")
    assert message.startswith("Distance-ready: 1 object at 1 place; this frame has ")
    (figures,) = json.loads(report.read_text(encoding="utf-8"))["objects"]
    assert figures["name"] == "Balle" and figures["places"] == 1 and len(figures["levels"]) >= 2
    bpy.ops.wm.open_mainfile(filepath=str(out))
    assert shown() == [(f"Balle Level {len(figures['levels']) - 1}", (0, 5000, 0))]


def test_input_that_cannot_be_made_ready(tmp_path):
    add_box("Box")
    path = tmp_path / "box.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    with pytest.raises(GeometryError, match="1 object with too few triangles"):
        run(path, "--out", tmp_path / "out.blend")
    with pytest.raises(GeometryError, match="Neither Perceptual Levels nor Billboard Cloud is on"):
        run(path, "--out", tmp_path / "out.blend", "--no-perceptual-levels", "--no-billboard-cloud")
    with pytest.raises(SettingsError, match="--max-error"):
        run(path, "--out", tmp_path / "out.blend", "--max-error", "100")
    assert not (tmp_path / "out.blend").exists()
