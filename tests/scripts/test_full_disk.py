"""On a full disk nothing is lost: existing files stay, and the error is one sentence. A limit on file sizes simulates the disk."""

import json
import os
import subprocess
import sys

import pytest

from lib import environment

pytest.importorskip("resource")
# Writes a file of each kind once, then again with room for each tenth of it; stores the message of the error and whether the old file is
# as before. One process does it all, because importing bpy takes longer.
CHILD = """
import json, resource, sys
from pathlib import Path
sys.path.insert(0, sys.argv[1])
from lib import environment
farfield = environment.import_farfield()
import bpy, numpy as np
from farfield.addon.bridge.unwrap.stretch_display import save_stretch_image
from farfield.addon.core.errors import FarfieldError
from lib import command_line, scene_files
from lib.atomic_output import atomic_file
from lib.contact_sheet import write_png
import unwrap

farfield.register()
bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
bpy.ops.mesh.primitive_grid_add(x_subdivisions=40, y_subdivisions=40)
bpy.ops.farfield.unwrap()
noise = np.random.default_rng(1).random((60, 60, 3))

def save_image(path):
    with atomic_file(path) as temporary:
        save_stretch_image(bpy.context.object, temporary, 256)

def save_curve(path):
    with atomic_file(path) as temporary:
        write_png(temporary, noise)

writers = {
    "a.blend": scene_files.save_scene, "a.obj": unwrap.write_output, "a.glb": unwrap.write_output, "a.png": save_image, "b.png": save_curve,
    "a.json": lambda path: command_line.write_report(path, {"numbers": list(range(3000))}),
}
hard = resource.getrlimit(resource.RLIMIT_FSIZE)[1]
folder, results = Path(sys.argv[2]), []
for name, write in writers.items():
    path = folder / name
    write(path)
    old = path.read_bytes()
    for room in [*(len(old) * tenth // 10 for tenth in range(10)), len(old) - 1]:
        resource.setrlimit(resource.RLIMIT_FSIZE, (room, hard))
        try:
            write(path)
            message = ""
        except FarfieldError as error:
            message = str(error)
        resource.setrlimit(resource.RLIMIT_FSIZE, (hard, hard))
        results.append([name, room, message, path.read_bytes() == old])
Path(sys.argv[3]).write_text(json.dumps(results))
farfield.unregister()
"""


@pytest.mark.slow
def test_every_writer_at_every_tenth_of_its_file(tmp_path):
    folder = tmp_path / "disk"
    folder.mkdir()
    command = [sys.executable, "-c", CHILD, str(environment.ROOT / "scripts"), str(folder), str(tmp_path / "results.json")]
    outcome = subprocess.run(command, capture_output=True, text=True, check=False, env=os.environ | {"PYTHONDONTWRITEBYTECODE": "1"})
    assert outcome.returncode == 0, outcome.stderr
    results = json.loads((tmp_path / "results.json").read_text())
    assert len(results) == 6 * 11
    for name, room, message, is_unchanged in results:
        assert is_unchanged, f"{name} with room for {room} bytes"
        assert name in message and message.endswith(".") and "\n" not in message, f"{name} with room for {room} bytes: {message}"
    assert sorted(path.name for path in folder.iterdir()) == ["a.blend", "a.glb", "a.json", "a.obj", "a.png", "b.png"]


@pytest.mark.slow
def test_the_script_ends_with_code_2_and_keeps_the_old_scene(empty_scene, tmp_path):
    import resource

    import bpy

    out, script = tmp_path / "old.blend", environment.ROOT / "scripts" / "clipbox.py"
    arguments = ["--boxes", "2", "--resolution", "32", "--threshold", "1", "--terrain", "sine", "--at", "0,0,9", "--out", str(out)]
    bpy.ops.wm.save_as_mainfile(filepath=str(out), copy=True)
    old = out.read_bytes()
    limit = len(old) // 2  # less than an empty scene needs
    outcome = subprocess.run(
        [sys.executable, str(script), *arguments],
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit)),
        capture_output=True,
        text=True,
        check=False,
        env=os.environ | {"PYTHONDONTWRITEBYTECODE": "1"},
    )
    says_why = "full" in outcome.stderr or "too large" in outcome.stderr  # Blender 5.2 reports the limit itself.
    assert outcome.returncode == 2 and outcome.stderr.strip().count("\n") == 0 and says_why, outcome.stderr
    assert out.read_bytes() == old and [path.name for path in tmp_path.iterdir()] == ["old.blend"]
