"""A Blender program without a window runs the scripts as pip's bpy does: same figures, same exit codes, same sentence."""

import json
import math
import subprocess
import sys

import bpy
import pytest

import environment
from gui.blender_program import launcher

pytestmark = [pytest.mark.gui, pytest.mark.usefixtures("empty_scene")]
SCRIPT = environment.ROOT / "scripts" / "billboards.py"
FLAGS = ["--error", "5%", "--levels", "2", "--samples", "1"]


def in_blender(*arguments):
    """The script under `blender --background --python`."""
    command = [launcher(), "headless", "-t", "300", "--", "--factory-startup", "--python", SCRIPT, "--", *arguments]
    return subprocess.run(command, cwd=environment.ROOT, capture_output=True, text=True, errors="replace", check=False)


@pytest.fixture
def pebble(tmp_path):
    """An irregular ball in a file: no two choices are equally good, so the rounding of another NumPy decides none."""
    bpy.ops.mesh.primitive_uv_sphere_add()
    for vertex in bpy.context.object.data.vertices:
        x, y, z = vertex.co
        vertex.co *= 1.0 + 0.1 * math.sin(2.3 * x + 1.1 * y) + 0.07 * math.cos(3.1 * z - 1.7 * y + 0.4 * x)
    path = tmp_path / "kiesel ü.obj"
    bpy.ops.wm.obj_export(filepath=str(path), export_materials=False)
    return path


def test_the_same_cloud(pebble):
    reports = []
    for number, run in enumerate((in_blender, lambda *arguments: subprocess.run([sys.executable, SCRIPT, *arguments], check=False))):
        out, figures = pebble.with_name(f"{number}.blend"), pebble.with_name(f"{number}.json")
        outcome = run(pebble, "--out", out, "--report", figures, *FLAGS)
        assert outcome.returncode == 0, outcome
        assert out.stat().st_size > 10_000
        report = json.loads(figures.read_text(encoding="utf-8"))
        assert report["uncovered_faces"] == 0 and report["max_plane_distance"] <= 1.0
        reports.append(report["levels"])
    for first, second in zip(*reports, strict=True):
        assert first["quads"] == second["quads"]
        assert first["texels"] == pytest.approx(second["texels"], rel=0.01)


def test_the_same_refusal(pebble):
    outcome = in_blender(pebble.with_name("nowhere.obj"), "--out", pebble.with_name("out.blend"))
    assert outcome.returncode == 2
    assert "nowhere.obj" in outcome.stderr and "Traceback" not in outcome.stderr
