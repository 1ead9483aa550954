"""A small scene with a cloud that is baked by worker processes, and functions that find these processes."""

import hashlib
import shutil
import signal
import tempfile
from functools import cache
from pathlib import Path
from typing import Any

import bpy

from bridge import blender_scenes
from farfield.addon.bridge.billboards.scene_clouds import SceneCloud, clouds_in, read_cloud
from farfield.addon.bridge.btf.capture.snapshot import open_snapshot, store_folder
from farfield.addon.bridge.btf.capture.worker import capture_views
from farfield.addon.core.btf.settings import BtfSettings
from farfield.addon.core.settings import flag_of
from farfield.addon.operators.btf import estimates
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


def build_cloud(source: bpy.types.Object, **settings: Any) -> SceneCloud:
    """Build a coarse cloud of `source`, with two levels unless `settings` say otherwise."""
    for item in bpy.context.selected_objects:
        item.select_set(False)
    bpy.context.view_layer.objects.active = source
    source.select_set(True)
    coarse = {"error": 10.0, "levels": 2, "nested_levels": True, "samples": 1, "keep_original_visible": True}
    bpy.ops.farfield.billboards_build(**(coarse | settings))
    return clouds_in(bpy.context.scene)[0]


def finished_views_of_small_cloud(model: str = SMALL["model"]) -> Path:
    """Return a work folder with all finished views of a bake of the small cloud, captured in this process. Each process does it once."""
    return _capture_small_cloud(model)


@cache  # which would tell the default of the model from the same model given
def _capture_small_cloud(model: str) -> Path:
    folder = Path(tempfile.mkdtemp(prefix="farfield-small-bake-"))
    settings = BtfSettings(**SMALL | {"model": model}, executor="serial")
    job = prepare_bake(bpy.context, build_small_cloud(), settings, folder, keep_finished_views=True)
    capture_views(open_snapshot(job.run.snapshot_folder, run_drivers=False), folder, list(range(settings.view_count)), threads=2)
    job.run.close()
    return folder


def copy_finished_views(folder: Path, model: str = SMALL["model"]) -> Path:
    """Copy the finished views of the small cloud to the work folder `folder`, so that a bake there renders nothing; return it.

    Call it before the cloud is opened: the first call in a process opens other files.
    """
    return shutil.copytree(finished_views_of_small_cloud(model), folder, dirs_exist_ok=True)


def bake_finished_views(cloud: SceneCloud, model: str = SMALL["model"]) -> None:
    """Bake the small cloud with the operator. It renders nothing; `finished_views_of_small_cloud` must have been called before."""
    settings = SMALL | {"model": model}
    bake = BtfSettings(**settings, executor="serial")
    cloud = read_cloud(cloud.collection)  # which may have linked duplicates by now
    folder = estimates.capture_folder(cloud, bake)
    for index, level in enumerate(cloud.levels):
        views = store_folder(finished_views_of_small_cloud(model), level["farfield_level"])
        shutil.copytree(views, store_folder(folder, index), dirs_exist_ok=True)
    bpy.context.view_layer.objects.active = cloud.levels[0]
    assert estimates.count_finished_views(cloud, bake) == bake.view_count * len(cloud.levels)
    assert bpy.ops.farfield.btf_bake(**settings, executor="serial") == {"FINISHED"}


def bake_in_this_process(cloud: SceneCloud, **settings: Any) -> SceneCloud:
    """Bake a cloud with the operator after capturing its views in this process: starting a worker takes longer than these renders.

    The file is saved and opened again, so use the returned cloud instead of `cloud`.
    """
    path = Path(tempfile.mkdtemp(prefix="farfield-bake-")) / "scene.blend"
    scene_files.save_scene(path)
    bake = BtfSettings(**settings)
    folder = estimates.capture_folder(cloud, bake)
    job = prepare_bake(bpy.context, cloud, bake, folder, keep_finished_views=True)
    capture_views(open_snapshot(job.run.snapshot_folder, run_drivers=False), folder, list(range(bake.view_count)), threads=2)
    job.run.close()
    cloud = open_cloud(path)
    bpy.context.view_layer.objects.active = cloud.levels[0]
    assert estimates.count_finished_views(cloud, bake) == bake.view_count * len(cloud.levels)
    assert bpy.ops.farfield.btf_bake(**settings) == {"FINISHED"}
    return cloud


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
