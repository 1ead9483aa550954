"""Terrain in a scene: an Empty at the root with the settings as custom properties, and one mesh object per block as its children.

All objects of a terrain have the frame of its root, and their vertices are relative to it, so that shared vertices of blocks have exactly
the same position. The terrain position at the root is stored in double precision, and everything else is relative to it.
"""

import json
from dataclasses import asdict, dataclass

import bpy
import mathutils
import numpy as np

from ...core.clipbox.blocks import BlockMesh
from ...core.clipbox.engine import BlockKey, Update
from ...core.clipbox.settings import ClipboxSettings
from ...core.clipbox.to_mesh import ConvertedMesh
from ...core.errors import SettingsError
from ...core.jobs.progress import Progress, Steps
from ..mesh_arrays import write_attribute, write_triangles, write_uvs

# custom properties of the root, of blocks, and of unused meshes that the next change may fill
SETTINGS_KEY, ORIGIN_KEY, VIEWER_KEY = "farfield_clipbox_settings", "farfield_clipbox_origin", "farfield_clipbox_viewer"
BLOCK_KEY, SPARE_KEY = "farfield_clipbox_block", "farfield_clipbox_spare"
TERRAIN_NAME, CONVERTED_NAME = "Clip-Box Terrain", "Terrain Mesh"


@dataclass(frozen=True)
class SceneTerrain:
    """A terrain in the scene. References to objects must not be kept while the user works, so it is identified by the name of its root.

    library_path: the file that it is linked from, None for a terrain of this file. Both can have terrains of the same name.
    """

    name: str
    library_path: str | None = None

    @property
    def root(self) -> bpy.types.Object | None:
        """The Empty at the root, None if it was removed or renamed."""
        item = bpy.data.objects.get((self.name, self.library_path))
        return item if item is not None and SETTINGS_KEY in item else None

    @property
    def read_only_reason(self) -> str:
        """Why its blocks cannot be changed, an empty string if they can."""
        if _is_local(self.root):
            return ""
        kind = "linked from another file" if self.root.override_library is None else "a library override"
        return f'The terrain "{self.name}" is {kind}; make it local (Object > Relations > Make Local > All)'

    @property
    def settings(self) -> ClipboxSettings:
        """The settings that it was created with.

        Raises:
            SettingsError: they cannot be read, for example because a newer version wrote them.
        """
        try:
            return ClipboxSettings(**json.loads(self.root[SETTINGS_KEY]))
        except SettingsError as error:
            raise SettingsError(f'The settings of the terrain "{self.name}" are invalid: {error} Create the terrain again.') from error
        except (ArithmeticError, RecursionError, TypeError, ValueError) as error:
            raise SettingsError(f'The settings of the terrain "{self.name}" cannot be read: {error}. Create the terrain again.') from error

    @property
    def origin(self) -> np.ndarray:
        """Terrain position (3,) float64, scene units, at the root.

        Raises:
            SettingsError: the custom property is missing or has another type.
        """
        return self._read_position(ORIGIN_KEY)

    @property
    def viewer(self) -> np.ndarray:
        """Terrain position (3,) float64 of the viewer around whom the boxes lie.

        Raises:
            SettingsError: the custom property is missing or has another type.
        """
        return self._read_position(VIEWER_KEY)

    def _read_position(self, key: str) -> np.ndarray:
        try:
            position = np.array(self.root[key], np.float64)
        except (KeyError, TypeError, ValueError):
            position = np.empty(0)
        if position.shape != (3,) or not np.isfinite(position).all():
            raise SettingsError(f'The custom property "{key}" of the terrain "{self.name}" is invalid; create the terrain again.')
        return position

    def viewer_position(self, matrix: mathutils.Matrix) -> np.ndarray:
        """Return the terrain position (3,) float64 of a viewer with the given matrix in world space."""
        inverse = np.array(self.root.matrix_world.inverted_safe(), np.float64)
        return inverse[:3, :3] @ np.array(matrix.translation, np.float64) + inverse[:3, 3] + self.origin

    def blocks(self) -> dict[str, bpy.types.Object]:
        """Return its block objects by `block_name`."""
        return {str(child[BLOCK_KEY]): child for child in self.root.children if BLOCK_KEY in child and child.type == "MESH"}

    @property
    def material(self) -> bpy.types.Material | None:
        """The material of its blocks, which the user may have replaced."""
        for block in self.blocks().values():
            if block.data.materials:
                return block.data.materials[0]
        return None


