"""`scripts/unwrap.py`: kinds of files in and out, the report, and the exit codes."""

import json
import subprocess
import sys

import bpy
import numpy as np
import pytest

import command_line
import environment
import unwrap
from charts import dome
from farfield.addon.core.errors import FileError, GeometryError, SettingsError
from shapes import sphere

pytestmark = pytest.mark.usefixtures("empty_scene")
SCRIPT = environment.ROOT / "scripts" / "unwrap.py"
FIGURES = ("l2", "linf", "p95", "p99", "symmetric_dirichlet", "flips", "overlaps", "min_shape", "fill", "seconds", "density_ratio")


@pytest.fixture
def head(tmp_path):
    """A ball in a file whose path has spaces and letters beyond ASCII."""
    folder = tmp_path / "été à la mer"
    folder.mkdir()
    return written(folder / "tête.obj", sphere(12))


def written(path, mesh):
    lines = [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in mesh.vertices]
    lines += [f"f {a} {b} {c}" for a, b, c in mesh.triangles + 1]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def run(*arguments):
    unwrap.main([str(each) for each in arguments], command_line.ProgressLine())


@pytest.mark.parametrize("ending", [".obj", ".glb", ".blend"])
def test_every_kind_of_file_holds_the_map(head, ending):
    out, report = head.with_name(f"out{ending}"), head.with_name("report.json")
    run(head, "--out", out, "--report", report)
    figures = json.loads(report.read_text(encoding="utf-8"))
    assert set(FIGURES) <= set(figures)
    assert figures["flips"] == figures["overlaps"] == 0
    unwrap.scene_files.open_scene(out)
    [item] = [item for item in bpy.context.scene.objects if item.type == "MESH"]
    assert len(item.data.uv_layers) == 1 and len(item.data.polygons) == len(sphere(12).triangles)
    values = np.empty(2 * len(item.data.loops), np.float32)
    item.data.uv_layers[0].uv.foreach_get("vector", values)
    assert np.ptp(values) > 0.5


def test_a_direction_alone_asks_for_importance(tmp_path):
    path = written(tmp_path / "dome.obj", dome(20))
    report = tmp_path / "report.json"
    run(path, "--out", tmp_path / "out.blend", "--direction", "-0,-1,0", "--density-ratio", "2", "--report", report)
    assert json.loads(report.read_text())["density_ratio"] == pytest.approx(2.0, rel=0.1)


@pytest.mark.parametrize("boundary", ["square", "circle"])
def test_a_fixed_border(tmp_path, boundary):
    path = written(tmp_path / "dome.obj", dome(10))
    report = tmp_path / "report.json"
    run(path, "--out", tmp_path / "out.obj", "--boundary", boundary, "--min-shape", "0", "--report", report)
    figures = json.loads(report.read_text())
    assert figures["fill"] == pytest.approx({"square": 0.984, "circle": 0.773}[boundary], abs=0.02)
    assert figures["flips"] == figures["overlaps"] == 0


def test_the_picture(head):
    run(head, "--out", head.with_name("out.obj"), "--picture", head.with_name("stretch.png"))
    assert head.with_name("stretch.png").stat().st_size > 1000


@pytest.mark.parametrize(
    ("flags", "kind", "words"),
    [
        (("--out", "x.fbx"), FileError, "--out"),
        (("--out", "x.obj", "--picture", "x.jpg"), FileError, ".png"),
        (("--out", "x.obj", "--direction", "0,0,0"), SettingsError, "no length"),
        (("--out", "x.obj", "--direction", "up"), SettingsError, "--direction"),
        (("--out", "x.obj", "--direction", "1,2"), SettingsError, "3 finite numbers"),
        (("--out", "x.obj", "--min-shape", "0.9"), SettingsError, "--min-shape"),
        (("--out", "x.obj", "--importance", "camera"), SettingsError, "no camera"),
        (("--out", "x.obj", "--uv-map", "Unwrap", "--importance", "group", "--group", "Ears"), GeometryError, "Ears"),
    ],
)
def test_bad_input_is_one_sentence_and_leaves_nothing(head, flags, kind, words):
    before = sorted(head.parent.iterdir())
    flags = [head.with_name(word) if word.startswith("x.") else word for word in flags]
    with pytest.raises(kind) as caught:
        run(head, *flags)
    assert words in str(caught.value) and "\n" not in str(caught.value)
    assert sorted(head.parent.iterdir()) == before


def test_the_exit_code_of_bad_input(tmp_path):
    outcome = subprocess.run(
        [sys.executable, str(SCRIPT), str(tmp_path / "none.obj"), "--out", str(tmp_path / "o.obj")], capture_output=True
    )
    assert outcome.returncode == 2
    assert b"none.obj" in outcome.stderr
