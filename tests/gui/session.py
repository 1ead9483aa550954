"""A session in a Blender window: simulated user input and what the session records. Shared by the session_*.py files.

    blender --enable-event-simulate --python session_TOOL.py -- FOLDER

Writes results.json and screenshots to FOLDER.
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
POLL_SECONDS = 0.1
START_TIMEOUT_SECONDS = 20.0
JOB_TIMEOUT_SECONDS = 120.0

results: dict = {"error": None}


def create_tree() -> bpy.types.Object:
    """Create a trunk and leaf cards around a crown, as one object with two materials."""
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
    for name, color in (("Bark", (0.2, 0.1, 0.05, 1.0)), ("Leaf", (0.05, 0.4, 0.05, 1.0))):
        material = bpy.data.materials.new(name)
        if material.node_tree is None:
            material.use_nodes = True
        material.node_tree.nodes["Principled BSDF"].inputs["Base Color"].default_value = color
        mesh.materials.append(material)
    for polygon in mesh.polygons[len(sides) :]:
        polygon.material_index = 1
    tree = bpy.data.objects.new("Tree", mesh)
    bpy.context.scene.collection.objects.link(tree)
    return tree


class UserInput:
    """Simulated mouse and keyboard of the first window."""

    def __init__(self) -> None:
        self.window = bpy.context.window_manager.windows[0]
        self.area = next(area for area in self.window.screen.areas if area.type == "VIEW_3D")

    def region(self, region_type: str) -> bpy.types.Region:
        """Return a region of the 3D Viewport."""
        return next(region for region in self.area.regions if region.type == region_type)

    def move(self, x: int, y: int) -> None:
        """Move the mouse."""
        self.window.event_simulate(type="MOUSEMOVE", value="NOTHING", x=x, y=y)

    def press(self, key: str, x: int, y: int, ctrl: bool = False) -> None:
        """Press and release a key or mouse button."""
        for value in ("PRESS", "RELEASE"):
            self.window.event_simulate(type=key, value=value, x=x, y=y, ctrl=ctrl)

    def is_on_button(self, operator: str) -> bool:
        """Whether the mouse is on the button of `operator`: Blender can then copy the button's Python command."""
        window_manager = bpy.context.window_manager
        with bpy.context.temp_override(window=self.window, area=self.area, region=self.region("UI")):
            if not bpy.ops.ui.copy_python_command_button.poll():
                return False
            window_manager.clipboard = ""
            bpy.ops.ui.copy_python_command_button()
        return window_manager.clipboard.startswith(f"bpy.ops.{operator}(")

    def find_button(self, operator: str) -> Iterator[float | tuple[int, int]]:
        """Move the mouse down the sidebar until it is on the button of `operator`; return the position of the mouse."""
        sidebar = self.region("UI")
        x = sidebar.x + sidebar.width // 2
        self.move(sidebar.x - 200, sidebar.y + sidebar.height // 2)  # leave the sidebar, or the last pressed button stays active
        yield 3 * POLL_SECONDS
        for y in range(sidebar.y + sidebar.height - 10, sidebar.y, -9):
            self.move(x, y)
            yield POLL_SECONDS
            if self.is_on_button(operator):
                self.move(x, y - 1)
                yield 3 * POLL_SECONDS
                if self.is_on_button(operator):
                    return x, y - 1
        raise AssertionError(f"the sidebar has no button for {operator}")

    def press_undo(self) -> Iterator[float]:
        """Press Ctrl Z in the 3D Viewport."""
        viewport = self.region("WINDOW")
        center = viewport.x + viewport.width // 2, viewport.y + viewport.height // 2
        self.move(*center)
        yield 0.5
        self.press("Z", *center, ctrl=True)
        yield 1.5

    def press_and_start(self, operator: str) -> Iterator[float | tuple[int, int]]:
        """Press the button of `operator` and wait until its job runs; return the position of the button."""
        x, y = yield from self.find_button(operator)
        self.press("LEFTMOUSE", x, y)
        started = time.monotonic()
        while current_job() is None:
            assert time.monotonic() - started < START_TIMEOUT_SECONDS, "the button starts no job"
            yield 0.02
        return x, y

    def open_sidebar(self) -> Iterator[float]:
        """Show the tab *Farfield* of the sidebar."""
        self.area.spaces.active.show_region_ui = True
        yield 2.0
        self.region("UI").active_panel_category = "Farfield"
        self.region("UI").tag_redraw()
        yield 2.0


def save_screenshot(name: str) -> None:
    """Save a screenshot of the whole window if ImageMagick is installed."""
    if shutil.which("import"):
        subprocess.run(["import", "-window", "root", str(FOLDER / f"{name}.png")], check=False)


def level_names() -> list[str]:
    """Return the names of the level objects in the file."""
    return sorted(item.name for item in bpy.data.objects if item.get("farfield_kind") == "cloud")


def scene_state() -> dict:
    """Return the names of all data that a cancelled job must leave unchanged."""
    return {
        collection: sorted(item.name for item in getattr(bpy.data, collection))
        for collection in ("objects", "meshes", "materials", "images", "scenes", "collections", "cameras", "node_groups")
    }


def module(name: str):
    """Return a module of the installed extension."""
    return sys.modules[f"{PACKAGE}.{name}"]


def current_job():
    """Return the running job, None if there is none."""
    return module("addon.operators.long_work").current_run()


def open_panel_alone(tool: str, *sub_panels: str) -> None:
    """Open the panel of `tool` with its `sub_panels` and close those of the other tools, so that it fits in the window.

    The panels are those of the extension's registration: every panel module has a main panel that is named after it.
    """
    panel_modules = [item for item in module("addon.registration").MODULES if ".addon.panels." in item.__name__]
    for item in reversed(panel_modules):
        item.unregister()
    for item in panel_modules:
        name = item.__name__.rpartition(".")[2]
        getattr(item, f"FARFIELD_PT_{name}").bl_options = set() if name == tool else {"DEFAULT_CLOSED"}
        for sub_panel in sub_panels if name == tool else ():
            getattr(item, f"FARFIELD_PT_{name}_{sub_panel}").bl_options = set()
        item.register()


def wait_for_job(until_fraction: float | None = None) -> Iterator[float | list[float]]:
    """Wait until the job ends or its progress reaches `until_fraction`; return the fractions on the way."""
    fractions, started = [], time.monotonic()
    while current_job() is not None:
        assert time.monotonic() - started < JOB_TIMEOUT_SECONDS, "the job does not end"
        fractions.append(current_job().progress.fraction)
        if until_fraction is not None and fractions[-1] >= until_fraction:
            break
        yield POLL_SECONDS
    return fractions


def start_session(session: Callable[[], Iterator[float]]) -> None:
    """Enable the extension and run `session`, which yields pauses in seconds. Then write the results and quit Blender."""
    steps = session()

    def advance() -> float | None:
        finished = True
        try:
            pause = next(steps, None)
            finished = pause is None
            return pause
        finally:
            if sys.exc_info()[0] is not None:  # any error must reach the test, which waits outside
                results["error"] = traceback.format_exc()
                save_screenshot("error")
            if finished:
                (FOLDER / "results.json").write_text(json.dumps(results, indent=2), encoding="utf-8")
                bpy.ops.wm.quit_blender()

    bpy.context.preferences.view.show_splash = False
    addon_utils.enable(PACKAGE)
    bpy.app.timers.register(advance, first_interval=3.0)
