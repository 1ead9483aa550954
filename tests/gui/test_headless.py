"""The Blender program without a window runs the scripts like pip's bpy: same results, exit codes and messages."""

import json
import subprocess
import sys

import bpy
import pytest

from gui.blender_program import find_launcher
from lib import blender_window, environment

pytestmark = [pytest.mark.gui, pytest.mark.usefixtures("empty_scene")]
SCRIPT = environment.ROOT / "scripts" / "billboards.py"
FLAGS = ["--error", "5%", "--levels", "2", "--nested-levels", "--samples", "1"]


def run_in_blender(*arguments):
    """Run the script with `blender --background --python`."""
    command = [find_launcher(), "headless", "-t", "300", "--", "--factory-startup", "--python", SCRIPT, "--", *arguments]
    variables = blender_window.launcher_variables()
    return subprocess.run(command, cwd=environment.ROOT, env=variables, capture_output=True, text=True, errors="replace", check=False)


def run_with_pip_bpy(*arguments):
    """Run the script with this Python."""
    return subprocess.run([sys.executable, SCRIPT, *arguments], capture_output=True, text=True, errors="replace", check=False)


@pytest.fixture
def boxes(tmp_path):
    """A file with three boxes of different shapes: planes of flat sides do not depend on the rounding of another NumPy version."""
    for position, size in ((0.0, (1.0, 0.8, 0.6)), (1.3, (0.9, 0.5, 0.7)), (2.4, (0.6, 1.1, 0.8))):
        bpy.ops.mesh.primitive_cube_add(size=1.0, location=(position, 0.2 * position, 0.0), rotation=(position, 0.3, 0.5 * position))
        bpy.context.object.scale = size
    path = tmp_path / "würfel.obj"
    bpy.ops.wm.obj_export(filepath=str(path), export_materials=False)
    return path


def test_both_build_the_same_cloud(boxes):
    reports = []
    for index, run in enumerate((run_in_blender, run_with_pip_bpy)):
        out, report_path = boxes.with_name(f"{index}.blend"), boxes.with_name(f"{index}.json")
        outcome = run(boxes, "--out", out, "--report", report_path, *FLAGS)
        assert outcome.returncode == 0, outcome
        assert out.stat().st_size > 10_000
        assert "Saved" not in outcome.stdout, "messages of Blender reach stdout"
        report = json.loads(report_path.read_text(encoding="utf-8"))
        assert report["uncovered_faces"] == 0 and report["max_plane_distance"] <= 1.0
        reports.append(report["levels"])
    for first, second in zip(*reports, strict=True):
        assert first["quads"] == second["quads"] >= 3
        assert first["texels"] == pytest.approx(second["texels"], rel=0.01)


def test_invalid_input_is_an_error_message_and_code_2(boxes):
    outcome = run_in_blender(boxes.with_name("nowhere.obj"), "--out", boxes.with_name("out.blend"))
    assert outcome.returncode == 2
    assert "nowhere.obj" in outcome.stderr and "Traceback" not in outcome.stderr
