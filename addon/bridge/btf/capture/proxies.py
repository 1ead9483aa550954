"""Proxies of a source: its faces as ordinary meshes, with copies of their materials that show something else."""

from collections.abc import Callable, Iterator

import bpy
import numpy as np

from ...billboards.atlas_meshes import AtlasPlacement, DrawnTriangles, compute_atlas_positions, create_atlas_mesh, find_drawn_triangles
from ...geometry.meshes import Source
from ...rendering.render_scene import RenderScene
from ...shading.scene_space_nodes import required_attributes


def single_placement(center: np.ndarray, scale: float = 1.0) -> AtlasPlacement:
    """Return one placement for all faces: p -> scale * (p - center)."""
    return AtlasPlacement(center[None], np.eye(3)[None], np.zeros((1, 3)), np.array([scale]))


def add_proxies(
    work: RenderScene,
    source: Source,
    placement: AtlasPlacement,
    copy_material: Callable[[bpy.types.Material | None, str], bpy.types.Material],
) -> Iterator[tuple[bpy.types.Mesh, DrawnTriangles]]:
    """Add all faces of `source`, transformed by a single `placement`, to the scene of `work`. Yield each mesh with its triangles.

    copy_material: returns the proxy's copy of a material, or of None. Its second argument is the color attribute that a point cloud
    without material shows, or "".
    """
    count = sum(len(instance.mesh.triangles) for instance in source.instances) // source.triangles_per_primitive
    copies: dict[tuple, bpy.types.Material] = {}
    for drawn in find_drawn_triangles(source, np.arange(count), np.zeros(count, np.int64)):
        color_layer = drawn.mesh.color if source.points is not None else ""
        keys = [(material, color_layer) for material in drawn.mesh.materials]
        for key in keys:
            if key not in copies:
                copies[key] = copy_material(None if key[0] is None else bpy.data.materials[key[0]], color_layer)
        world, placed = compute_atlas_positions(drawn, placement)
        attributes = set().union(*(required_attributes(copies[key].node_tree) for key in keys))
        mesh = work.own(create_atlas_mesh("Farfield Proxy", drawn, world, placed, np.zeros_like(world), placement, attributes))
        for key in keys:
            mesh.materials.append(copies[key])
        work.add_object(mesh)
        yield mesh, drawn