def scene_terrains(scene: bpy.types.Scene) -> list[SceneTerrain]:
    """Return all terrains of a scene, linked ones included."""
    return [_terrain_of_root(item) for item in scene.objects if SETTINGS_KEY in item]


def terrain_of_object(item: bpy.types.Object | None) -> SceneTerrain | None:
    """Return the terrain that an object is the root or a block of."""
    while item is not None:
        if SETTINGS_KEY in item:
            return _terrain_of_root(item)
        item = item.parent
    return None


def _terrain_of_root(root: bpy.types.Object) -> SceneTerrain:
    return SceneTerrain(root.name, root.library.filepath if root.library is not None else None)


def _is_local(data_block: bpy.types.ID) -> bool:
    """Return whether a data-block belongs to this file. Changes to others crash Blender, or are lost when the file is opened again."""
    return data_block.is_editable and data_block.override_library is None


def create_root(scene: bpy.types.Scene, settings: ClipboxSettings, viewer: np.ndarray, origin: np.ndarray) -> SceneTerrain:
    """Create the Empty of a new terrain in a new collection."""
    collection = bpy.data.collections.new(TERRAIN_NAME)
    scene.collection.children.link(collection)
    root = bpy.data.objects.new(TERRAIN_NAME, None)
    root.empty_display_size = settings.voxel_size * settings.resolution / 2
    collection.objects.link(root)
    root[ORIGIN_KEY], root[VIEWER_KEY] = origin.tolist(), viewer.tolist()
    store_settings(root, settings)
    return SceneTerrain(root.name)


def select(view_layer: bpy.types.ViewLayer, terrain: SceneTerrain) -> None:
    """Select the root of a terrain, make it active and deselect everything else."""
    for item in view_layer.objects.selected:
        item.select_set(False, view_layer=view_layer)
    terrain.root.select_set(True, view_layer=view_layer)
    view_layer.objects.active = terrain.root


def store_settings(root: bpy.types.Object, settings: ClipboxSettings) -> None:
    """Store the settings in the root."""
    root[SETTINGS_KEY] = json.dumps(asdict(settings))


def block_name(key: BlockKey) -> str:
    """Return the name of a block within its terrain: level and index."""
    level, block_index = key
    return f"{level} {' '.join(str(coordinate) for coordinate in block_index)}"


class PendingMeshes:
    """Meshes without users that are filled with the surfaces of blocks and shown later. `names` has the mesh names by block.

    Meshes that are never shown become spare meshes, which are filled first.
    """

    def __init__(self, origin: np.ndarray, settings: ClipboxSettings) -> None:
        """origin: (3,) float64, terrain position that vertices are relative to."""
        self.names: dict[BlockKey, str] = {}
        self._origin = origin
        self._is_flat = settings.surface == "blocky" and not settings.smoothing
        self._spare = [mesh.name for mesh in bpy.data.meshes if mesh.users == 0 and SPARE_KEY in mesh and _is_local(mesh)]

    def fill(self, key: BlockKey, block: BlockMesh) -> None:
        """Fill a mesh with the surface of a block."""
        mesh = bpy.data.meshes.get((self._spare.pop(), None)) if self._spare else None
        mesh = mesh or bpy.data.meshes.new("Clip-Box")
        mesh[SPARE_KEY] = True
        fill_mesh(mesh, block.vertices - self._origin, None if self._is_flat else block.normals, block.triangles)
        self.names[key] = mesh.name


def fill_meshes(update: Update, origin: np.ndarray, settings: ClipboxSettings) -> Steps[dict[BlockKey, str]]:
    """Fill meshes with all surfaces of an update, one per step. Returns their names by block."""
    pending = PendingMeshes(origin, settings)
    for index, (key, block) in enumerate(update.meshes.items()):
        pending.fill(key, block)
        yield Progress((index + 1) / (len(update.meshes) + 1), "Creating meshes")
    return pending.names


