"""A session in a Blender window: unwraps a ball, cancels once, shows the stretch, and undoes it."""

import math
import sys
from collections.abc import Iterator
from pathlib import Path

import bpy

sys.path.insert(0, str(Path(__file__).resolve().parent))  # Blender does not add the script's folder

from session import UserInput, current_job, module, open_panel_alone, results, save_screenshot, scene_state, start_session, wait_for_job

BUTTON = "farfield.unwrap"


def create_bumpy_ball() -> bpy.types.Object:
    """Create a ball of 5,000 triangles with bumps as the active object."""
    bpy.ops.mesh.primitive_ico_sphere_add(subdivisions=5, calc_uvs=False)
    ball = bpy.context.object
    for vertex in ball.data.vertices:
        x, y, z = vertex.co
        vertex.co *= 1.0 + 0.15 * math.sin(5.0 * x) * math.sin(4.0 * y + 1.0) * math.sin(6.0 * z)
    return ball


def uv_map_names(name: str) -> list[str]:
    """Return the names of the UV maps of an object's mesh."""
    return [layer.name for layer in bpy.data.objects[name].data.uv_layers]


def session() -> Iterator[float]:
    """Run the session; yields pauses in seconds."""
    user = UserInput()
    bpy.data.objects.remove(bpy.data.objects["Cube"])
    name = create_bumpy_ball().name
    bpy.ops.ed.undo_push(message="Create Ball")
    open_panel_alone("unwrap")
    yield from user.open_sidebar()
    save_screenshot("1-panel")
    results["before"] = scene_state()

    x, y = yield from user.press_and_start(BUTTON)
    yield from wait_for_job(until_fraction=0.15)
    results["was_running"] = current_job() is not None
    save_screenshot("2-running")
    user.press("ESC", x, y)
    yield from wait_for_job()
    yield 0.5
    results["cancelled"] = {"after": scene_state(), "uv_maps": uv_map_names(name)}

    yield from user.press_and_start(BUTTON)
    results["fractions"] = yield from wait_for_job()
    yield 2.0
    results["uv_maps"] = uv_map_names(name)
    results["metrics"] = module("addon.bridge.unwrap.uv_maps").read_metrics(bpy.data.objects[name].data)
    save_screenshot("3-unwrapped")

    x, y = yield from user.find_button("farfield.unwrap_overlay")
    user.press("LEFTMOUSE", x, y)
    yield 3.0
    overlay = module("addon.bridge.unwrap.stretch_display").overlay
    results["overlay_shown"] = overlay.is_shown
    save_screenshot("4-stretch")
    properties = next(area for area in user.window.screen.areas if area.type == "DOPESHEET_EDITOR" or area.type == "PROPERTIES")
    properties.ui_type = "UV"
    properties.spaces.active.show_region_ui = True
    yield 3.0
    sidebar = next(region for region in properties.regions if region.type == "UI")
    sidebar.active_panel_category = "Farfield"
    yield 3.0
    results["category"] = sidebar.active_panel_category
    save_screenshot("5-uv-editor")
    x, y = yield from user.find_button("farfield.unwrap_overlay")
    user.press("LEFTMOUSE", x, y)
    yield 1.0
    results["overlay_hidden"] = not overlay.is_shown

    yield from user.press_undo()
    results["uv_maps_after_undo"] = uv_map_names(name)
    save_screenshot("6-undone")


if __name__ == "__main__":
    start_session(session)
