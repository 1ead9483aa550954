"""One long session of Blender: many builds, terrains and bakes one after the other, with the memory and the threads after each.

    python3 benchmarks/campaign_session.py LOG.jsonl CLOUD.blend KIND=COUNT ...

Started by `campaign_faults.py`. Each line of the log has the kind, the number of the run, the memory in MB and the number of threads.
"""

import ctypes
import gc
import json
import os
import sys
from collections.abc import Callable
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "scripts"))

from lib import environment

environment.ensure()
farfield = environment.import_farfield()

import bpy

BAKE = {
    "views_per_side": 2, "lights_per_side": 2, "samples": 1, "components": 2, "alpha_components": 2, "shadows_per_side": 2,
    "shadow_components": 2, "executor": "serial",
}  # fmt: skip


def build(_cloud: Path) -> None:
    """Build the cloud of a cube."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    bpy.ops.mesh.primitive_cube_add(size=2.0)
    bpy.ops.farfield.billboards_build(error=10.0, levels=2, samples=1)


def create_terrain(_cloud: Path) -> None:
    """Create a small terrain."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    bpy.ops.farfield.clipbox_create(resolution=32, boxes=3)


def bake(cloud: Path) -> None:
    """Bake the cloud of a file."""
    bpy.ops.wm.open_mainfile(filepath=str(cloud), load_ui=False)
    bpy.context.view_layer.objects.active = next(item for item in bpy.data.objects if item.get("farfield_kind") == "cloud")
    bpy.ops.farfield.btf_bake(**BAKE)


KINDS: dict[str, Callable[[Path], None]] = {"builds": build, "terrains": create_terrain, "bakes": bake}


def main() -> None:
    log, cloud = Path(sys.argv[1]), Path(sys.argv[2])
    farfield.register()
    with log.open("a", encoding="utf-8", buffering=1) as file:
        for argument in sys.argv[3:]:
            kind, _, count = argument.partition("=")
            for index in range(int(count)):
                KINDS[kind](cloud)
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
