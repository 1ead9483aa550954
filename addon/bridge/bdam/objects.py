"""Large terrain in a scene: an Empty at the root, and one mesh object per tile as its children.

A tile's vertices are relative to its object, whose location is a position near the center of the tile that single precision represents
exactly, like the vertices: common vertices of two tiles have exactly the same position unless the root is rotated or scaled.

The root has the custom properties of all terrains, `farfield_bdam_settings` and `farfield_bdam_origin`, and those below.
"""

import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import ClassVar

import bpy
import numpy as np

from ...core.bdam.settings import ViewSettings
from ...core.bdam.view.engine import BdamEngine, Figures, TileBlock, Update
from ...core.bdam.view.tile_maps import ShownMaps
from ...core.bdam.view.tiles import TileKey, TileMesh
from ...core.errors import FileError
from ...core.files.file_access import is_folder
from ...core.json_values import parse_json
from ..geometry.mesh_arrays import write_attribute, write_triangles
from ..geometry.mesh_pool import PendingMeshes, mark_spare
from ..terrain_roots import TerrainRoot, remove_terrain
from .materials import LEVEL_ATTRIBUTE, MATERIAL_KEY, TileMaterials, create_material, mark_used, remove_unused

STORE_KEY = "farfield_bdam_store"  # custom property of the root: the folder of the store
FIGURES_KEY, WARNINGS_KEY = "farfield_bdam_figures", "farfield_bdam_warnings"  # custom properties of the root: the last change as JSON text
TILE_KEY = "farfield_bdam_tile"  # custom property of the objects of tiles
MATERIAL_NAMES = "farfield_bdam_material_"  # custom properties of the root, followed by a shading: the name of the material
TERRAIN_NAME = "Large Terrain"
POOL = "bdam"
BLEND_PREFIX = "//"
DISPLAY_FRACTION = 0.05  # size of the Empty relative to that of the terrain


@dataclass(frozen=True)
class SceneTerrain(TerrainRoot):
    """A terrain in the scene."""

    tool: ClassVar[str] = "bdam"
    label: ClassVar[str] = "large terrain"
    settings_type = ViewSettings

    @property
    def folder(self) -> Path:
        """The folder of its store.

        Raises:
            FileError: the path is relative to a .blend file that was never saved, or there is no such folder.
        """
        return resolve_folder(str(self.root.get(STORE_KEY, "")), self.root.library, f'The store of the terrain "{self.name}"')

    def input_paths(self) -> list[Path]:
        """Return the folder of its store. Raises FileError."""
        return [self.folder]

    @property
    def figures(self) -> Figures | None:
        """Figures of what is shown, None if they are unknown."""
        try:
            return Figures(**parse_json(self.root[FIGURES_KEY]))
        except (KeyError, TypeError, ValueError):
            return None

    @property
    def warnings(self) -> tuple[str, ...]:
        """Sentences about damaged parts of the store that are not shown."""
        try:
            return tuple(str(sentence) for sentence in parse_json(self.root[WARNINGS_KEY]))
        except (KeyError, TypeError, ValueError):
            return ()

    def tiles(self) -> dict[str, bpy.types.Object]:
        """Return its objects by `tile_name`."""
        return {str(child[TILE_KEY]): child for child in self.root.children if TILE_KEY in child and child.type == "MESH"}

    def ensure_material(self, shading: str, engine: BdamEngine) -> bpy.types.Material:
        """Return its material for a shading, for "texture" that of tiles without one; create it if there is none."""
        shading = "slope" if shading == "texture" else shading
        kind = f"{shading} curved" if engine.settings.curvature and shading != "level" else shading
        key = f"{MATERIAL_NAMES}{kind}"
        material = bpy.data.materials.get((str(self.root.get(key, "")), None)) or self._shown_material(kind)
        if material is None or material.get(MATERIAL_KEY) != kind:
            exaggeration = engine.settings.exaggeration if engine.settings.curvature else 0.0
            name = f"{self.name} {shading.title()}"
            material = create_material(name, shading, self.root, engine.heights, engine.store.header.cell_size, exaggeration)
            material[MATERIAL_KEY] = kind
        self.root[key] = material.name
        return material

    def _shown_material(self, kind: str) -> bpy.types.Material | None:
        """Return the material of a kind that a tile has, which the user may have renamed; None if there is none."""
        materials = [tile.data.materials[0] for tile in self.tiles().values() if tile.data.materials]
        return next((item for item in materials if item is not None and item.get(MATERIAL_KEY) == kind), None)


