"""Clip-box terrain in a scene: an Empty at the root, and one mesh object per block as its children.

Vertices are relative to the root, so that shared vertices of blocks have exactly the same position.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import bpy
import numpy as np

from ...core.clipbox.blocks import BlockMesh
from ...core.clipbox.engine import BlockKey, Update
from ...core.clipbox.settings import ClipboxSettings
from ...core.clipbox.to_mesh import ConvertedMesh
from ...core.jobs.progress import Progress, Steps
from ..geometry.mesh_arrays import read_loop_vertices, read_positions, write_triangles, write_uvs
from ..geometry.mesh_pool import PendingMeshes, fill_mesh, mark_spare
from ..terrain_roots import TerrainRoot, copy_material, link_collection, remove_terrain
from .materials import create_water_material, set_water
from .sources import absolute_path

# custom properties of the root and of blocks
SETTINGS_KEY, ORIGIN_KEY, VIEWER_KEY = "farfield_clipbox_settings", "farfield_clipbox_origin", "farfield_clipbox_viewer"
LEFT_OUT_KEY, BLOCK_KEY, WATER_KEY = "farfield_clipbox_left_out", "farfield_clipbox_block", "farfield_clipbox_water"
WATER_SIZE = 8.0  # Side of the surface of water, relative to that of the outermost box.
TERRAIN_NAME, CONVERTED_NAME = "Clip-Box Terrain", "Terrain Mesh"
POOL = "clipbox"


@dataclass(frozen=True)
class SceneTerrain(TerrainRoot):
    """A terrain in the scene."""

    tool: ClassVar[str] = "clipbox"
    label: ClassVar[str] = "clip-box terrain"
    settings_type = ClipboxSettings

    def input_paths(self) -> list[Path]:
        """Return the files of heights and colors. Raises SettingsError."""
        settings = self.settings
        paths = (settings.source, settings.source_color)
        return [Path(absolute_path(path, self.root.library)) for path in paths if path]

    @property
    def viewer(self) -> np.ndarray:
        """Terrain position (3,) float64 of the viewer around whom the boxes lie.

        Raises:
            SettingsError: the custom property is missing or has another type.
        """
        return self.read_position(VIEWER_KEY)

    @property
    def meter(self) -> float:
        """See `TerrainRoot.meter`."""
        return self.settings.scale

    @property
    def is_complete(self) -> bool:
        """Whether none of its boxes is left out for a fast viewer."""
        return LEFT_OUT_KEY not in self.root

    def blocks(self) -> dict[str, bpy.types.Object]:
        """Return its block objects by `block_name`."""
        return {str(child[BLOCK_KEY]): child for child in self.root.children if BLOCK_KEY in child and child.type == "MESH"}

    def ground_objects(self) -> list[bpy.types.Object]:
        """Return its blocks."""
        return list(self.blocks().values())

    @property
    def water(self) -> bpy.types.Object | None:
        """The surface of its water, None if it has none."""
        return next((child for child in self.root.children if WATER_KEY in child), None)

    @property
    def material(self) -> bpy.types.Material | None:
        """The material of its blocks, which the user may have replaced."""
        for block in self.blocks().values():
            if block.data.materials:
                return block.data.materials[0]
        return None


def create_root(scene: bpy.types.Scene, settings: ClipboxSettings, viewer: np.ndarray, origin: np.ndarray) -> SceneTerrain:
    """Create the Empty of a new terrain in a new collection."""
    terrain = SceneTerrain.create(scene, TERRAIN_NAME, origin, settings, settings.voxel_size * settings.resolution / 2)
    terrain.root[VIEWER_KEY] = viewer.tolist()
    return terrain


def block_name(key: BlockKey) -> str:
    """Return the name of a block within its terrain: level and index."""
    level, block_index = key
    return f"{level} {' '.join(str(coordinate) for coordinate in block_index)}"


class PendingBlocks:
    """Meshes that are filled with the surfaces of blocks and shown later. `names` has the mesh names by block."""

    def __init__(self, origin: np.ndarray, settings: ClipboxSettings) -> None:
        """origin: (3,) float64, terrain position that vertices are relative to."""
        self.meshes = PendingMeshes(POOL, "Clip-Box")
        self._origin = origin
        self._is_flat = settings.surface == "blocky" and not settings.smoothing

    def fill(self, key: BlockKey, block: BlockMesh) -> None:
        """Fill a mesh with the surface of a block."""
        self.meshes.fill(key, block.vertices - self._origin, block.triangles, None if self._is_flat else block.normals)


def read_blocks(terrain: SceneTerrain, points: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return vertices (V, 3) float64 and triangles (T, 3) int32 of the blocks above and below any of `points` (N, 3), terrain space."""
    found = []
    for block in terrain.blocks().values():
        positions = read_positions(block.data).astype(np.float64) + terrain.origin
        if len(positions):
            low, high = positions[:, :2].min(axis=0), positions[:, :2].max(axis=0)
            if ((points[:, :2] >= low) & (points[:, :2] <= high)).all(axis=1).any():
                found.append((positions, read_loop_vertices(block.data).reshape(-1, 3)))
    return found


