"""A visit to a Blender window: unwraps a ball, stops once, shows its stretch, undoes it, and writes down what it sees."""

import math
import sys
from collections.abc import Iterator
from pathlib import Path

import bpy

sys.path.insert(0, str(Path(__file__).resolve().parent))  # Blender does not put a script's folder there

from hand import Hand, drive, module, open_panel_alone, open_sidebar, picture, seen, start, state, undo, watch

BUTTON = "farfield.unwrap"


def bumpy_ball() -> bpy.types.Object:
    """A ball of 20,000 triangles with bumps, the active object."""
    bpy.ops.mesh.primitive_ico_sphere_add(subdivisions=6, calc_uvs=False)
    ball = bpy.context.object
    for vertex in ball.data.vertices:
        x, y, z = vertex.co
        vertex.co *= 1.0 + 0.15 * math.sin(5.0 * x) * math.sin(4.0 * y + 1.0) * math.sin(6.0 * z)
    return ball


def maps(name: str) -> list[str]:
    """Names of the UV maps of an object's mesh."""
    return [layer.name for layer in bpy.data.objects[name].data.uv_layers]


def visit() -> Iterator[float]:
    """The whole visit, as pauses in seconds."""
    hand = Hand()
    work = module("addon.operators.long_work")
    bpy.data.objects.remove(bpy.data.objects["Cube"])
    name = bumpy_ball().name
    bpy.ops.ed.undo_push(message="Make ball")
    open_panel_alone("unwrap")
    yield from open_sidebar(hand)
    picture("1-panel")
    seen["before"] = state()

    x, y = yield from start(hand, BUTTON)
    yield from watch(until_fraction=0.15)
    seen["running"] = work.current() is not None
    picture("2-running")
    hand.press("ESC", x, y)
    yield from watch()
    yield 0.5
    seen["stopped"] = {"after": state(), "maps": maps(name)}

    yield from start(hand, BUTTON)
    seen["fractions"] = yield from watch()
    yield 2.0
    seen["maps"] = maps(name)
    seen["figures"] = module("addon.bridge.uv_maps").figures_of(bpy.data.objects[name].data)
    picture("3-unwrapped")

    x, y = yield from hand.find_button("farfield.unwrap_overlay")
    hand.press("LEFTMOUSE", x, y)
    yield 3.0
    seen["shown"] = module("addon.bridge.uv_overlay").shown()
    picture("4-stretch")
    properties = next(area for area in hand.window.screen.areas if area.type == "DOPESHEET_EDITOR" or area.type == "PROPERTIES")
    properties.ui_type = "UV"
    yield 3.0
    picture("5-map")
    x, y = yield from hand.find_button("farfield.unwrap_overlay")
    hand.press("LEFTMOUSE", x, y)
    yield 1.0
    seen["hidden"] = not module("addon.bridge.uv_overlay").shown()

    yield from undo(hand)
    seen["undone"] = maps(name)
    picture("6-undone")


drive(visit)