def resolve_folder(path: str, library: bpy.types.Library | None, subject: str) -> Path:
    """Return the folder of a store from a path that may be relative to a .blend file ("//").

    library: the file that the path is linked from, None for this file. subject: begins the sentence of an error.

    Raises:
        FileError: the path is relative to a .blend file that was never saved, or there is no such folder.
    """
    if path.startswith(BLEND_PREFIX):
        if library is None and not bpy.data.filepath:
            raise FileError(f'{subject} is at "{path}", relative to a file that was never saved; save the file or choose the folder again.')
        path = bpy.path.abspath(path, library=library)
    folder = Path(path).absolute()
    if not path or not is_folder(folder):
        raise FileError(f'{subject} is missing: there is no folder "{folder if path else ""}"; set Store to where it is now.')
    return folder


def store_path(folder: str) -> str:
    """Return the path to store for a folder as a user has given it: relative to the .blend file if it was ("//"), else absolute."""
    return folder if folder.startswith(BLEND_PREFIX) else str(Path(folder).absolute())


def create_root(scene: bpy.types.Scene, path: str, engine: BdamEngine) -> SceneTerrain:
    """Create the Empty of a new terrain in a new collection. path: of the store, see `store_path`."""
    low, high = engine.bounds
    terrain = SceneTerrain.create(scene, TERRAIN_NAME, np.zeros(3), engine.settings, DISPLAY_FRACTION * float((high - low)[:2].max()))
    terrain.root[STORE_KEY] = path
    terrain.root.id_properties_ui(STORE_KEY).update(subtype="DIR_PATH", description="Folder of the store of this terrain")
    return terrain


def tile_name(key: TileKey) -> str:
    """Return the name of a tile within its terrain: level, column and row of its square."""
    return " ".join(str(number) for number in key)


