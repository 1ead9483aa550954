"""A visit to a Blender window: builds a cloud, stops one, undoes one, and writes down what it sees."""

import sys
from collections.abc import Iterator
from pathlib import Path

import bpy

sys.path.insert(0, str(Path(__file__).resolve().parent))  # Blender does not put a script's folder there

from hand import Hand, clouds, drive, make_tree, module, picture, seen, start, state, watch

BUTTON = "farfield.billboards_build"


def visit() -> Iterator[float]:
    """The whole visit, as pauses in seconds."""
    hand = Hand()
    hand.area.spaces.active.show_region_ui = True
    bpy.data.objects.remove(bpy.data.objects["Cube"])
    tree = make_tree()
    bpy.context.view_layer.objects.active = tree
    tree.select_set(True)
    bpy.ops.ed.undo_push(message="Grow tree")
    yield 2.0
    hand.region("UI").active_panel_category = "Farfield"
    hand.region("UI").tag_redraw()
    yield 2.0
    picture("1-panel")
    seen["before"] = state()

    seen["stopped"] = {}
    for half, fraction in (("core", 0.02), ("scene", 0.4)):
        x, y = yield from start(hand, BUTTON)
        fractions = yield from watch(until_fraction=fraction)
        running = module("addon.operators.long_work").current() is not None
        picture(f"2-running-{half}")
        hand.press("ESC", x, y)
        yield from watch()
        yield 0.5
        seen["stopped"][half] = {"running": running, "fractions": fractions, "after": state()}
    picture("3-stopped")

    yield from start(hand, BUTTON)
    seen["fractions"] = yield from watch()
    yield 3.0
    seen["levels"] = clouds()
    picture("4-built")

    view = hand.region("WINDOW")
    middle = view.x + view.width // 2, view.y + view.height // 2
    hand.move(*middle)
    yield 0.5
    hand.press("Z", *middle, ctrl=True)
    yield 1.5
    seen["after_undo"] = state()
    picture("5-undone")


drive(visit)
