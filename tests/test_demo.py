"""The demo leaves what it promises, refuses what it cannot do, and its page says what its figures say."""

import json
import subprocess
import sys

import pytest

import environment
from demo_report import markdown

CUBE = """v -1 -1 -1\nv 1 -1 -1\nv 1 1 -1\nv -1 1 -1\nv -1 -1 1\nv 1 -1 1\nv 1 1 1\nv -1 1 1
f 1 4 3 2\nf 5 6 7 8\nf 1 2 6 5\nf 2 3 7 6\nf 3 4 8 7\nf 4 1 5 8
"""


def run_demo(*arguments) -> subprocess.CompletedProcess:
    command = [sys.executable, str(environment.ROOT / "scripts" / "demo.py"), *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, encoding="utf-8", check=False)


@pytest.mark.slow
def test_the_demo_leaves_scene_sheet_and_figures(tmp_path):
    pytest.importorskip("bpy")
    mesh = tmp_path / "würfel.obj"
    mesh.write_text(CUBE, encoding="utf-8")
    out = tmp_path / "out folder"
    ran = run_demo("--quick", "--input", mesh, "--out", out)
    assert ran.returncode == 0, ran.stderr
    assert sorted(path.name for path in out.iterdir()) == ["contact-sheet.png", "demo.blend", "report.json", "report.md"]
    assert (out / "contact-sheet.png").read_bytes().startswith(b"\x89PNG")
    report = json.loads((out / "report.json").read_text(encoding="utf-8"))
    assert report["source_triangles"] == 12
    assert [level["quads"] for level in report["levels"]] == [6, 6, 6]
    pictures = report["levels"][0]["pictures"]
    assert len(pictures["views"]) == 6
    assert pictures["mean_alpha_iou"] > 0.95
    assert "12 triangles as 6 quads" in (out / "report.md").read_text(encoding="utf-8")


def test_a_missing_input_is_named_and_nothing_is_left(tmp_path):
    pytest.importorskip("bpy")
    ran = run_demo("--quick", "--input", tmp_path / "none.obj", "--out", tmp_path / "out")
    assert ran.returncode == 2
    assert "none.obj" in ran.stderr
    assert "Traceback" not in ran.stderr
    assert not (tmp_path / "out").exists()


def test_the_page_tells_every_level_and_view():
    view = {"direction": [0.6, 0.0, 0.8], "ssim": 0.9, "alpha_iou": 0.95}
    pictures = {"mean_ssim": 0.9, "mean_alpha_iou": 0.95, "setting": "one sun", "views": [view]}
    fine = {"error": 0.01, "quads": 1234, "texels": 5678, "switch_distance": 12.5, "pictures": pictures}
    coarse = {"error": 0.02, "quads": 99, "texels": 100, "switch_distance": None}
    page = markdown("A ball", {"levels": [fine, coarse], "seconds": {"capture": 1.25}, "peak_memory_mb": 512.0})
    assert page.startswith("# A ball\n")
    assert "| 0 | 0.01 | 1,234 | 5,678 | 12.5 | 0.900 | 0.950 |" in page
    assert "| 1 | 0.02 | 99 | 100 | never | not compared | not compared |" in page
    assert "| 0.60, 0.00, 0.80 | 0.900 | 0.950 |" in page
