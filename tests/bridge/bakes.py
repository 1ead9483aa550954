"""A small scene with a cloud, baked by worker processes, and a look at these processes."""

import hashlib
import signal
from pathlib import Path

import bpy

from bridge import blender_scenes
from farfield.addon.core.btf.settings import BtfSettings
from farfield.addon.operators.billboards_clouds import StandingCloud, clouds_in
from farfield.addon.operators.btf_job import BtfJob, prepare

SMALL = {"views": 4, "lights": 4, "samples": 1, "components": 2, "alpha_components": 2, "shadows": 16}


def small_cloud() -> StandingCloud:
    """A red ball and its cloud in two levels, in the open scene."""
    ball = blender_scenes.ball(made=blender_scenes.material("Red", (0.8, 0.2, 0.1), 1.0))
    return cloud_of(ball)


def cloud_of(source: bpy.types.Object) -> StandingCloud:
    """A coarse cloud of `source` in two levels."""
    for item in bpy.context.selected_objects:
        item.select_set(False)
    bpy.context.view_layer.objects.active = source
    source.select_set(True)
    bpy.ops.farfield.billboards_build(error=6.0, levels=2, samples=1)
    return clouds_in(bpy.context.scene)[0]


def job_of(cloud: StandingCloud, folder: Path | None, executor: str = "serial") -> BtfJob:
    """The job that bakes `cloud` with the smallest settings."""
    return prepare(bpy.context, cloud, BtfSettings(**SMALL, executor=executor), folder, keeps_work=True)


def views(folder: Path) -> list[Path]:
    """The finished views below a work folder."""
    return sorted(folder.rglob("view-*.shard"))


def digests(folder: Path) -> dict[str, str]:
    """A digest of every finished view, by its path below `folder`."""
    return {str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest() for path in views(folder)}


def states(folder: Path) -> dict[str, tuple[int, int]]:
    """What changes when a finished view is written again: its inode and its time."""
    return {str(path.relative_to(folder)): (path.stat().st_ino, path.stat().st_mtime_ns) for path in views(folder)}


def workers_of(folder: Path) -> list[int]:
    """Numbers of the worker processes that work for `folder`. Linux alone tells."""
    found = []
    for process in Path("/proc").iterdir():
        if process.name.isdecimal():
            try:
                words = (process / "cmdline").read_bytes().split(b"\0")
            except OSError:
                continue
            if any(word.endswith(b"worker_start.py") for word in words) and str(folder).encode() in words:
                found.append(int(process.name))
    return found


KILL = getattr(signal, "SIGKILL", signal.SIGTERM)
