"""A Blender program without a window runs the scripts as pip's bpy does: same figures, same exit codes, same sentence."""

import json
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
def sphere(tmp_path):
    """A sphere in a file."""
    bpy.ops.mesh.primitive_uv_sphere_add()
    path = tmp_path / "sphère.obj"
    bpy.ops.wm.obj_export(filepath=str(path), export_materials=False)
    return path


def test_the_same_cloud(sphere):
    reports = []
    for number, run in enumerate((in_blender, lambda *arguments: subprocess.run([sys.executable, SCRIPT, *arguments], check=False))):
        out, figures = sphere.with_name(f"{number}.blend"), sphere.with_name(f"{number}.json")
        outcome = run(sphere, "--out", out, "--report", figures, *FLAGS)
        assert outcome.returncode == 0, outcome
        assert out.stat().st_size > 10_000
        report = json.loads(figures.read_text(encoding="utf-8"))
        assert report["uncovered_faces"] == 0 and report["max_plane_distance"] <= 1.0
        reports.append([(level["quads"], level["texels"]) for level in report["levels"]])
    assert reports[0] == reports[1]


def test_the_same_refusal(sphere):
    outcome = in_blender(sphere.with_name("nowhere.obj"), "--out", sphere.with_name("out.blend"))
    assert outcome.returncode == 2
    assert "nowhere.obj" in outcome.stderr and "Traceback" not in outcome.stderr
