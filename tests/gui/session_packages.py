"""A session in a Blender window: exports the package of a cube by the button of the panel."""

import sys
from collections.abc import Iterator
from pathlib import Path

import bpy

sys.path.insert(0, str(Path(__file__).resolve().parent))  # Blender does not add the script's folder

from session import FOLDER, UserInput, open_panel_alone, results, save_screenshot, start_session, wait_for_job


def session() -> Iterator[float]:
    """Run the session; yields pauses in seconds."""
    user = UserInput()
    cube = bpy.data.objects["Cube"]
    modifier = cube.modifiers.new("Subdivision", "SUBSURF")
    modifier.levels = 4
    group, package = bpy.context.scene.farfield_texmesh, bpy.context.scene.farfield_packages
    group.levels, group.number, group.views, group.max_image, package.pixels = "number", 3, 2, 64, 96
    bpy.ops.ed.undo_push(message="Subdivide Cube")
    open_panel_alone("packages")
    yield from user.open_sidebar()
    results["objects_before"] = len(bpy.data.objects)
    bpy.ops.wm.save_as_mainfile(filepath=str(FOLDER / "scène.blend"))
    yield 0.5
    save_screenshot("1-panel")
    yield from user.press_and_start("farfield.packages_export")
    results["fractions"] = yield from wait_for_job()
    yield 1.0
    save_screenshot("2-exported")
    results["files"] = sorted(path.name for path in (FOLDER / "Cube package").iterdir())
    results["objects_after"] = len(bpy.data.objects)


start_session(session)
