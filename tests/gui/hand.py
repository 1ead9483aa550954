"""A hand at the mouse of a Blender window, and what it sees: shared by the visits that drive one.

    blender --enable-event-simulate --python VISIT.py -- FOLDER

FOLDER receives seen.json and pictures.
"""

import json
import shutil
import subprocess
import sys
import time
import traceback
from collections.abc import Callable, Iterator
from pathlib import Path

import addon_utils
import bpy
import numpy as np

PACKAGE = "bl_ext.user_default.farfield"
FOLDER = Path(sys.argv[sys.argv.index("--") + 1])
LEAVES = 600
PANELS = ("billboards", "btf", "unwrap", "clipbox")
LOOK = 0.1  # seconds between two looks at the window
PATIENCE = 120.0  # seconds that a job may take here

seen: dict = {"error": None}


def make_tree() -> bpy.types.Object:
    """A trunk and leaf cards around a crown, as one object with two materials."""
    random = np.random.default_rng(1)
    angles = np.arange(12) * 2.0 * np.pi / 12
    ring = np.column_stack([0.15 * np.cos(angles), 0.15 * np.sin(angles), np.zeros(12)])
    trunk = np.concatenate([ring, ring * 0.5 + [0.0, 0.0, 2.0]])
    sides = [[i, (i + 1) % 12, 12 + (i + 1) % 12, 12 + i] for i in range(12)]
    centers = random.normal(size=(LEAVES, 3)) * [0.6, 0.6, 0.5] + [0.0, 0.0, 2.4]
    across, along = (random.normal(size=(LEAVES, 3)) for _ in range(2))
    across /= np.linalg.norm(across, axis=1, keepdims=True) / 0.06
    along /= np.linalg.norm(along, axis=1, keepdims=True) / 0.1
    cards = np.stack([centers - across, centers - along, centers + across, centers + along], axis=1).reshape(-1, 3)
    leaves = (24 + np.arange(4 * LEAVES).reshape(-1, 4)).tolist()
    mesh = bpy.data.meshes.new("Tree")
    mesh.from_pydata(np.concatenate([trunk, cards]).tolist(), [], sides + leaves)
    for name, colour in (("Bark", (0.2, 0.1, 0.05, 1.0)), ("Leaf", (0.05, 0.4, 0.05, 1.0))):
        material = bpy.data.materials.new(name)
        if material.node_tree is None:
            material.use_nodes = True
        material.node_tree.nodes["Principled BSDF"].inputs["Base Color"].default_value = colour
        mesh.materials.append(material)
    for polygon in mesh.polygons[len(sides) :]:
        polygon.material_index = 1
    tree = bpy.data.objects.new("Tree", mesh)
    bpy.context.scene.collection.objects.link(tree)
    return tree


