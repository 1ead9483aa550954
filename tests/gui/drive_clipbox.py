"""A visit to a Blender window: makes a terrain, stops once, lets it follow the view, freezes it, undoes that, and tells what it sees."""

import sys
from collections.abc import Iterator
from pathlib import Path

import bpy
import mathutils

sys.path.insert(0, str(Path(__file__).resolve().parent))  # Blender does not put a script's folder there

from hand import Hand, drive, module, open_panel_alone, open_sidebar, picture, seen, start, state, undo, watch

BUTTON = "farfield.clipbox_create"


def terrains() -> list[str]:
    """Names of the terrains of the scene."""
    return [standing.name for standing in module("addon.bridge.terrain_objects").standing_terrains(bpy.context.scene)]


def view(hand: Hand) -> bpy.types.RegionView3D:
    """The 3D view."""
    area = next(area for area in hand.window.screen.areas if area.type == "VIEW_3D")
    return area.spaces.active.region_3d


def visit() -> Iterator[float]:
    """The whole visit, as pauses in seconds."""
    hand = Hand()
    work = module("addon.operators.long_work")
    bpy.data.objects.remove(bpy.data.objects["Cube"])
    group = bpy.context.scene.farfield_clipbox
    group.resolution, group.boxes = 128, 7
    bpy.ops.ed.undo_push(message="Choose")
    open_panel_alone("clipbox")
    yield from open_sidebar(hand)
    region = view(hand)
    region.view_distance = 90.0
    region.view_location = (0.0, 0.0, 20.0)
    picture("1-panel")
    seen["before"] = state()

    x, y = yield from start(hand, BUTTON)
    yield from watch(until_fraction=0.1)
    seen["running"] = work.current() is not None
    hand.press("ESC", x, y)
    yield from watch()
    yield 0.5
    seen["stopped"] = {"after": state(), "terrains": terrains()}

    group.resolution = 64
    bpy.ops.ed.undo_push(message="Choose less")
    yield from start(hand, BUTTON)
    seen["fractions"] = yield from watch()
    yield 4.0
    seen["made"] = terrains()
    standing = module("addon.bridge.terrain_objects").StandingTerrain(seen["made"][0])
    picture("2-made")

    seen["active"] = bpy.context.view_layer.objects.active.name
    seen["first_place"] = standing.viewer.tolist()
    x, y = yield from hand.find_button("farfield.clipbox_follow")
    hand.press("LEFTMOUSE", x, y)
    yield 1.0
    following = module("addon.operators.clipbox_following").followings
    seen["follows"] = len(following) == 1
    for step in range(25):
        region.view_location = mathutils.Vector((4.0 * (step + 1), 2.0 * (step + 1), 20.0))
        yield 0.3
    while not following[0].settled(standing.seen_from(region.view_matrix.inverted())):
        yield 0.2
    picture("3-followed")
    seen["moves"], seen["longest_slice"] = following[0].moves, following[0].longest_slice
    hand.press("ESC", x, y)
    yield 1.0
    seen["follows_after_esc"] = len(following)
    seen["last_place"] = standing.viewer.tolist()
    eye = standing.seen_from(region.view_matrix.inverted())
    seen["distance_to_eye"] = max(abs(a - b) for a, b in zip(eye, standing.viewer, strict=True))

    bpy.context.scene.farfield_clipbox_freeze.collider = False  # this Blender lacks what simplifies
    bpy.ops.ed.undo_push(message="Choose no collider")
    yield from start(hand, "farfield.clipbox_freeze")
    yield from watch()
    yield 3.0
    seen["frozen"] = sorted(item.name for item in bpy.data.objects if item.name.startswith("Ground"))
    seen["terrains_after_freeze"] = terrains()
    picture("4-frozen")
    yield from undo(hand)
    yield 1.0
    seen["terrains_after_undo"] = terrains()
    picture("5-undone")


drive(visit)