class TerrainChange:
    """One move of one terrain: fills meshes, then shows them."""

    def __init__(self, terrain: SceneTerrain, engine: BdamEngine) -> None:
        """terrain: may be a terrain that is created later, see `show_in`."""
        self._terrain, self._engine = terrain, engine
        self._meshes = PendingMeshes(POOL, TERRAIN_NAME)
        self._locations: dict[TileKey, np.ndarray] = {}
        self._maps: dict[int, ShownMaps] = {}

    def fill(self, key: TileKey, block: TileBlock) -> Iterator[None]:
        """Fill the mesh of a tile, in several steps."""
        mesh, source = self._meshes.take(key), block.mesh
        self._locations[key] = source.location
        yield from fill_tile_mesh(mesh, source)
        if block.maps is not None:
            self._maps[block.maps[0]] = block.maps[1]

    def check_pending(self) -> None:
        """Check that undo has not changed the filled meshes; see `PendingMeshes.check`."""
        self._meshes.check()

    def show(self, update: Update) -> Iterator[None]:
        """Show all meshes at once. The meshes that they replace become spare."""
        return self.show_in(self._terrain, update)

    def show_in(self, terrain: SceneTerrain, update: Update) -> Iterator[None]:
        """Show all meshes in a terrain; see `show`.

        Raises:
            GeometryError: see `PendingMeshes.check`. Nothing has changed then.
        """
        self._terrain = terrain
        origin, shading = terrain.origin, self._engine.settings.shading
        objects = terrain.tiles()
        new = {tile_name(key): key for key in self._meshes.names}
        wanted = {tile_name(key) for key in update.tiles}
        materials = yield from self._ensure_materials(update, shading)
        self.check_pending()
        for name, key in new.items():
            mesh = self._meshes.claim(key)
            if name in objects:
                _release(objects[name].data)
                objects[name].data = mesh
            else:
                objects[name] = terrain.add_child(f"{terrain.name} {name}", mesh)
                objects[name][TILE_KEY] = name
            objects[name].location = (self._locations[key] - origin).tolist()
        for key, material in materials.items():
            name = tile_name(key)
            if name in objects:
                _assign(objects[name].data, material)
        removed = [item for name, item in objects.items() if name not in wanted]
        for item in removed:
            _release(item.data)
        bpy.data.batch_remove(removed)
        mark_used([material for key, material in materials.items() if update.tiles[key] is not None])
        remove_unused()
        terrain.root[FIGURES_KEY], terrain.root[WARNINGS_KEY] = json.dumps(asdict(update.figures)), json.dumps(update.warnings)
        if not wanted <= objects.keys():
            self._engine.invalidate()  # the user has deleted tiles; the next move restores them

    def _ensure_materials(self, update: Update, shading: str) -> Iterator[None]:
        """Return the material of every tile, in several steps; tiles without texture are shaded by slope."""
        general = self._terrain.ensure_material(shading, self._engine)
        tile_materials = TileMaterials(self._engine, self._terrain.name)
        numbers = {number for number in update.tiles.values() if number is not None}
        for number in sorted(numbers - tile_materials.find_all(numbers).keys()):
            maps = self._maps.get(number) or self._engine.read_maps(number)[0]
            tile_materials.create(number, self._terrain.name, maps, general, self._terrain.root)
            yield
        by_number = tile_materials.find_all(numbers)  # Undo may have removed some between two steps.
        return {key: by_number.get(number, general) for key, number in update.tiles.items()}


def fill_tile_mesh(mesh: bpy.types.Mesh, source: TileMesh) -> Iterator[None]:
    """Replace the geometry of a mesh by that of a tile, in several steps."""
    write_triangles(mesh, source.vertices, source.triangles)
    if not len(source.triangles):
        return
    yield
    write_attribute(mesh, "custom_normal", "POINT", source.normals)
    mesh.attributes.new(LEVEL_ATTRIBUTE, "INT", "FACE").data.foreach_set("value", source.levels.astype(np.int32))
    if source.uvs is not None:
        write_attribute(mesh, "UVMap", "CORNER", source.uvs[source.triangles])


def remove(terrain: SceneTerrain) -> None:
    """Remove a terrain with its tiles, its materials and, if nothing else is in it, its collection."""
    root = terrain.root
    tiles = list(terrain.tiles().values())
    names = {str(root[key]) for key in list(root.keys()) if key.startswith(MATERIAL_NAMES)}
    names |= {material.name for tile in tiles for material in tile.data.materials if material is not None}
    for tile in tiles:
        tile.data.materials.clear()
    remove_terrain(terrain, tiles)
    own = [bpy.data.materials.get((name, None)) for name in names]
    bpy.data.batch_remove([item for item in own if item is not None and item.users == 0 and MATERIAL_KEY in item])
    remove_unused(0, len(bpy.data.materials))


def _assign(mesh: bpy.types.Mesh, material: bpy.types.Material) -> None:
    """Set the only material of a mesh, if it has another one."""
    if not mesh.materials:
        mesh.materials.append(material)
    elif mesh.materials[0] != material:
        mesh.materials[0] = material


def _release(mesh: bpy.types.Mesh) -> None:
    """Let the next change fill a mesh that is no longer shown, and let its material go."""
    mesh.materials.clear()
    mark_spare(mesh, POOL)
