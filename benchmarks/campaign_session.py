"""One long session of Blender: many runs of each tool one after the other, with the memory and the threads after each.

    python3 benchmarks/campaign_session.py LOG.jsonl CLOUD.blend PROJECT KIND=COUNT ...

Started by `campaign_faults.py`; PROJECT is a folder of `campaign_projects.write_photo_project`. Each line of the log has the kind, the
number of the run, the memory in MB and the number of threads.
"""

import ctypes
import gc
import json
import os
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "scripts"))

from lib import environment

environment.ensure()
farfield = environment.import_farfield()
sys.path.append(str(environment.ROOT / "tests"))

import bpy
import numpy as np

from textured_scenes import textured_ball

BAKE = {
    "views_per_side": 2, "lights_per_side": 2, "samples": 1, "components": 2, "alpha_components": 2, "shadows_per_side": 2,
    "shadow_components": 2, "executor": "serial",
}  # fmt: skip
LEVELS = {"views": 2, "max_image": 32, "levels": "number", "number": 2}


@dataclass(frozen=True)
class Files:
    """Input of the runs.

    cloud: a .blend file with a cloud. project: a folder with a mesh, photographs and cameras. folder: for outputs and further input.
    """

    cloud: Path
    project: Path
    folder: Path


def build(_files: Files) -> None:
    """Build the cloud of a cube."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    bpy.ops.mesh.primitive_cube_add(size=2.0)
    bpy.ops.farfield.billboards_build(error=10.0, levels=2, nested_levels=True, samples=1)


def create_terrain(_files: Files) -> None:
    """Create a small terrain."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    bpy.ops.farfield.clipbox_create(resolution=32, boxes=3)


def bake(files: Files) -> None:
    """Bake the cloud of a file."""
    bpy.ops.wm.open_mainfile(filepath=str(files.cloud), load_ui=False)
    bpy.context.view_layer.objects.active = next(item for item in bpy.data.objects if item.get("farfield_kind") == "cloud")
    bpy.ops.farfield.btf_bake(**BAKE)


def unwrap(_files: Files) -> None:
    """Unwrap a sphere."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    bpy.ops.mesh.primitive_ico_sphere_add(subdivisions=3)
    bpy.ops.farfield.unwrap()


def restore(_files: Files) -> None:
    """Restore an image."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    pixels = np.ones((64, 64, 4), np.float32)
    pixels[..., :3] = np.random.default_rng(0).random((64, 64, 1))
    pixels[20:30, 20:30, 3] = 0.0
    image = bpy.data.images.new("Image", 64, 64, alpha=True)
    image.pixels.foreach_set(pixels.ravel())
    bpy.ops.farfield.restore_image(image="Image", mask="alpha", pyramid_levels=1)


def make_levels(_files: Files) -> None:
    """Make perceptual levels of a textured sphere."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    textured_ball(8)
    bpy.ops.farfield.texmesh_levels(**LEVELS)


def export_package(files: Files) -> None:
    """Export a package of a textured sphere."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    textured_ball(8)
    bpy.ops.farfield.packages_export(folder=str(files.folder / "package"), pixels=32, tile_size=32, **LEVELS)


def merge_photographs(files: Files) -> None:
    """Merge photographs into a texture."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    bpy.ops.wm.obj_import(filepath=str(files.project / "plane.obj"), forward_axis="Y", up_axis="Z")
    bpy.ops.farfield.photos_import_cameras(filepath=str(files.project / "transforms.json"))
    bpy.context.view_layer.objects.active = bpy.data.objects["plane"]
    bpy.data.objects["plane"].select_set(True)
    bpy.ops.farfield.photos_merge(size=64)


def build_store(files: Files) -> None:
    """Build a large terrain and load it."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    source = files.folder / "heights.npy"
    np.save(source, np.add.outer(np.arange(65.0), np.arange(65.0)))
    store = str(files.folder / "store")
    bpy.ops.farfield.bdam_build(sources=[{"name": str(source)}], store=store, patch_size="16", executor="serial")
    bpy.ops.farfield.bdam_load(directory=store)


KINDS: dict[str, Callable[[Files], None]] = {
    "builds": build,
    "terrains": create_terrain,
    "unwraps": unwrap,
    "restorations": restore,
    "levels": make_levels,
    "packages": export_package,
    "photo textures": merge_photographs,
    "large terrains": build_store,
    "bakes": bake,
}


def main() -> None:
    log, cloud, project = map(Path, sys.argv[1:4])
    farfield.register()
    with tempfile.TemporaryDirectory(prefix="farfield-session-") as folder, log.open("a", encoding="utf-8", buffering=1) as file:
        files = Files(cloud, project, Path(folder))
        for argument in sys.argv[4:]:
            kind, _, count = argument.partition("=")
            for index in range(int(count)):
                KINDS[kind](files)
                file.write(json.dumps({"kind": kind, "run": index + 1, "memory_mb": memory_mb(), "threads": thread_count()}) + "\n")
    farfield.unregister()
    sys.stdout.flush()
    os._exit(0)  # Blender 4.5 hangs during shutdown


def memory_mb() -> float | None:
    """Return the memory of this process after what is free was given back to the system; None where there is no /proc."""
    gc.collect()
    if sys.platform != "linux":
        return None
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim is not None:
        trim(0)
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return round(pages * os.sysconf("SC_PAGE_SIZE") / 1e6, 1)


def thread_count() -> int | None:
    """Return the number of threads of this process; None where there is no /proc."""
    tasks = Path("/proc/self/task")
    return len(list(tasks.iterdir())) if tasks.is_dir() else None


if __name__ == "__main__":
    main()