class Hand:
    """Mouse and keyboard of the first window."""

    def __init__(self) -> None:
        self.window = bpy.context.window_manager.windows[0]
        self.area = next(area for area in self.window.screen.areas if area.type == "VIEW_3D")

    def region(self, kind: str) -> bpy.types.Region:
        """A region of the 3D view."""
        return next(region for region in self.area.regions if region.type == kind)

    def move(self, x: int, y: int) -> None:
        """Move the mouse."""
        self.window.event_simulate(type="MOUSEMOVE", value="NOTHING", x=x, y=y)

    def press(self, key: str, x: int, y: int, ctrl: bool = False) -> None:
        """Press and release a key or button."""
        for value in ("PRESS", "RELEASE"):
            self.window.event_simulate(type=key, value=value, x=x, y=y, ctrl=ctrl)

    def is_on_button(self, operator: str) -> bool:
        """Whether Blender says that the mouse is on the button of `operator`: it can copy that button's call."""
        window_manager = bpy.context.window_manager
        with bpy.context.temp_override(window=self.window, area=self.area, region=self.region("UI")):
            if not bpy.ops.ui.copy_python_command_button.poll():
                return False
            window_manager.clipboard = ""
            bpy.ops.ui.copy_python_command_button()
        return window_manager.clipboard.startswith(f"bpy.ops.{operator}(")

    def find_button(self, operator: str) -> Iterator[float | tuple[int, int]]:
        """Pass over the sidebar from top to bottom until the mouse is on the button of `operator`; where that is."""
        sidebar = self.region("UI")
        x = sidebar.x + sidebar.width // 2
        self.move(sidebar.x - 200, sidebar.y + sidebar.height // 2)  # away, or the button that was pressed last still counts
        yield 3 * LOOK
        for y in range(sidebar.y + sidebar.height - 10, sidebar.y, -9):
            self.move(x, y)
            yield LOOK
            if self.is_on_button(operator):
                self.move(x, y - 1)
                yield 3 * LOOK
                if self.is_on_button(operator):
                    return x, y - 1
        raise AssertionError(f"the sidebar has no button for {operator}")


def picture(name: str) -> None:
    """Take a picture of the whole window, where there is a program that can."""
    if shutil.which("import"):
        subprocess.run(["import", "-window", "root", str(FOLDER / f"{name}.png")], check=False)


def clouds() -> list[str]:
    """Names of the level objects in the file."""
    return sorted(item.name for item in bpy.data.objects if item.get("farfield_kind") == "cloud")


def state() -> dict:
    """What a stopped job must leave as it was."""
    return {
        kind: sorted(item.name for item in getattr(bpy.data, kind))
        for kind in ("objects", "meshes", "materials", "images", "scenes", "collections", "cameras", "node_groups")
    }


def module(name: str):
    """A module of the installed extension."""
    return sys.modules[f"{PACKAGE}.{name}"]


def open_panel_alone(tool: str) -> None:
    """Show the panel of `tool` open and the others closed, so that all of it has room."""
    for name in PANELS:
        panel = getattr(module(f"addon.panels.{name}"), f"FARFIELD_PT_{name}")
        bpy.utils.unregister_class(panel)
        panel.bl_options = set() if name == tool else {"DEFAULT_CLOSED"}
        bpy.utils.register_class(panel)


def open_sidebar(hand: Hand) -> Iterator[float]:
    """Show the sidebar at the tab *Farfield*."""
    hand.area.spaces.active.show_region_ui = True
    yield 2.0
    hand.region("UI").active_panel_category = "Farfield"
    hand.region("UI").tag_redraw()
    yield 2.0


def undo(hand: Hand) -> Iterator[float]:
    """Press Ctrl Z over the 3D view."""
    view = hand.region("WINDOW")
    middle = view.x + view.width // 2, view.y + view.height // 2
    hand.move(*middle)
    yield 0.5
    hand.press("Z", *middle, ctrl=True)
    yield 1.5


def start(hand: Hand, operator: str) -> Iterator[float | tuple[int, int]]:
    """Press the button of `operator` and wait until its job runs; where the button is."""
    work = module("addon.operators.long_work")
    x, y = yield from hand.find_button(operator)
    hand.press("LEFTMOUSE", x, y)
    started = time.monotonic()
    while work.current() is None:
        assert time.monotonic() - started < 20.0, "the button starts nothing"
        yield 0.02
    return x, y


def watch(until_fraction: float | None = None) -> Iterator[float | list[float]]:
    """Look at the bar until the job ends or has come as far as asked; the fractions that were seen."""
    work = module("addon.operators.long_work")
    fractions, started = [], time.monotonic()
    while work.current() is not None:
        assert time.monotonic() - started < PATIENCE, "the job does not end"
        fractions.append(work.current().progress.fraction)
        if until_fraction is not None and fractions[-1] >= until_fraction:
            break
        yield LOOK
    return fractions


def drive(visit: Callable[[], Iterator[float]]) -> None:
    """Enable the extension and make the `visit`, whose pauses are in seconds; at its end the findings are written and Blender quits."""
    steps = visit()

    def go_on() -> float | None:
        finished = True
        try:
            pause = next(steps, None)
            finished = pause is None
            return pause
        finally:
            if sys.exc_info()[0] is not None:  # whatever it is has to reach the test that waits outside
                seen["error"] = traceback.format_exc()
                picture("error")
            if finished:
                (FOLDER / "seen.json").write_text(json.dumps(seen, indent=2), encoding="utf-8")
                bpy.ops.wm.quit_blender()

    bpy.context.preferences.view.show_splash = False
    addon_utils.enable(PACKAGE)
    bpy.app.timers.register(go_on, first_interval=3.0)
