"""A visit to a Blender window: builds a cloud, stops one, lets one fade, undoes both, and writes down what it sees."""

import sys
from collections.abc import Iterator
from pathlib import Path

import bpy

sys.path.insert(0, str(Path(__file__).resolve().parent))  # Blender does not put a script's folder there

from hand import Hand, clouds, drive, make_tree, module, open_sidebar, picture, seen, start, state, undo, watch

BUTTON = "farfield.billboards_build"


def visit() -> Iterator[float]:
    """The whole visit, as pauses in seconds."""
    hand = Hand()
    bpy.data.objects.remove(bpy.data.objects["Cube"])
    tree = make_tree()
    bpy.context.view_layer.objects.active = tree
    tree.select_set(True)
    bpy.ops.ed.undo_push(message="Grow tree")
    yield from open_sidebar(hand)
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
    seen["built"] = state()

    x, y = yield from hand.find_button("farfield.billboards_fade")
    hand.press("LEFTMOUSE", x, y)
    yield 3.0
    seen["fading"] = fading()
    picture("5-fading")
    yield from undo(hand)
    seen["after_fading"] = state()

    yield from undo(hand)
    seen["after_undo"] = state()
    picture("6-undone")


def fading() -> list[str]:
    """Names of what fades."""
    return sorted(item.name for item in bpy.data.objects if "farfield_fade" in item)


drive(visit)
