"""A session in a Blender window: builds a cloud, cancels one, shows its original, cross-fades its levels, and undoes all."""

import sys
from collections.abc import Iterator
from pathlib import Path

import bpy

sys.path.insert(0, str(Path(__file__).resolve().parent))  # Blender does not add the script's folder

from session import (
    UserInput,
    create_tree,
    current_job,
    level_names,
    module,
    open_panel_alone,
    results,
    save_screenshot,
    scene_state,
    start_session,
    wait_for_job,
)

BUTTON = "farfield.billboards_build"


def session() -> Iterator[float]:
    """Run the session; yields pauses in seconds."""
    user = UserInput()
    bpy.data.objects.remove(bpy.data.objects["Cube"])
    create_tree()
    settings = bpy.context.scene.farfield_billboards
    settings.nested_levels = True  # Levels of these large leaves save too little to be kept otherwise.
    settings.error, settings.samples = 3.0, 4
    bpy.ops.ed.undo_push(message="Grow Tree")
    open_panel_alone("billboards")
    yield from user.open_sidebar()
    save_screenshot("1-panel")
    results["before"] = scene_state()

    results["cancelled"] = {}
    for half, fraction in (("core", 0.02), ("scene", 0.4)):
        x, y = yield from user.press_and_start(BUTTON)
        fractions = yield from wait_for_job(until_fraction=fraction)
        was_running = current_job() is not None
        save_screenshot(f"2-running-{half}")
        user.press("ESC", x, y)
        yield from wait_for_job()
        yield 0.5
        results["cancelled"][half] = {"was_running": was_running, "fractions": fractions, "after": scene_state()}
    save_screenshot("3-cancelled")

    yield from user.press_and_start(BUTTON)
    results["fractions"] = yield from wait_for_job()
    yield 3.0
    results["levels"] = level_names()
    save_screenshot("4-built")
    results["sentences"] = module("addon.operators.results").read_result(bpy.context.scene, "billboards")
    results["built"] = scene_state()

    results["visible"] = {"built": visible_objects()}
    x, y = yield from user.find_button("farfield.billboards_show")
    user.press("LEFTMOUSE", x, y)
    yield 1.0
    results["visible"]["original"] = visible_objects()
    yield from user.press_undo()
    results["visible"]["undone"] = visible_objects()

    x, y = yield from user.find_button("farfield.billboards_crossfade")
    user.press("LEFTMOUSE", x, y)
    yield 3.0
    results["crossfading"] = crossfading_objects()
    save_screenshot("5-crossfading")
    yield from user.press_undo()
    results["after_undo_of_crossfade"] = scene_state()

    yield from user.press_undo()
    results["after_undo_of_build"] = scene_state()
    save_screenshot("6-undone")


def visible_objects() -> list[str]:
    """Return the names of the mesh objects that the viewport shows."""
    return sorted(item.name for item in bpy.context.view_layer.objects if item.type == "MESH" and item.visible_get())


def crossfading_objects() -> list[str]:
    """Return the names of the objects that cross-fade."""
    return sorted(item.name for item in bpy.data.objects if "farfield_crossfade" in item)


start_session(session)
