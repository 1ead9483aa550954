"""A session in a Blender window: simulated user input and what the session records. Shared by the session_*.py files.

    blender --enable-event-simulate --python session_TOOL.py -- FOLDER

Writes results.json and screenshots to FOLDER.
"""

import json
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import bpy
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "scripts"))

from lib import window_session
from lib.window_session import POLL_SECONDS, current_job
from lib.window_session import module as module  # for the session_*.py files
from lib.window_session import wait_for_job as wait_for_job

FOLDER = Path(sys.argv[sys.argv.index("--") + 1])
LEAVES = 300
START_TIMEOUT_SECONDS = 20.0
WHEEL_STEPS = 8  # Half of a sidebar.
STEP_PIXELS = 9  # Less than half of the height of a button: on a busy machine, one of two positions may be missed.

results: dict = {"error": None}


def wait_until(is_done: Callable[[], bool], seconds: float = START_TIMEOUT_SECONDS) -> Iterator[float]:
    """Wait until `is_done`, or for so long on a busy machine."""
    start = time.monotonic()
    while not is_done() and time.monotonic() - start < seconds:
        yield POLL_SECONDS


def create_tree() -> bpy.types.Object:
    """Create a trunk and leaf cards around a crown, as one object with two materials. It is selected and active."""
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
    bpy.context.view_layer.objects.active = tree
    tree.select_set(True)
    return tree


class UserInput:
    """Simulated mouse and keyboard of the first window."""

    def __init__(self) -> None:
        self.window = bpy.context.window_manager.windows[0]
        self.area = window_session.viewport()
        self._found: dict[str, int] = {}  # Height of the mouse on buttons that were found, by operator.

    def region(self, region_type: str) -> bpy.types.Region:
        """Return a region of the 3D Viewport."""
        return window_session.region(region_type)

    def move(self, x: int, y: int) -> None:
        """Move the mouse."""
        self.window.event_simulate(type="MOUSEMOVE", value="NOTHING", x=x, y=y)

    def press(self, key: str, x: int, y: int, ctrl: bool = False, shift: bool = False) -> None:
        """Press and release a key or mouse button."""
        for value in ("PRESS", "RELEASE"):
            self.window.event_simulate(type=key, value=value, x=x, y=y, ctrl=ctrl, shift=shift)

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
        """Move the mouse down the sidebar until it is on the button of `operator`, first to where this was before; return the position of
        the mouse. If no visible button is it, scroll down, as a user would."""
        sidebar = self.region("UI")
        x = sidebar.x + sidebar.width // 2
        heights = range(sidebar.y + sidebar.height - 10, sidebar.y, -STEP_PIXELS)
        known = [self._found[operator]] if operator in self._found else []
        for tried in ([*known, *heights], heights, heights):
            self.move(sidebar.x - 200, sidebar.y + sidebar.height // 2)  # leave the sidebar, or the last pressed button stays active
            yield 3 * POLL_SECONDS
            for y in tried:
                self.move(x, y)
                yield POLL_SECONDS
                for other in (y - 1, y + 1) if self.is_on_button(operator) else ():
                    self.move(x, other)
                    yield 3 * POLL_SECONDS
                    if self.is_on_button(operator):
                        self._found[operator] = other
                        return x, other
            for _ in range(WHEEL_STEPS):
                self.press("WHEELDOWNMOUSE", x, sidebar.y + sidebar.height // 2)
            yield 3 * POLL_SECONDS
        raise AssertionError(f"the sidebar has no button for {operator}")

    def press_undo(self, redo: bool = False) -> Iterator[float]:
        """Press Ctrl Z in the 3D Viewport, or Shift Ctrl Z to redo."""
        viewport = self.region("WINDOW")
        center = viewport.x + viewport.width // 2, viewport.y + viewport.height // 2
        self.move(*center)
        yield 0.5
        self.press("Z", *center, ctrl=True, shift=redo)
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


def open_panel_alone(tool: str, *sub_panels: str) -> None:
    """Open the panel of `tool` with its `sub_panels` and those that are open by default, and close those of the other tools."""
    names = {f"FARFIELD_PT_{tool}_{sub_panel}" for sub_panel in sub_panels}
    window_session.open_panel(tool, lambda cls: cls.__name__ in names or "DEFAULT_CLOSED" not in getattr(cls, "bl_options", set()))


def start_session(session: Callable[[], Iterator[float]]) -> None:
    """Enable the extension and run `session`, which yields pauses in seconds. Then write the results and quit Blender."""

    def write_results(error: str | None) -> None:
        results["error"] = error
        if error:
            save_screenshot("error")
        (FOLDER / "results.json").write_text(json.dumps(results, indent=2), encoding="utf-8")

    bpy.context.preferences.system.viewport_aa = "OFF"  # otherwise software OpenGL draws each change of a viewport eight times
    space = window_session.viewport().spaces.active
    space.show_gizmo = space.overlay.show_floor = False  # They take half of the time of a redraw.
    space.overlay.show_axis_x = space.overlay.show_axis_y = False
    window_session.run_steps(session(), write_results)
