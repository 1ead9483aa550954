"""The button in a real window: a tree, the bar, Esc, a finished cloud, undo."""

import json
import os
import shutil
import subprocess
from pathlib import Path

import pytest

import environment
from gui.blender_program import launcher

SECONDS = 400

pytestmark = pytest.mark.gui


@pytest.fixture(scope="module")
def seen(tmp_path_factory) -> dict:
    """What a visitor to a Blender window with this checkout installed saw; see drive.py."""
    resources, findings = tmp_path_factory.mktemp("blender"), tmp_path_factory.mktemp("seen")
    install(resources / "extensions" / "user_default" / "farfield")
    drive = shutil.copy(Path(__file__).with_name("drive.py"), resources)
    command = [launcher(), "run", "-s", "1400x1000", "-t", str(SECONDS), "--", "--factory-startup", "--enable-event-simulate"]
    log = subprocess.run(
        [*command, "--python", drive, "--", findings],
        cwd=environment.ROOT,
        env=os.environ | {"BLENDER_USER_RESOURCES": str(resources)},
        capture_output=True,
        text=True,
        errors="replace",
        check=False,
    )
    result = findings / "seen.json"
    assert result.exists(), f"Blender ended with {log.returncode} and left no findings:\n{log.stdout[-3000:]}\n{log.stderr[-3000:]}"
    print(f"pictures and findings: {findings}")
    print(*(line for line in (log.stdout + log.stderr).splitlines() if "Error" in line or "Traceback" in line), sep="\n")
    return json.loads(result.read_text(encoding="utf-8"))


def install(folder: Path) -> None:
    """Put this checkout where Blender looks for extensions."""
    folder.mkdir(parents=True)
    for name in ("__init__.py", "blender_manifest.toml"):
        shutil.copy(environment.ROOT / name, folder)
    shutil.copytree(environment.ROOT / "addon", folder / "addon", ignore=shutil.ignore_patterns("__pycache__"))


def test_the_visit_went_through(seen):
    assert seen["error"] is None, seen["error"]


def test_the_bar_moved_forwards(seen):
    fractions = seen["fractions"]
    assert len(set(fractions)) >= 3
    assert fractions == sorted(fractions) and fractions[0] >= 0.0 and fractions[-1] <= 1.0


@pytest.mark.parametrize("half", ["core", "scene"])
def test_esc_stopped_the_job_with_the_scene_as_it_was(seen, half):
    stopped = seen["stopped"][half]
    assert stopped["running"], "the job had ended before Esc was pressed"
    assert 0.0 < stopped["fractions"][-1] < 1.0
    assert stopped["after"] == seen["before"]


def test_the_finished_job_left_a_cloud_in_levels(seen):
    assert seen["levels"] == ["Tree Cloud L0", "Tree Cloud L1", "Tree Cloud L2"]


def test_one_undo_takes_all_of_it_back(seen):
    assert seen["after_undo"]["objects"] == seen["before"]["objects"]
    assert seen["after_undo"]["collections"] == seen["before"]["collections"]
