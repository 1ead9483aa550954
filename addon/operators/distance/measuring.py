"""Time, memory and image with the originals and with levels by distance: jobs that render some frames in a process of their own."""

import json
import shutil
from concurrent.futures import wait
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import bpy

from ...bridge.distance.frame_renders import FIGURES_FILE, LEVELS, ORIGINALS, read_progress, render_command, write_scene
from ...bridge.distance.placing import has_levels
from ...bridge.objects import find_by_uid
from ...bridge.snapshots import may_run_python_drivers
from ...core.errors import FarfieldError, GeometryError
from ...core.files.temporary_folders import create_temporary_folder
from ...core.jobs.core_worker import EXIT_ERROR, EXIT_EXCEPTION, failure_message, worker_exception
from ...core.jobs.heartbeat import take_over
from ...core.jobs.progress import Steps
from ...core.jobs.subprocess_pool import open_subprocess_pool, wait_for_exit
from ...core.messages import format_bytes, format_count

POLL_SECONDS = 0.1


@dataclass
class FrameRenders:
    """Renders of a copy of a scene.

    Attributes:
        folder: holds the copy, and is deleted at the end.
        run_drivers: whether its drivers may run any Python.
    """

    folder: Path
    run_drivers: bool

    def core_steps(self) -> Steps[str]:
        """Let the process render; return the figures as text. Closing this generator ends the process.

        Raises:
            FarfieldError: the scene cannot be rendered, or the process crashes.
        """
        try:
            with closing(take_over(self.folder)) as held, open_subprocess_pool(1) as pool:
                future = pool.submit(render_command(self.folder, held.path, run_drivers=self.run_drivers))
                while not future.done():
                    held.renew()
                    yield read_progress(self.folder)
                    wait([future], POLL_SECONDS)
                code, error_output = wait_for_exit(future)
            if code == EXIT_EXCEPTION:
                raise worker_exception(error_output, "frames")
            if code == EXIT_ERROR:
                raise FarfieldError(failure_message(code, error_output, "frames"))
            if code:
                raise FarfieldError("The process that renders crashed, perhaps because memory ran out; try to render a frame yourself.")
            return (self.folder / FIGURES_FILE).read_text(encoding="utf-8")
        finally:
            shutil.rmtree(self.folder, ignore_errors=True)


@dataclass
class MeasureJob(FrameRenders):
    """Renders up to three frames twice each, and stores the figures for the panel. scene_uid: the scene."""

    core_fraction = 1.0

    scene_uid: int

    def scene_steps(self, core_result: str) -> Steps[str]:
        """Store the figures.

        Raises:
            GeometryError: the scene or its levels were removed meanwhile.
        """
        yield from ()
        scene = find_by_uid(bpy.data.scenes, self.scene_uid)
        if scene is None or not has_levels(scene):
            raise GeometryError("The scene or its levels were removed; start again.")
        scene.farfield_distance.figures = core_result
        return describe_figures(core_result)


def prepare(scene: bpy.types.Scene) -> MeasureJob:
    """Write a copy of `scene` and return the job that renders it. Raises FileError."""
    return MeasureJob(_write(scene), may_run_python_drivers(), scene.session_uid)


def prepare_search(scene: bpy.types.Scene, seconds: float, min_error: float) -> FrameRenders:
    """Write a copy of `scene`, whose levels have the error `min_error` in pixels, and return the renders that search for the smallest error
    with which a frame takes at most so many seconds. Raises FileError."""
    return FrameRenders(_write(scene, (seconds, min_error)), may_run_python_drivers())


def _write(scene: bpy.types.Scene, budget: tuple[float, float] | None = None) -> Path:
    folder = create_temporary_folder()
    try:
        write_scene(folder, scene, budget)
    except FarfieldError:
        shutil.rmtree(folder, ignore_errors=True)
        raise
    return folder


def describe_figures(figures: str) -> str:
    """Return one sentence about stored figures."""
    values = json.loads(figures)
    before, after = values[ORIGINALS], values[LEVELS]
    memory = f", {format_bytes(after['memory'])} instead of {format_bytes(before['memory'])} of memory" if before["memory"] else ""
    frames = format_count(values["frames"], "frame")
    return f"Mean of {frames}: {after['seconds']:,.1f} s instead of {before['seconds']:,.1f} s{memory}, FLIP {values['flip']:.3f}."
