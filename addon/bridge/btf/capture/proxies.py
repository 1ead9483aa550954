"""Proxies of a source: its faces as ordinary meshes, with copies of their materials that show something else."""

from collections.abc import Callable, Iterator, Sequence

import bpy
import numpy as np

from ...billboards.atlas_meshes import (
    AtlasPlacement,
    DrawnTriangles,
    add_atlas_mesh,
    compute_atlas_positions,
    copy_materials,
    find_drawn_triangles,
)
from ...geometry.meshes import Source
from ...rendering.render_scene import RenderScene
from ...shading.material_channels import CaptureMaterial, build_capture_material


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
        materials = copy_materials(source, drawn, copies, copy_material)
        world, placed = compute_atlas_positions(drawn, placement)
        yield add_atlas_mesh(work, drawn, world, placed, np.zeros_like(world), placement, materials), drawn


def add_channel_proxies(
    work: RenderScene, source: Source, placement: AtlasPlacement, error: float, layers: Sequence[str] = ()
) -> list[CaptureMaterial]:
    """Add proxies as `add_proxies` does, and return their materials, which emit channels. error, layers: see `build_capture_material`."""
    materials: list[CaptureMaterial] = []

    def copy_material(original: bpy.types.Material | None, color_layer: str) -> bpy.types.Material:
        materials.append(build_capture_material(original, color_layer, error, False, work, layers))
        return materials[-1].material

    for _ in add_proxies(work, source, placement, copy_material):
        pass
    return materials
