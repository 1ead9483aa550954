"""A session in a Blender window: starts to bake a cloud, cancels the bake, and resumes it."""

import sys
from collections.abc import Iterator
from pathlib import Path

import bpy

sys.path.insert(0, str(Path(__file__).resolve().parent))  # Blender does not add the script's folder

from session import (
    UserInput,
    create_tree,
    current_job,
    module,
    open_panel_alone,
    results,
    save_screenshot,
    scene_state,
    start_session,
    wait_for_job,
)

BUTTON = "farfield.btf_bake"
SETTINGS = {
    "views_per_side": 4,
    "lights_per_side": 7,
    "samples": 800,  # rendering must take longer than what this session does before Esc, also where the window responds slowly
    "components": 4,
    "alpha_components": 4,
    "shadows_per_side": 8,
    "executor": "processes:2",
}
VIEWS_BEFORE_CANCEL = 3


def finished_views() -> dict[str, tuple[int, int]]:
    """Return inode and modification time of every finished view; they change when the view is written again."""
    estimates, properties = module("addon.operators.btf.estimates"), module("addon.operators.properties")
    settings = properties.read(module("addon.core.btf.settings").BtfSettings, bpy.context.scene.farfield_btf)
    folder = estimates.capture_folder(module("addon.operators.btf.operators").active_cloud(bpy.context), settings)
    return {path.name: (path.stat().st_ino, path.stat().st_mtime_ns) for path in sorted(folder.rglob("view-*.shard"))}


def session() -> Iterator[float]:
    """Run the session; yields pauses in seconds."""
    user = UserInput()
    bpy.data.objects.remove(bpy.data.objects["Cube"])
    create_tree()
    bpy.ops.farfield.billboards_build(error=8.0, levels=1, samples=1)
    for name, value in SETTINGS.items():
        setattr(bpy.context.scene.farfield_btf, name, value)
    open_panel_alone("btf")
    yield from user.open_sidebar()
    save_screenshot("1-panel")
    results["before"] = scene_state()

    x, y = yield from user.press_and_start(BUTTON)
    viewport = user.region("WINDOW")
    rotation = list(user.area.spaces.active.region_3d.view_rotation)
    while current_job() is not None and len(finished_views()) < VIEWS_BEFORE_CANCEL:
        yield 0.1
    results["was_running"] = current_job() is not None
    save_screenshot("2-baking")
    position = viewport.x + viewport.width // 4, viewport.y + viewport.height // 2
    user.move(*position)
    yield 0.3
    user.press("NUMPAD_1", *position)  # the window must respond: front view
    yield 0.6
    results["view_rotated"] = list(user.area.spaces.active.region_3d.view_rotation) != rotation
    results["label"] = current_job().progress.label if current_job() is not None else ""
    user.press("ESC", x, y)
    yield from wait_for_job()
    yield 1.0
    kept = finished_views()
    results["cancelled"] = {"views": len(kept), "after": scene_state()}
    user.move(x - 400, y)
    yield 0.5
    save_screenshot("3-cancelled")

    yield from user.press_and_start(BUTTON)
    while current_job() is not None:
        views = finished_views()
        if views:
            results["kept"] = all(views.get(name) == version for name, version in kept.items())
            results["max_views"] = len(views)
        yield 0.1
    yield 2.0
    cloud = module("addon.operators.btf.operators").active_cloud(bpy.context)
    results["materials"] = [level.data.materials[0].name for level in cloud.levels]
    results["remaining_views"] = len(finished_views())
    save_screenshot("4-baked")


start_session(session)
