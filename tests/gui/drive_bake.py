"""A visit to a Blender window: bakes a cloud, stops in the middle, resumes, and writes down what it sees."""

import sys
from collections.abc import Iterator
from pathlib import Path

import bpy

sys.path.insert(0, str(Path(__file__).resolve().parent))  # Blender does not put a script's folder there

from hand import Hand, drive, make_tree, module, open_panel_alone, open_sidebar, picture, seen, start, state, watch

BUTTON = "farfield.btf_bake"
BAKE = {"views": 16, "lights": 49, "samples": 4, "components": 4, "alpha_components": 4, "shadows": 64, "executor": "processes:2"}
ENOUGH = 5  # views after which Esc is pressed


def standing() -> dict[str, tuple[int, int]]:
    """Inode and time of every finished view; they change when it is written again."""
    estimates, properties = module("addon.operators.btf_estimates"), module("addon.operators.properties")
    settings = properties.read(module("addon.core.btf.settings").BtfSettings, bpy.context.scene.farfield_btf)
    folder = estimates.work_folder(module("addon.operators.btf").chosen(bpy.context), settings)
    return {path.name: (path.stat().st_ino, path.stat().st_mtime_ns) for path in sorted(folder.rglob("view-*.shard"))}


def visit() -> Iterator[float]:
    """The whole visit, as pauses in seconds."""
    hand = Hand()
    work = module("addon.operators.long_work")
    bpy.data.objects.remove(bpy.data.objects["Cube"])
    tree = make_tree()
    bpy.context.view_layer.objects.active = tree
    tree.select_set(True)
    bpy.ops.farfield.billboards_build(error=8.0, levels=1, samples=1)
    for name, value in BAKE.items():
        setattr(bpy.context.scene.farfield_btf, name, value)
    open_panel_alone("btf")
    yield from open_sidebar(hand)
    picture("1-panel")
    seen["before"] = state()

    x, y = yield from start(hand, BUTTON)
    view = hand.region("WINDOW")
    turned = list(hand.area.spaces.active.region_3d.view_rotation)
    while work.current() is not None and len(standing()) < ENOUGH:
        yield 0.1
    seen["running"] = work.current() is not None
    picture("2-baking")
    middle = view.x + view.width // 4, view.y + view.height // 2
    hand.move(*middle)
    yield 0.3
    hand.press("NUMPAD_1", *middle)  # the window is free: the view turns to the front
    yield 0.6
    seen["view_turned"] = list(hand.area.spaces.active.region_3d.view_rotation) != turned
    seen["label"] = work.current().progress.label if work.current() is not None else ""
    hand.press("ESC", x, y)
    yield from watch()
    yield 1.0
    kept = standing()
    seen["stopped"] = {"views": len(kept), "after": state()}
    hand.move(x - 400, y)
    yield 0.5
    picture("3-stopped")

    yield from start(hand, BUTTON)
    while work.current() is not None:
        now = standing()
        if now:
            seen["kept"] = all(now.get(name) == what for name, what in kept.items())
            seen["most"] = len(now)
        yield 0.1
    yield 2.0
    seen["materials"] = [level.data.materials[0].name for level in module("addon.operators.btf").chosen(bpy.context).levels]
    seen["left"] = len(standing())
    picture("4-baked")


drive(visit)
