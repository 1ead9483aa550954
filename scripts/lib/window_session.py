"""For scripts that run inside a Blender window: its regions, Farfield's panels and jobs, and steps with pauses between them.

`blender_window` opens the window. This module needs nothing but Blender.
"""

import sys
import time
import traceback
from collections.abc import Callable, Iterator

import addon_utils
import bpy

from lib.blender_window import PACKAGE

POLL_SECONDS = 0.1
JOB_TIMEOUT_SECONDS = 300.0


def viewport() -> bpy.types.Area:
    """Return the 3D Viewport of the first window."""
    return next(area for area in bpy.context.window_manager.windows[0].screen.areas if area.type == "VIEW_3D")


def region(region_type: str) -> bpy.types.Region:
    """Return the region of the 3D Viewport with this type, for instance `UI` for the sidebar."""
    return next(region for region in viewport().regions if region.type == region_type)


def module(name: str):
    """Return a module of the installed extension."""
    return sys.modules[f"{PACKAGE}.{name}"]


def current_job():
    """Return the running job, None if there is none."""
    return module("addon.operators.long_work").current_run()


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


def open_panel(tool: str, is_open: Callable[[type], bool]) -> None:
    """Show the panel of `tool` first and open, with the sub-panels for which `is_open` is true; close the panels of the other tools.

    The panels are those of the extension's registration: every module of panels has CLASSES, and those without a parent are main panels.
    """
    modules = module("addon.registration").MODULES
    panel_modules = [item for item in modules if ".addon.panels." in item.__name__ and hasattr(item, "CLASSES")]
    for item in reversed(panel_modules):
        item.unregister()
    for item in sorted(panel_modules, key=lambda item: not _belongs_to(item, tool)):
        for cls in item.CLASSES:
            is_main = not hasattr(cls, "bl_parent_id")
            if is_main or _belongs_to(item, tool):
                opens = _belongs_to(item, tool) and (is_main or is_open(cls))
                cls.bl_options = set(getattr(cls, "bl_options", set())) - {"DEFAULT_CLOSED"} | (set() if opens else {"DEFAULT_CLOSED"})
        item.register()


def run_steps(steps: Iterator[float], on_end: Callable[[str | None], None]) -> None:
    """Enable the extension and run `steps`, which yields pauses in seconds. Then call `on_end` and quit Blender.

    `on_end` receives the traceback of an error in `steps`, or None: any error must reach the process that waits outside.
    """

    def advance() -> float | None:
        finished, error = True, None
        try:
            pause = next(steps, None)
            finished = pause is None
            return pause
        finally:
            if sys.exc_info()[0] is not None:
                error = traceback.format_exc()
            if finished:
                on_end(error)
                bpy.ops.wm.quit_blender()

    bpy.context.preferences.view.show_splash = False
    addon_utils.enable(PACKAGE)
    bpy.app.timers.register(advance, first_interval=3.0, persistent=True)


def _belongs_to(panel_module, tool: str) -> bool:
    return panel_module.__name__.rpartition(".")[2] == tool
