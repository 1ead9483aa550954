"""A session in a Blender window: loads a large terrain, lets it follow the view, undoes a move, and removes it."""

import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import bpy
import mathutils

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
sys.path.insert(0, str(Path(__file__).resolve().parent))  # Blender does not add the script's folder

from session import FOLDER, UserInput, module, open_panel_alone, results, save_screenshot, start_session

from lib import environment

FOLLOW, REMOVE = "farfield.bdam_follow_view", "farfield.bdam_remove"
TIMEOUT_STEPS = 300


def terrains() -> list:
    """Return the terrains of the scene."""
    return module("addon.bridge.bdam.objects").SceneTerrain.in_scene(bpy.context.scene)


def look(view: bpy.types.RegionView3D, eye: tuple[float, float, float], target: tuple[float, float, float]) -> None:
    """Let a 3D Viewport look from a position at another one."""
    direction = (mathutils.Vector(target) - mathutils.Vector(eye)).normalized()
    view.view_rotation, view.view_distance = direction.to_track_quat("-Z", "Y"), 10.0
    view.view_location = mathutils.Vector(eye) + 10.0 * direction


def session() -> Iterator[float]:
    """Run the session; yields pauses in seconds."""
    environment.import_farfield()
    from small_terrain_stores import build_store, hills  # which needs the package

    user = UserInput()
    bpy.data.objects.remove(bpy.data.objects["Cube"])
    store = build_store(FOLDER / "terrain", hills(257, 257))
    settings = bpy.context.scene.farfield_bdam_view
    settings.shading, settings.tolerance = "level", 4.0
    bpy.ops.ed.undo_push(message="Change Settings")
    open_panel_alone("bdam", "figures")
    yield from user.open_sidebar()
    with bpy.context.temp_override(window=user.window, area=user.area):
        bpy.ops.farfield.bdam_load(directory=str(store))
    bpy.ops.ed.undo_push(message="Load")
    yield 2.0
    (terrain,) = terrains()
    results["loaded"] = {
        "tiles": len(terrain.tiles()),
        "triangles": terrain.figures.triangles,
        "clip_end": user.area.spaces.active.clip_end,
    }
    user.area.spaces.active.shading.type = "SOLID"
    save_screenshot("1-loaded")

    view = user.area.spaces.active.region_3d

    def is_settled() -> bool:
        viewer = module("addon.operators.view_following").view_of_area(bpy.context.scene, user.area)
        return following.is_settled(terrain.to_terrain_space(replace(viewer, is_interactive=True)))

    def wait() -> Iterator[float]:
        for _ in range(TIMEOUT_STEPS):
            if is_settled():
                return
            yield 0.1
        raise AssertionError("the terrain does not settle")

    x, y = yield from user.find_button(FOLLOW)
    user.press("LEFTMOUSE", x, y)
    yield 1.0
    (following,) = module("addon.operators.following").running()
    bpy.ops.ed.undo_push(message="Nothing")
    figures = []
    for step in range(12):
        look(view, (-1000.0 + 120.0 * step, -1200.0, 500.0), (0.0, 400.0, 0.0))
        yield 0.3
        figures.append(terrain.figures.triangles)
    yield from wait()
    save_screenshot("2-followed")
    results["triangles"], results["moves"] = figures, following.moves
    results["tiles"] = [len(terrain.tiles()), terrain.figures.tiles]
    results["modal_operators"] = [operator.bl_idname for operator in user.window.modal_operators]
    yield from user.press_undo()  # following repeats the move
    yield from wait()
    results["tiles_after_undo"] = [len(terrain.tiles()), terrain.figures.tiles]
    moves = following.moves
    yield 2.0
    results["moves_while_standing"] = following.moves - moves
    x, y = yield from user.find_button(FOLLOW)
    user.press("LEFTMOUSE", x, y)
    yield 1.0
    results["followings_after_stop"] = len(module("addon.operators.following").running())
    results["longest_tick"], results["longest_evaluation"] = following.longest_tick, following.longest_evaluation

    x, y = yield from user.find_button(REMOVE)
    user.press("LEFTMOUSE", x, y)
    yield 1.0
    results["after_removal"] = [len(terrains()), sum(mesh.users for mesh in bpy.data.meshes)]
    yield from user.press_undo()
    results["terrains_after_undo"] = len(terrains())
    save_screenshot("3-restored")


start_session(session)
