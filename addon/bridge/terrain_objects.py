"""Terrain in nested boxes as Blender objects: an empty at the root that knows the settings, and a mesh object a block under it.

All objects of a terrain have the frame of its root and hold their vertices in it, so that vertices which blocks share lie in the very same
place. The place of the terrain that lies at the root is kept in double precision, and everything else is measured from there.
"""

import json
from dataclasses import asdict, dataclass

import bpy
import mathutils
import numpy as np

from ..core.clipbox.blocks import BlockMesh
from ..core.clipbox.freezing import Frozen
from ..core.clipbox.settings import ClipboxSettings
from ..core.clipbox.terrain import Key, Update
from ..core.errors import SettingsError
from ..core.progress import Progress, Steps

SETTINGS, ORIGIN, VIEWER, BLOCK = "farfield_clipbox", "farfield_clipbox_origin", "farfield_clipbox_viewer", "farfield_clipbox_block"
SPARE = "farfield_clipbox_spare"  # of meshes that the next change may fill


@dataclass(frozen=True)
class StandingTerrain:
    """A terrain that stands in the file, by the name of its root: Blender's objects may not be kept while the user works."""

    name: str

    @property
    def root(self) -> bpy.types.Object | None:
        """The empty at its root, None when it has gone."""
        found = bpy.data.objects.get(self.name)
        return found if found is not None and SETTINGS in found else None

    @property
    def settings(self) -> ClipboxSettings:
        """The settings that it was made with.

        Raises:
            SettingsError: when they cannot be read, as in the file of a newer version.
        """
        try:
            return ClipboxSettings(**json.loads(self.root[SETTINGS]))
        except (TypeError, ValueError) as error:
            raise SettingsError(f'The settings of the terrain "{self.name}" cannot be read: {error}. Make it anew.') from error

    @property
    def origin(self) -> np.ndarray:
        """The place of the terrain, (3,) float64 scene units, that lies at the root."""
        return np.array(self.root[ORIGIN], np.float64)

    @property
    def viewer(self) -> np.ndarray:
        """Where in the terrain, (3,) float64, the viewer was that the boxes lie about."""
        return np.array(self.root[VIEWER], np.float64)

    def seen_from(self, matrix: mathutils.Matrix) -> np.ndarray:
        """The place in the terrain (3,) float64 of a viewer whose matrix in world space is given."""
        inverse = np.array(self.root.matrix_world.inverted_safe(), np.float64)
        return inverse[:3, :3] @ np.array(matrix.translation, np.float64) + inverse[:3, 3] + self.origin

    def blocks(self) -> dict[str, bpy.types.Object]:
        """Its blocks by `block_name`."""
        return {child[BLOCK]: child for child in self.root.children if BLOCK in child}

    @property
    def material(self) -> bpy.types.Material | None:
        """What its blocks are shown with: what the user gave to one of them, if there is one."""
        for block in self.blocks().values():
            if block.data.materials:
                return block.data.materials[0]
        return None


def standing_terrains(scene: bpy.types.Scene) -> list[StandingTerrain]:
    """All terrains of a scene."""
    return [StandingTerrain(item.name) for item in scene.objects if SETTINGS in item]


def terrain_at(item: bpy.types.Object | None) -> StandingTerrain | None:
    """The terrain that an object is the root of, or a block of."""
    while item is not None:
        if SETTINGS in item:
            return StandingTerrain(item.name)
        item = item.parent
    return None


def new_root(scene: bpy.types.Scene, settings: ClipboxSettings, viewer: np.ndarray, origin: np.ndarray) -> StandingTerrain:
    """An empty for a new terrain, in a collection of its own."""
    collection = bpy.data.collections.new("Clip-Box Terrain")
    scene.collection.children.link(collection)
    root = bpy.data.objects.new("Clip-Box Terrain", None)
    root.empty_display_size = settings.voxel * settings.resolution / 2
    collection.objects.link(root)
    root[ORIGIN], root[VIEWER] = origin.tolist(), viewer.tolist()
    keep_settings(root, settings)
    return StandingTerrain(root.name)


def choose(view_layer: bpy.types.ViewLayer, standing: StandingTerrain) -> None:
    """Select the root of a terrain, and nothing else."""
    for item in view_layer.objects.selected:
        item.select_set(False, view_layer=view_layer)
    standing.root.select_set(True, view_layer=view_layer)
    view_layer.objects.active = standing.root


def keep_settings(root: bpy.types.Object, settings: ClipboxSettings) -> None:
    """Let the root know the settings."""
    root[SETTINGS] = json.dumps(asdict(settings))


def block_name(key: Key) -> str:
    """A block's name within its terrain: level and place."""
    level, place = key
    return f"{level} {' '.join(str(each) for each in place)}"


