"""A session in a Blender window: while jobs of all kinds run, objects are deleted, the scene is undone, or another file is loaded."""

import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from functools import partial
from importlib.util import find_spec
from pathlib import Path

import bpy
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent))  # Blender does not add the script's folder

from session import FOLDER, create_tree, current_job, module, results, start_session, wait_for_job
from session_texmesh import create_ball, visible_objects
from session_unwrap import create_bumpy_ball

from lib import window_session

START_SECONDS, END_SECONDS = 20.0, 180.0
DEFECTS = "farfield-defect-*"


def create_small_ball() -> None:
    """Create a textured ball of 2,000 triangles."""
    create_ball(48)


def damaged_image() -> None:
    """Add an image with a transparent square."""
    pixels = np.random.default_rng(0).random((512, 512, 4)).astype(np.float32)
    pixels[..., 3] = 1.0
    pixels[200:300, 200:300, 3] = 0.0
    bpy.data.images.new("Image", 512, 512, alpha=True).pixels.foreach_set(pixels.ravel())


def heights() -> None:
    """Write an elevation model."""
    x = np.arange(1000.0)
    np.save(FOLDER / "heights.npy", 50.0 * np.add.outer(np.sin(0.01 * x), np.cos(0.013 * x)))


def store_properties() -> dict:
    return {"sources": [{"name": str(FOLDER / "heights.npy")}], "store": str(FOLDER / "store"), "executor": "serial"}


JOBS: dict[str, tuple[Callable[[], object], Callable[[], dict]]] = {
    "billboards_build": (create_tree, lambda: {"error": 6.0, "levels": 1, "samples": 1}),
    "unwrap": (create_bumpy_ball, dict),
    "texmesh_levels": (create_small_ball, lambda: {"views": 1, "max_image": 64, "vertices": "original"}),
    "restore_image": (damaged_image, lambda: {"image": "Image", "mask": "alpha"}),
    "clipbox_create": (lambda: None, lambda: {"boxes": 6, "resolution": 64}),
    "bdam_build": (heights, store_properties),
}


def delete_everything() -> None:
    """Delete all objects, meshes and images, as scripts of other add-ons may."""
    for blocks in (bpy.data.objects, bpy.data.meshes, bpy.data.images, bpy.data.materials):
        for block in list(blocks):
            blocks.remove(block)


def load_another_file() -> None:
    """Load the factory scene."""
    bpy.ops.wm.read_homefile(use_factory_startup=True, use_empty=False, load_ui=False)


def undo() -> None:
    """Undo what made the input."""
    bpy.ops.ed.undo()


if find_spec("PIL") is not None:  # Blender of a distribution may have another Python than our wheels.
    JOBS["packages_export"] = (create_small_ball, lambda: {"folder": str(FOLDER / "package")})
INTERRUPTIONS = {"delete": delete_everything, "load": load_another_file, "undo": undo}


def in_viewport(call: Callable[[], object]) -> None:
    """Call something as if the mouse was over the 3D Viewport."""
    window = bpy.context.window_manager.windows[0]
    with bpy.context.temp_override(window=window, area=window_session.viewport(), region=window_session.region("WINDOW")):
        call()


def interrupt_previews() -> Iterator[float]:
    """Do the same to levels whose preview has started by itself."""
    results["previews"] = {}
    preview = module("addon.operators.texmesh.preview").current
    values = {"levels": "number", "number": 3, "views": 1, "max_image": 32, "vertices": "original"}
    for kind, interrupt in INTERRUPTIONS.items():
        in_viewport(load_another_file)
        yield 0.5
        bpy.data.objects.remove(bpy.data.objects["Cube"])
        in_viewport(create_small_ball)
        in_viewport(partial(bpy.ops.ed.undo_push, message="ball"))
        before = set(Path(tempfile.gettempdir()).glob(DEFECTS))
        in_viewport(partial(bpy.ops.farfield.texmesh_levels, "INVOKE_DEFAULT", **values))
        yield from wait_for_job()
        yield 1.0
        had_started, shown = preview.follows_view, visible_objects()
        in_viewport(interrupt)
        yield 1.0
        results["previews"][kind] = {
            "had_started": had_started,
            "shown": shown,
            "visible": visible_objects(),
            "states": sum("farfield_texmesh_shown" in item for item in bpy.data.objects),
            "rings": preview.follows_view,
            "defects": len(set(Path(tempfile.gettempdir()).glob(DEFECTS)) - before),
        }


def session() -> Iterator[float]:
    """Run the session; yields pauses in seconds."""
    yield from interrupt_previews()
    results["runs"] = []
    for name, (create, properties) in JOBS.items():
        for kind, interrupt in INTERRUPTIONS.items():
            in_viewport(load_another_file)
            yield 0.5
            in_viewport(create)
            in_viewport(partial(bpy.ops.ed.undo_push, message=name))
            before = set(Path(tempfile.gettempdir()).glob(DEFECTS))
            in_viewport(partial(getattr(bpy.ops.farfield, name), "INVOKE_DEFAULT", **properties()))
            started = time.monotonic()
            while current_job() is not None and current_job().progress.fraction < 0.05 and time.monotonic() < started + START_SECONDS:
                yield 0.02
            was_running = current_job() is not None
            in_viewport(interrupt)
            while current_job() is not None and time.monotonic() < started + END_SECONDS:
                yield 0.05
            yield 0.3
            defects = [path.read_text(encoding="utf-8") for path in set(Path(tempfile.gettempdir()).glob(DEFECTS)) - before]
            run = {"job": name, "interruption": kind, "was_running": was_running, "has_ended": current_job() is None, "defects": defects}
            results["runs"].append(run)


if __name__ == "__main__":
    start_session(session)
