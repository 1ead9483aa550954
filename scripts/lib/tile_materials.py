"""UDIM tiles for formats without them: a material per tile, and UVs within 0..1."""

import bpy
import numpy as np

from lib import environment

environment.import_farfield()

from farfield.addon.bridge.geometry.mesh_arrays import read_uvs, read_values, write_uvs
from farfield.addon.bridge.imaging.images import load_image, tile_paths
from farfield.addon.core.photos.texels.pages import FIRST_TILE, TILE_COLUMNS


def split_tiles(objects: list[bpy.types.Object]) -> None:
    """Replace each material with a tiled image by one material per tile, which reads the file of the tile, and move the UVs of its faces
    into the square from 0 to 1.

    A face belongs to the tile with the mean of its corners.
    """
    for item in {item.data: item for item in objects}.values():
        mesh = item.data
        layer = next(layer for layer in mesh.uv_layers if layer.active_render)
        uvs, counts = read_uvs(layer), read_values(mesh.polygons, "loop_total", dtype=np.int32)
        starts = read_values(mesh.polygons, "loop_start", dtype=np.int32)
        cells = np.floor(np.add.reduceat(uvs.astype(np.float64), starts, axis=0) / counts[:, None]).astype(np.int64)
        tiles = FIRST_TILE + cells[:, 0] + TILE_COLUMNS * cells[:, 1]
        indices = read_values(mesh.polygons, "material_index", dtype=np.int32)
        used = np.clip(indices, 0, len(item.material_slots) - 1)
        for slot_index, slot in enumerate(list(item.material_slots)):
            material = slot.material
            image = None if material is None else _find_tiled_image(material)
            if image is None:
                continue
            for order, (tile, path) in enumerate(zip(image.tiles, tile_paths(image), strict=True)):
                own = _copy_for_tile(material, image, load_image(path), tile.number)
                faces = np.flatnonzero((used == slot_index) & (tiles == tile.number))
                if order == 0:
                    item.material_slots[slot_index].material = own
                else:
                    mesh.materials.append(own)
                    indices[faces] = len(mesh.materials) - 1
                loops = np.repeat(np.isin(np.arange(len(counts)), faces), counts)
                uvs[loops] -= np.repeat(cells, counts, axis=0)[loops]
        mesh.polygons.foreach_set("material_index", indices)
        write_uvs(layer, uvs)


def _find_tiled_image(material: bpy.types.Material) -> bpy.types.Image | None:
    images = [node.image for node in material.node_tree.nodes if node.type == "TEX_IMAGE" and node.image is not None]
    return next((image for image in images if image.source == "TILED"), None)


def _copy_for_tile(material: bpy.types.Material, tiled: bpy.types.Image, image: bpy.types.Image, tile: int) -> bpy.types.Material:
    copy = material.copy()
    copy.name = f"{material.name}.{tile}"
    for node in copy.node_tree.nodes:
        if node.type == "TEX_IMAGE" and node.image == tiled:
            node.image = image
    return copy
