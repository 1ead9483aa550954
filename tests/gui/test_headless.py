"""The Blender program without a window runs the scripts like pip's bpy: same results, exit codes and messages."""

import json
import math
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
def pebble(tmp_path):
    """A file with an irregular ball: no two choices are equally good, so that the rounding of another NumPy version has no effect."""
    bpy.ops.mesh.primitive_uv_sphere_add()
    for vertex in bpy.context.object.data.vertices:
        x, y, z = vertex.co
        vertex.co *= 1.0 + 0.1 * math.sin(2.3 * x + 1.1 * y) + 0.07 * math.cos(3.1 * z - 1.7 * y + 0.4 * x)
    path = tmp_path / "kiesel ü.obj"
    bpy.ops.wm.obj_export(filepath=str(path), export_materials=False)
    return path


def test_both_build_the_same_cloud(pebble):
    reports = []
    for index, run in enumerate((run_in_blender, run_with_pip_bpy)):
        out, report_path = pebble.with_name(f"{index}.blend"), pebble.with_name(f"{index}.json")
        outcome = run(pebble, "--out", out, "--report", report_path, *FLAGS)
        assert outcome.returncode == 0, outcome
        assert out.stat().st_size > 10_000
        assert "Saved" not in outcome.stdout, "messages of Blender reach stdout"
        report = json.loads(report_path.read_text(encoding="utf-8"))
        assert report["uncovered_faces"] == 0 and report["max_plane_distance"] <= 1.0
        reports.append(report["levels"])
    for first, second in zip(*reports, strict=True):
        assert first["quads"] == second["quads"]
        assert first["texels"] == pytest.approx(second["texels"], rel=0.01)


def test_invalid_input_is_an_error_message_and_code_2(pebble):
    outcome = run_in_blender(pebble.with_name("nowhere.obj"), "--out", pebble.with_name("out.blend"))
    assert outcome.returncode == 2
    assert "nowhere.obj" in outcome.stderr and "Traceback" not in outcome.stderr