def show_meshes(terrain: SceneTerrain, mesh_names: dict[BlockKey, str], update: Update, material: bpy.types.Material | None) -> None:
    """Show pending meshes, given by name, all at once. The meshes that they replace become spare."""
    root, blocks = terrain.root, terrain.blocks()
    shown = {block_name(key) for key in mesh_names}
    removed = [name for name in blocks if name not in shown] if update.is_complete else [block_name(key) for key in update.removed]
    for key, mesh_name in mesh_names.items():
        mesh, name = bpy.data.meshes[mesh_name, None], block_name(key)
        del mesh[SPARE_KEY]
        if mesh.materials:
            mesh.materials[0] = material
        else:
            mesh.materials.append(material)
        if name in blocks:
            _mark_spare(blocks[name].data)
            blocks[name].data = mesh
        else:
            _add_block(root, name, mesh)
    for name in removed:
        if name in blocks:
            _mark_spare(blocks[name].data)
            bpy.data.objects.remove(blocks[name])
    root[VIEWER_KEY] = update.viewer.tolist()


def _mark_spare(mesh: bpy.types.Mesh) -> None:
    """Let the next change fill a mesh that is shown no more. Linked meshes are left alone."""
    if _is_local(mesh):
        mesh[SPARE_KEY] = True


def _add_block(root: bpy.types.Object, name: str, mesh: bpy.types.Mesh) -> None:
    block = bpy.data.objects.new(f"{root.name} {name}", mesh)
    block[BLOCK_KEY] = name
    block.parent = root
    collections = [collection for collection in root.users_collection if _is_local(collection)]
    for collection in collections or [scene.collection for scene in root.users_scene]:
        collection.objects.link(block)


def add_converted_meshes(scene: bpy.types.Scene, terrain: SceneTerrain, parts: list[ConvertedMesh]) -> tuple[str, ...]:
    """Create objects of converted meshes at the terrain's position, in a new collection. Returns their names."""
    origin = terrain.origin
    collection = bpy.data.collections.new(CONVERTED_NAME)
    scene.collection.children.link(collection)
    material = terrain.material.copy() if terrain.material is not None else None
    for node in material.node_tree.nodes if material is not None and material.node_tree is not None else ():
        if node.type == "TEX_COORD" and node.object == terrain.root:
            node.object = None  # the new objects have the frame of the root themselves
    names = []
    for part in parts:
        mesh, source = bpy.data.meshes.new(part.name), part.mesh
        is_flat = source.normals is None or (terrain.settings.surface == "blocky" and not terrain.settings.smoothing)
        fill_mesh(mesh, source.vertices - origin, None if is_flat else source.normals, source.triangles)
        item = bpy.data.objects.new(part.name, mesh)
        item.matrix_world = terrain.root.matrix_world
        collection.objects.link(item)
        if part.uvs is None:
            item.display_type, item.hide_render = "WIRE", True
        else:
            write_uvs(mesh.uv_layers.new(name="UVMap", do_init=False), part.uvs)
            mesh.materials.append(material)
        names.append(item.name)
    return tuple(names)


def remove(terrain: SceneTerrain) -> None:
    """Remove a terrain with its blocks and, if nothing else is in it, its collection."""
    root = terrain.root
    collections, blocks = root.users_collection, list(terrain.blocks().values())
    meshes = [block.data for block in blocks]
    bpy.data.batch_remove([*blocks, root])
    bpy.data.batch_remove([mesh for mesh in meshes if mesh.users == 0 and _is_local(mesh)])
    for collection in collections:
        if not collection.all_objects and not collection.children and collection in bpy.data.collections.values():
            bpy.data.collections.remove(collection)


def fill_mesh(mesh: bpy.types.Mesh, vertices: np.ndarray, normals: np.ndarray | None, triangles: np.ndarray) -> None:
    """Replace the geometry of a mesh: vertices (V, 3), triangles (T, 3), and normals (V, 3), or None for flat shading."""
    write_triangles(mesh, vertices, triangles)
    if normals is None:
        mesh.shade_flat()
        return
    write_attribute(mesh, "custom_normal", "POINT", normals)
