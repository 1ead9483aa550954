"""A session in a Blender window: creates a terrain, cancels once, follows the view, converts it to meshes, and undoes that."""

import sys
import time
from collections.abc import Iterator
from pathlib import Path

import bpy
import mathutils

sys.path.insert(0, str(Path(__file__).resolve().parent))  # Blender does not add the script's folder

from session import UserInput, current_job, module, open_panel_alone, results, save_screenshot, scene_state, start_session, wait_for_job

BUTTON, FOLLOW, LIVE = "farfield.clipbox_create", "farfield.clipbox_follow_view", "farfield.clipbox_live_update"
MAX_LIVE_SECONDS = 240.0  # A hang; builds take long on busy machines.


def terrain_names() -> list[str]:
    """Return the names of the terrains of the scene."""
    return [terrain.name for terrain in module("addon.bridge.clipbox.objects").SceneTerrain.in_scene(bpy.context.scene)]


def wait_for_seed(terrain, seed: int) -> Iterator[float]:
    """Wait until a terrain was rebuilt with a seed, without an operator."""
    started = time.monotonic()
    while terrain.settings.seed != seed:
        assert time.monotonic() - started < MAX_LIVE_SECONDS, "the terrain is not updated live"
        yield 0.2


def session() -> Iterator[float]:
    """Run the session; yields pauses in seconds."""
    user = UserInput()
    bpy.data.objects.remove(bpy.data.objects["Cube"])
    settings = bpy.context.scene.farfield_clipbox
    settings.resolution, settings.boxes = 128, 7
    bpy.ops.ed.undo_push(message="Change Settings")
    open_panel_alone("clipbox", "convert")
    yield from user.open_sidebar()
    view = user.area.spaces.active.region_3d
    view.view_distance = 90.0
    view.view_location = (0.0, 0.0, 20.0)
    save_screenshot("1-panel")
    results["before"] = scene_state()

    x, y = yield from user.press_and_start(BUTTON)
    yield from wait_for_job(until_fraction=0.1)
    results["was_running"] = current_job() is not None
    user.press("ESC", x, y)
    yield from wait_for_job()
    yield 0.5
    results["cancelled"] = {"after": scene_state(), "terrains": terrain_names()}

    yield from user.press_and_start(BUTTON)
    results["fractions"] = yield from wait_for_job()
    yield 4.0
    results["terrains"] = terrain_names()
    terrain = module("addon.bridge.clipbox.objects").SceneTerrain(results["terrains"][0])
    save_screenshot("2-created")

    results["active"] = bpy.context.view_layer.objects.active.name
    results["first_viewer"] = terrain.viewer.tolist()
    x, y = yield from user.find_button(FOLLOW)
    user.press("LEFTMOUSE", x, y)
    yield 1.0
    following_module = module("addon.operators.following")
    results["followings"] = len(following_module.running())
    (following,) = following_module.running()
    bpy.ops.ed.undo_push(message="Nothing")
    for step in range(25):
        view.view_location = mathutils.Vector((4.0 * (step + 1), 2.0 * (step + 1), 20.0))
        yield 0.3
    while not following.is_settled(terrain.viewer_position(view.view_matrix.inverted())):
        yield 0.2
    save_screenshot("3-followed")
    results["modal_operators"] = [operator.bl_idname for operator in user.window.modal_operators]
    results["moves"], results["longest_tick"] = following.moves, following.longest_tick
    yield from user.press_undo()  # also undoes the moves since then; following repeats them
    while not following.is_settled(terrain.viewer_position(view.view_matrix.inverted())):
        yield 0.2
    results["moves_after_undo"] = following.moves
    x, y = yield from user.find_button(FOLLOW)
    user.press("LEFTMOUSE", x, y)
    yield 1.0
    results["followings_after_stop"] = len(following_module.running())
    results["last_viewer"] = terrain.viewer.tolist()
    position = terrain.viewer_position(view.view_matrix.inverted())
    results["distance_to_view"] = max(abs(a - b) for a, b in zip(position, terrain.viewer, strict=True))

    x, y = yield from user.find_button(LIVE)
    user.press("LEFTMOUSE", x, y)
    yield 1.0
    bpy.context.scene.farfield_clipbox.seed = 3
    bpy.ops.ed.undo_push(message="Change Seed")
    yield from wait_for_seed(terrain, 3)
    save_screenshot("4-live")
    yield from user.press_undo()
    yield from wait_for_seed(terrain, 0)
    results["blocks_after_undo"] = len(terrain.blocks())
    x, y = yield from user.find_button(LIVE)
    user.press("LEFTMOUSE", x, y)
    yield 1.0
    results["is_live"] = module("addon.operators.clipbox.live_update").current.terrain is not None

    bpy.context.scene.farfield_clipbox_convert.collider = False  # this Blender lacks the package that simplifies
    bpy.ops.ed.undo_push(message="Disable Collider")
    yield from user.press_and_start("farfield.clipbox_convert_to_mesh")
    yield from wait_for_job()
    yield 3.0
    results["converted"] = sorted(item.name for item in bpy.data.objects if item.name.startswith("Ground"))
    results["terrains_after_conversion"] = terrain_names()
    save_screenshot("4-converted")
    yield from user.press_undo()
    yield 1.0
    results["terrains_after_undo"] = terrain_names()
    save_screenshot("5-undone")


start_session(session)
