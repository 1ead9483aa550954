"""The Blender program without a window makes and analyzes levels of textured meshes with the script."""

import json
import subprocess

import pytest

from gui.blender_program import find_launcher
from lib import blender_window, environment, scene_files
from textured_scenes import textured_ball

pytestmark = [pytest.mark.gui, pytest.mark.usefixtures("empty_scene")]
SCRIPT = environment.ROOT / "scripts" / "texmesh.py"


def run_in_blender(*arguments) -> subprocess.CompletedProcess:
    """Run the script with `blender --background --python`."""
    command = [find_launcher(), "headless", "-t", "300", "--", "--factory-startup", "--python", SCRIPT, "--", *arguments]
    variables = blender_window.launcher_variables()
    return subprocess.run(command, cwd=environment.ROOT, env=variables, capture_output=True, text=True, errors="replace", check=False)


@pytest.fixture
def ball(tmp_path):
    """A file with a textured ball of 528 triangles."""
    textured_ball(12, "Ball")
    scene_files.save_scene(tmp_path / "ball.blend")
    return tmp_path / "ball.blend"


def test_levels_and_analysis(ball):
    report, plot = ball.with_name("report.json"), ball.with_name("plot.png")
    finished = run_in_blender(
        "levels", ball, "--out", ball.with_name("out.glb"), "--report", report, "--ratios", "0.5,0.2", "--views", "2", "--max-image", "64"
    )
    assert finished.returncode == 0, finished.stderr
    counts = [level["triangles"] for level in json.loads(report.read_text("utf-8"))["objects"][0]["levels"]]
    assert counts == [528, 264, 106] and all(ball.with_name(f"out-L{number}.glb").exists() for number in range(3))
    finished = run_in_blender("analyze", ball, "--plot", plot)
    assert finished.returncode == 0 and plot.read_bytes().startswith(b"\x89PNG")


def test_invalid_input_is_an_error_message_and_code_2(ball):
    finished = run_in_blender("levels", ball, "--out", ball.with_name("out.obj"))
    assert finished.returncode == 2 and "it must end in one of .blend, .glb" in finished.stderr