def fill_meshes(update: Update, origin: np.ndarray, settings: ClipboxSettings) -> Steps[PendingMeshes]:
    """Fill meshes with all surfaces of an update, one per step."""
    pending = PendingBlocks(origin, settings)
    for index, (key, block) in enumerate(update.meshes.items()):
        pending.fill(key, block)
        yield Progress((index + 1) / (len(update.meshes) + 1), "Creating meshes")
    return pending.meshes


def show_meshes(terrain: SceneTerrain, pending: PendingMeshes, update: Update, material: bpy.types.Material | None) -> None:
    """Show the pending meshes of blocks all at once. The meshes that they replace become spare.

    Raises:
        GeometryError: see `PendingMeshes.check`. Nothing has changed then.
    """
    pending.check()
    blocks = terrain.blocks()
    shown = {block_name(key) for key in pending.names}
    removed = [name for name in blocks if name not in shown] if update.is_complete else [block_name(key) for key in update.removed]
    for key in pending.names:
        mesh, name = pending.claim(key), block_name(key)
        if mesh.materials:
            mesh.materials[0] = material
        else:
            mesh.materials.append(material)
        if name in blocks:
            mark_spare(blocks[name].data, POOL)
            blocks[name].data = mesh
        else:
            terrain.add_child(f"{terrain.name} {name}", mesh)[BLOCK_KEY] = name
    for name in removed:
        if name in blocks:
            mark_spare(blocks[name].data, POOL)
            bpy.data.objects.remove(blocks[name])
    terrain.root[VIEWER_KEY] = update.viewer.tolist()
    if update.left_out:
        terrain.root[LEFT_OUT_KEY] = update.left_out
    elif not terrain.is_complete:
        del terrain.root[LEFT_OUT_KEY]


def show_water(terrain: SceneTerrain, settings: ClipboxSettings) -> None:
    """Add, move or remove the water that the settings ask for, and tell the material of the ground."""
    origin, water, height = terrain.origin, terrain.water, None
    if settings.water:
        height = settings.water_level - float(origin[2])
        half = 0.5 * WATER_SIZE * settings.extent
        corners = np.array([[-half, -half, height], [half, -half, height], [half, half, height], [-half, half, height]])
        mesh = water.data if water is not None else bpy.data.meshes.new(f"{terrain.name} Water")
        mesh.clear_geometry()
        write_triangles(mesh, corners, np.array([[0, 1, 2], [0, 2, 3]]))
        if water is None:
            mesh.materials.append(create_water_material(settings.voxel_size))
            terrain.add_child(mesh.name, mesh)[WATER_KEY] = True
    elif water is not None:
        mesh = water.data
        bpy.data.objects.remove(water)
        bpy.data.meshes.remove(mesh)
    if terrain.material is not None:
        set_water(terrain.material, height)


def add_converted_meshes(scene: bpy.types.Scene, terrain: SceneTerrain, parts: list[ConvertedMesh]) -> tuple[str, ...]:
    """Create objects of converted meshes and of water at the terrain's position, in a new collection. Returns their names.

    A collider is in a collection of its own.
    """
    origin = terrain.origin
    collection, material = link_collection(scene, CONVERTED_NAME), copy_material(terrain.material, terrain.root)
    names = []
    for part in parts:
        mesh, source = bpy.data.meshes.new(part.name), part.mesh
        is_flat = source.normals is None or (terrain.settings.surface == "blocky" and not terrain.settings.smoothing)
        fill_mesh(mesh, source.vertices - origin, source.triangles, None if is_flat else source.normals)
        item = bpy.data.objects.new(part.name, mesh)
        item.matrix_world = terrain.root.matrix_world
        if part.uvs is None:
            link_collection(scene, f"{CONVERTED_NAME} {part.name}").objects.link(item)
            item.display_type, item.hide_render = "WIRE", True
        else:
            collection.objects.link(item)
            write_uvs(mesh.uv_layers.new(name="UVMap", do_init=False), part.uvs)
            mesh.materials.append(material)
        names.append(item.name)
    if terrain.water is not None:
        item = bpy.data.objects.new(f"{CONVERTED_NAME} Water", terrain.water.data.copy())
        item.matrix_world = terrain.root.matrix_world
        collection.objects.link(item)
        names.append(item.name)
    return tuple(names)


def remove(terrain: SceneTerrain) -> None:
    """Remove a terrain with its blocks and, if nothing else is in it, its collection."""
    water = [terrain.water] if terrain.water is not None else []
    remove_terrain(terrain, [*terrain.blocks().values(), *water])
