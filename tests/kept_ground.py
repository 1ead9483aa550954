"""The node group of the ground, filled once per run: its hundreds of nodes take Blender most of the time of a small terrain."""

from pathlib import Path

import bpy
import pytest

from farfield.addon.bridge.shading import ground
from farfield.addon.bridge.shading.node_builder import ensure_shared_group
from shared_results import make_once


def keep_ground_group(patch: pytest.MonkeyPatch) -> None:
    """Let `add_ground` load its group from a file that the first call of the run writes."""

    def ensure_kept_group(name: str, *arguments) -> bpy.types.NodeTree:
        if any(group.name.startswith(name) and group.library is None for group in bpy.data.node_groups):
            return ensure_shared_group(name, *arguments)

        def write(path: Path) -> None:
            bpy.data.libraries.write(str(path), {ensure_shared_group(name, *arguments)})

        path = make_once("ground.blend", write)
        if not any(group.name == name for group in bpy.data.node_groups):
            libraries = set(bpy.data.libraries)
            with bpy.data.libraries.load(str(path)) as (_, wanted):
                wanted.node_groups = [name]
            bpy.data.batch_remove(set(bpy.data.libraries) - libraries)
        return ensure_shared_group(name, *arguments)

    patch.setattr(ground, "ensure_shared_group", ensure_kept_group)
