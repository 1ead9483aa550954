"""The node group of the ground, filled once per process: its hundreds of nodes take Blender most of the time of a small terrain."""

from pathlib import Path

import bpy
import pytest

from farfield.addon.bridge.shading import ground
from farfield.addon.bridge.shading.node_builder import ensure_shared_group


def keep_ground_group(patch: pytest.MonkeyPatch, folder: Path) -> None:
    """Let `add_ground` load its group from a file in `folder`, which the first call writes."""
    path = folder / "ground.blend"

    def ensure_kept_group(name: str, *arguments) -> bpy.types.NodeTree:
        is_there = any(group.name.startswith(name) and group.library is None for group in bpy.data.node_groups)
        if path.exists() and not is_there:
            libraries = set(bpy.data.libraries)
            with bpy.data.libraries.load(str(path)) as (_, wanted):
                wanted.node_groups = [name]
            bpy.data.batch_remove(set(bpy.data.libraries) - libraries)
        group = ensure_shared_group(name, *arguments)
        if not path.exists():
            bpy.data.libraries.write(str(path), {group})
        return group

    patch.setattr(ground, "ensure_shared_group", ensure_kept_group)
