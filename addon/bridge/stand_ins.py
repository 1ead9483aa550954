"""The faces of a source as plain meshes, moved as a whole, wearing copies of their materials that show something else."""

from collections.abc import Callable, Iterator

import bpy
import numpy as np

from .meshes import Source
from .slot_meshes import Drawn, drawn_surfaces, slot_mesh, slot_positions
from .slots import Slots
from .temporary import TemporaryScene
from .world_nodes import asked_layers


def moved_as_a_whole(center: np.ndarray, scale: float = 1.0) -> Slots:
    """One slot for everything: p -> scale * (p - center)."""
    return Slots(center[None], np.eye(3)[None], np.zeros((1, 3)), np.array([scale]))


def stand_ins(
    work: TemporaryScene, source: Source, slots: Slots, copy_of: Callable[[bpy.types.Material | None, str], bpy.types.Material]
) -> Iterator[tuple[bpy.types.Mesh, Drawn]]:
    """Add every face of `source`, moved by the one slot of `slots`, to the scene of `work`; a mesh for each surface, and what it draws.

    copy_of: makes the copy of a material, or of None, that a surface wears; its second argument is the colour attribute that a point
    cloud without material shows, or "".
    """
    count = sum(len(part.surface.triangles) for part in source.parts) // source.triangles_per_primitive
    copies: dict[tuple, bpy.types.Material] = {}
    for drawn in drawn_surfaces(source, np.arange(count), np.zeros(count, np.int64)):
        color_layer = drawn.surface.color if source.points is not None else ""
        keys = [(material, color_layer) for material in drawn.surface.materials]
        for key in keys:
            if key not in copies:
                copies[key] = copy_of(None if key[0] is None else bpy.data.materials[key[0]], color_layer)
        world, moved = slot_positions(drawn, slots)
        asked = set().union(*(asked_layers(copies[key].node_tree) for key in keys))
        mesh = work.keep(slot_mesh("Farfield Stand-in", drawn, world, moved, np.zeros_like(world), slots, asked))
        for key in keys:
            mesh.materials.append(copies[key])
        work.add(mesh)
        yield mesh, drawn
