"""A session in a Blender window: opens the menus of presets, applies one, undoes that, creates a terrain and reads its details."""

import sys
from collections.abc import Iterator
from pathlib import Path

import addon_utils
import bpy

sys.path.insert(0, str(Path(__file__).resolve().parent))  # Blender does not add the script's folder

from session import UserInput, module, open_panel_alone, results, save_screenshot, start_session, wait_for_job

PRESET, CHOSEN = "Floating Islands", "Canyon"
FIRST_BUTTON, BUTTON_HEIGHT = 87, 21  # Pixels from the picture in the menu of terrains down to the button of defaults, and to the next one.
drawn: list[str] = []  # Terrains that the panel has shown, the latest last.
DETAILS = (
    'Built "Hélm 頭" (860, 665, 575 triangles). Emission of the material "Visor" is left out. '
    'The finest level is no lighter than the original: show the original instead. "Strap" was skipped: it has no faces.'
)


def menu_position(user: UserInput) -> tuple[int, int]:
    """Return where menus open in the 3D Viewport: high enough that all presets are below."""
    viewport = user.region("WINDOW")
    return viewport.x + viewport.width // 2, viewport.y + viewport.height * 4 // 5


def open_menu(user: UserInput, tool: str) -> Iterator[float]:
    """Open the menu of presets of a tool as its button does."""
    viewport = user.region("WINDOW")
    user.move(*menu_position(user))
    yield 0.5
    with bpy.context.temp_override(window=user.window, area=user.area, region=viewport):
        bpy.ops.wm.call_panel(name=f"FARFIELD_PT_{tool}_presets", keep_open=True)
    yield 2.0


def choose_by_picture(user: UserInput) -> Iterator[float]:
    """Open the menu of the presets of terrains, click the picture in it, and then one of those that appear."""
    yield from open_menu(user, "clipbox")
    x, y = menu_position(user)
    for name, down in (("chosen", 0), ("others", 60)):  # The picture, then the second one of those that appear.
        user.move(x, y - down)
        yield 1.0
        save_screenshot(f"4-{name}")
        user.press("LEFTMOUSE", x, y - down)
        yield 2.0
    yield from close_menu(user)


def choose_by_name(user: UserInput) -> Iterator[float]:
    """Open the menu of the presets of terrains, and click the button of one in it. The menu stays open."""
    yield from open_menu(user, "clipbox")
    x, y = menu_position(user)
    y -= FIRST_BUTTON + BUTTON_HEIGHT * (1 + list(module("addon.operators.presets").find_presets("clipbox")).index(CHOSEN))
    user.move(x, y)
    yield 1.0
    user.press("LEFTMOUSE", x, y)
    yield 2.0
    save_screenshot("4-by-name")


def watch_panel(panel: bpy.types.Panel, context: bpy.types.Context) -> None:
    """Record which terrain the panel shows."""
    drawn.append(context.scene.farfield_clipbox.terrain)


def close_menu(user: UserInput) -> Iterator[float]:
    """Press Esc in the 3D Viewport."""
    viewport = user.region("WINDOW")
    user.press("ESC", viewport.x + viewport.width // 2, viewport.y + viewport.height // 2)
    yield 1.0


def session() -> Iterator[float]:
    """Run the session; yields pauses in seconds."""
    user = UserInput()
    bpy.data.objects.remove(bpy.data.objects["Cube"])
    bpy.ops.ed.undo_push(message="Remove Cube")
    open_panel_alone("clipbox")
    yield from user.open_sidebar()
    save_screenshot("1-panel")
    for tool in ("clipbox", "billboards", "unwrap"):
        yield from open_menu(user, tool)
        save_screenshot(f"3-menu-{tool}")
        yield from close_menu(user)

    settings = bpy.context.scene.farfield_clipbox
    viewport = user.region("WINDOW")
    with bpy.context.temp_override(window=user.window, area=user.area, region=viewport):
        bpy.ops.farfield.preset_apply("EXEC_DEFAULT", True, tool="clipbox", name=PRESET)
    results["applied"] = settings.terrain
    yield from user.press_undo()
    results["undone"] = bpy.context.scene.farfield_clipbox.terrain
    yield from user.press_undo(redo=True)
    results["redone"] = bpy.context.scene.farfield_clipbox.terrain

    bpy.types.FARFIELD_PT_clipbox.append(watch_panel)
    yield from choose_by_name(user)
    results["by_name"] = [bpy.context.scene.farfield_clipbox.terrain, drawn[-1] if drawn else ""]
    yield from close_menu(user)
    yield from user.press_undo()

    yield from choose_by_picture(user)
    results["by_picture"] = {
        "terrain": bpy.context.scene.farfield_clipbox.terrain,
        "name": bpy.context.window_manager.farfield_clipbox_picture,
    }
    yield from user.press_undo()
    results["by_picture_undone"] = bpy.context.scene.farfield_clipbox.terrain

    space = user.area.spaces.active
    results["clip_end_before"] = space.clip_end
    yield from user.press_and_start("farfield.clipbox_create")
    yield from wait_for_job()
    yield 4.0
    save_screenshot("5-created")
    results["clip_end"] = space.clip_end
    results["sentences"] = module("addon.operators.results").read_result(bpy.context.scene, "clipbox")

    module("addon.operators.results").store_result(bpy.context.scene, "clipbox", DETAILS)
    module("addon.operators.long_work").redraw_sidebars(bpy.context.window_manager)
    yield 2.0
    save_screenshot("6-result")
    x, y = yield from user.find_button("farfield.details")
    user.press("LEFTMOUSE", x, y)
    yield 2.0
    save_screenshot("7-details")
    yield from close_menu(user)

    package = module("addon.operators.user_cache").PACKAGE
    addon_utils.enable(package, default_set=True)
    results["processes"] = bpy.context.preferences.addons[package].preferences.processes


if __name__ == "__main__":
    start_session(session)