class HiddenMeshes:
    """Meshes that nobody sees yet, filled with the surfaces of blocks: `names` by block. What is not put in place is spare."""

    def __init__(self, origin: np.ndarray, settings: ClipboxSettings) -> None:
        """origin: (3,) float64, the place of the terrain that vertices are counted from."""
        self.names: dict[Key, str] = {}
        self._origin = origin
        self._flat = settings.surface == "blocky" and not settings.smoothing
        self._spare = [mesh.name for mesh in bpy.data.meshes if mesh.users == 0 and SPARE in mesh]

    def fill(self, key: Key, block: BlockMesh) -> None:
        """Fill one."""
        mesh = bpy.data.meshes.get(self._spare.pop()) if self._spare else None
        mesh = mesh or bpy.data.meshes.new("Clip-Box")
        mesh[SPARE] = True
        fill_mesh(mesh, block.vertices - self._origin, None if self._flat else block.normals, block.triangles)
        self.names[key] = mesh.name


def filled(update: Update, origin: np.ndarray, settings: ClipboxSettings) -> Steps[dict[Key, str]]:
    """Meshes with all surfaces of an update, one a step: their names by block."""
    hidden = HiddenMeshes(origin, settings)
    for number, (key, block) in enumerate(update.meshes.items()):
        hidden.fill(key, block)
        yield Progress((number + 1) / (len(update.meshes) + 1), "Showing")
    return hidden.names


def put_in_place(terrain: StandingTerrain, meshes: dict[Key, str], update: Update, material: bpy.types.Material | None) -> None:
    """Show hidden meshes, given by their names, all at once. The meshes that were shown before become spare ones."""
    root, blocks = terrain.root, terrain.blocks()
    kept = {block_name(key) for key in meshes}
    gone = [name for name in blocks if name not in kept] if update.whole else [block_name(key) for key in update.gone]
    for key, mesh_name in meshes.items():
        mesh, name = bpy.data.meshes[mesh_name], block_name(key)
        del mesh[SPARE]
        if mesh.materials:
            mesh.materials[0] = material
        else:
            mesh.materials.append(material)
        if name in blocks:
            blocks[name].data[SPARE] = True
            blocks[name].data = mesh
        else:
            _add_block(root, name, mesh)
    for name in gone:
        if name in blocks:
            blocks[name].data[SPARE] = True
            bpy.data.objects.remove(blocks[name])
    root[VIEWER] = update.viewer.tolist()


def _add_block(root: bpy.types.Object, name: str, mesh: bpy.types.Mesh) -> None:
    block = bpy.data.objects.new(f"{root.name} {name}", mesh)
    block[BLOCK] = name
    block.parent = root
    for collection in root.users_collection:
        collection.objects.link(block)


def add_frozen(scene: bpy.types.Scene, standing: StandingTerrain, parts: list[Frozen]) -> tuple[str, ...]:
    """Plain objects of frozen meshes where the terrain stands, in a collection of their own: their names."""
    collection = bpy.data.collections.new("Frozen Terrain")
    scene.collection.children.link(collection)
    material = standing.material.copy() if standing.material is not None else None
    for node in material.node_tree.nodes if material is not None and material.node_tree is not None else ():
        if node.type == "TEX_COORD" and node.object == standing.root:
            node.object = None  # a frozen object has the frame of the root itself
    made = []
    for part in parts:
        mesh, surface = bpy.data.meshes.new(part.name), part.surface
        flat = surface.normals is None or (standing.settings.surface == "blocky" and not standing.settings.smoothing)
        fill_mesh(mesh, surface.vertices - standing.origin, None if flat else surface.normals, surface.triangles)
        item = bpy.data.objects.new(part.name, mesh)
        item.matrix_world = standing.root.matrix_world
        collection.objects.link(item)
        if part.uvs is None:
            item.display_type, item.hide_render = "WIRE", True
        else:
            mesh.uv_layers.new(name="UVMap", do_init=False).uv.foreach_set("vector", part.uvs.ravel())
            mesh.materials.append(material)
        made.append(item.name)
    return tuple(made)


def remove(standing: StandingTerrain) -> None:
    """Take a terrain away with its blocks and, where nothing else is in it, its collection."""
    root = standing.root
    collections, blocks = root.users_collection, list(standing.blocks().values())
    meshes = [block.data for block in blocks]
    bpy.data.batch_remove([*blocks, root])
    bpy.data.batch_remove([mesh for mesh in meshes if mesh.users == 0])
    for collection in collections:
        if not collection.all_objects and not collection.children and collection in bpy.data.collections.values():
            bpy.data.collections.remove(collection)


def fill_mesh(mesh: bpy.types.Mesh, vertices: np.ndarray, normals: np.ndarray | None, triangles: np.ndarray) -> None:
    """Give a mesh new geometry: vertices (V, 3), triangles (T, 3), and normals (V, 3), or flat faces without."""
    mesh.clear_geometry()
    mesh.vertices.add(len(vertices))
    mesh.attributes["position"].data.foreach_set("vector", vertices.astype(np.float32).ravel())
    mesh.loops.add(triangles.size)
    mesh.attributes[".corner_vert"].data.foreach_set("value", triangles.astype(np.int32).ravel())
    mesh.polygons.add(len(triangles))
    mesh.polygons.foreach_set("loop_start", np.arange(0, triangles.size, 3, dtype=np.int32))
    mesh.update(calc_edges=True)
    if normals is None:
        mesh.shade_flat()
        return
    attribute = mesh.attributes.get("custom_normal") or mesh.attributes.new("custom_normal", "FLOAT_VECTOR", "POINT")
    attribute.data.foreach_set("vector", normals.astype(np.float32).ravel())
