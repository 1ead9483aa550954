"""A small scene with a cloud that is baked by worker processes, and functions that find these processes."""

import hashlib
import signal
import tempfile
from functools import cache
from pathlib import Path
from typing import Any

import bpy

from bridge import blender_scenes
from farfield.addon.bridge.billboards.scene_clouds import SceneCloud, clouds_in
from farfield.addon.core.btf.settings import BtfSettings
from farfield.addon.core.settings import flag_of
from farfield.addon.operators.btf.job import BakeJob, prepare_bake
from lib import scene_files

SMALL = {
    "model": "emission",
    "views_per_side": 2,
    "lights_per_side": 2,
    "samples": 1,
    "components": 2,
    "alpha_components": 2,
    "shadows_per_side": 2,
    "shadow_components": 2,
}


def to_flags(settings: dict[str, Any]) -> list[str]:
    """Return numbers and texts of `settings` as the flags of a script."""
    return [text for name, value in settings.items() for text in (flag_of(name), str(value))]


def open_cloud(path: Path) -> SceneCloud:
    """Open a file and return its cloud."""
    bpy.ops.wm.open_mainfile(filepath=str(path))
    return clouds_in(bpy.context.scene)[0]


def build_small_cloud() -> SceneCloud:
    """Return the cloud with two levels of a red ball, in an unsaved file that contains nothing else. Each process builds it once."""
    bpy.ops.wm.read_homefile(filepath=str(_small_cloud_file()))
    return clouds_in(bpy.context.scene)[0]


@cache
def _small_cloud_file() -> Path:
    blender_scenes.reset_scene()
    build_cloud(blender_scenes.ball(material=blender_scenes.create_material("Red", (0.8, 0.2, 0.1), 1.0)))
    path = Path(tempfile.mkdtemp(prefix="farfield-small-cloud-")) / "cloud.blend"  # in the folder that conftest.py removes
    scene_files.save_scene(path)
    return path


def build_cloud(source: bpy.types.Object) -> SceneCloud:
    """Build a coarse cloud of `source` with two levels."""
    for item in bpy.context.selected_objects:
        item.select_set(False)
    bpy.context.view_layer.objects.active = source
    source.select_set(True)
    bpy.ops.farfield.billboards_build(error=10.0, levels=2, samples=1, keep_original_visible=True)
    return clouds_in(bpy.context.scene)[0]


def prepare_job(cloud: SceneCloud, folder: Path | None, executor: str = "serial") -> BakeJob:
    """Return the job that bakes `cloud` with minimal settings."""
    return prepare_bake(bpy.context, cloud, BtfSettings(**SMALL, executor=executor), folder, keep_finished_views=True)


def finished_views(folder: Path) -> list[Path]:
    """Return the finished views in a work folder."""
    return sorted(folder.rglob("view-*.shard"))


def digests(folder: Path) -> dict[str, str]:
    """Return a digest of every finished view by its path relative to `folder`."""
    return {str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest() for path in finished_views(folder)}


def file_states(folder: Path) -> dict[str, tuple[int, int]]:
    """Return inode and modification time of every finished view; they change when the view is written again."""
    return {str(path.relative_to(folder)): (path.stat().st_ino, path.stat().st_mtime_ns) for path in finished_views(folder)}


def worker_pids(folder: Path) -> list[int]:
    """Return the process IDs of the workers for `folder`. Only works on Linux."""
    pids = []
    for process in Path("/proc").iterdir():
        if process.name.isdecimal():
            try:
                arguments = (process / "cmdline").read_bytes().split(b"\0")
            except OSError:
                continue
            if any(argument.endswith(b"worker_start.py") for argument in arguments) and str(folder).encode() in arguments:
                pids.append(int(process.name))
    return pids


KILL_SIGNAL = getattr(signal, "SIGKILL", signal.SIGTERM)
