"""Chains of levels: collections in no scene, which geometry nodes instance where they show."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import bpy
import mathutils
import numpy as np

from ...core.json_values import parse_json
from .. import lod_crossfade
from ..blender import remove_unused_data
from ..imaging.images import find_images
from ..lod_sets import KIND

CHAIN = "distance_level"  # The KIND of collections and objects of levels.
HOST = "distance_host"  # The KIND of objects that show collection instances.
FIGURES = "farfield_distance"  # Property of the collection of the first level: JSON, the fields of `Chain`.
NEXT_LEVEL = "farfield_next_level"  # Property of the collection of a level: that of the next one.
SUFFIX = "Fading"  # Of the names of objects and materials that cross-fade.
FADING = "farfield_fading_level"  # Property of the collection of a level: that of the same level with materials that cross-fade.


@dataclass(frozen=True)
class NewLevel:
    """A level to be added. objects: with their matrices in the space of the asset. pixel_size: above which it shows, in units of the asset.
    triangles: their number."""

    objects: list[tuple[bpy.types.Object, mathutils.Matrix]]
    pixel_size: float
    triangles: int


@dataclass(frozen=True)
class Chain:
    """The levels of an asset. Lengths are in units of the asset.

    Attributes:
        name: of the asset.
        fingerprint: of everything that it was made of.
        collections: of the levels, finest first.
        fading: of the same levels with materials that cross-fade; empty without a fade range. Only places that fade show them, since such
            materials are transparent to shadow rays and take longer.
        pixel_sizes: of a level, above which it shows.
        triangles: of each level.
        low: lowest corner (3,) of the asset.
        high: highest corner (3,) of the asset.
    """

    name: str
    fingerprint: str
    collections: list[bpy.types.Collection]
    fading: list[bpy.types.Collection]
    pixel_sizes: list[float]
    triangles: list[int]
    low: np.ndarray
    high: np.ndarray

    @property
    def all_collections(self) -> list[bpy.types.Collection]:
        """All collections of levels."""
        return [*self.collections, *self.fading]

    @property
    def objects(self) -> list[bpy.types.Object]:
        """The objects of all levels."""
        return [item for collection in self.all_collections for item in collection.objects]


def create_chain(name: str, fingerprint: str, levels: Sequence[NewLevel], box: tuple[np.ndarray, np.ndarray], fade_range: float) -> Chain:
    """Create the collections of levels, whose objects are in no other collection. With a `fade_range` above 0 they can cross-fade.

    box: lowest and highest corner of the asset.
    """
    collections = [_add_collection(f"{name} Distance {number}", level.objects) for number, level in enumerate(levels)]
    fading = []
    if fade_range and len(levels) > 1:
        copies: dict[bpy.types.Material, bpy.types.Material] = {}
        limits = [lod_crossfade.MIN_PIXEL, *(level.pixel_size for level in levels[1:]), lod_crossfade.MAX_PIXEL]
        for number, level in enumerate(levels):
            objects = [(_copy_with_materials(item, copies), matrix) for item, matrix in level.objects]
            fading.append(_add_collection(f"{name} Distance {number} {SUFFIX}", objects))
            for item, _ in objects:
                lod_crossfade.set_limits(item, *limits[number : number + 2], fade_range)
            collections[number][FADING] = fading[number]
    for collection, following in pairwise(collections):
        collection[NEXT_LEVEL] = following
    sizes, triangles = [level.pixel_size for level in levels], [level.triangles for level in levels]
    figures: dict[str, Any] = {"name": name, "fingerprint": fingerprint, "pixel_sizes": sizes, "triangles": triangles}
    collections[0][FIGURES] = json.dumps({**figures, "low": box[0].tolist(), "high": box[1].tolist()})
    collections[0].use_fake_user = True  # Until something shows it.
    return Chain(name, fingerprint, collections, fading, sizes, triangles, *box)


def _add_collection(name: str, objects: Sequence[tuple[bpy.types.Object, mathutils.Matrix]]) -> bpy.types.Collection:
    collection = bpy.data.collections.new(name)
    collection[KIND] = CHAIN
    for item, matrix in objects:
        item.matrix_world = matrix
        item.hide_viewport = item.hide_render = False
        item[KIND] = CHAIN
        collection.objects.link(item)
    return collection


def _copy_with_materials(item: bpy.types.Object, copies: dict[bpy.types.Material, bpy.types.Material]) -> bpy.types.Object:
    """Return a copy of an object with the same mesh, and with copies of its materials, which are made once."""
    fading = item.copy()
    fading.name = f"{item.name} {SUFFIX}"
    for slot in fading.material_slots:
        material = slot.material
        if material is not None:
            if material not in copies:
                copies[material] = material.copy()
                copies[material].name = f"{material.name} {SUFFIX}"
            slot.link, slot.material = "OBJECT", copies[material]
    return fading


def read_chains() -> list[Chain]:
    """Return all complete chains of the file."""
    found = (_read_chain(collection) for collection in bpy.data.collections if FIGURES in collection and collection.library is None)
    return [chain for chain in found if chain is not None]


def _read_chain(first: bpy.types.Collection) -> Chain | None:
    """Return the chain that begins with a collection, None if it is damaged."""
    collections = [first]
    while isinstance(following := collections[-1].get(NEXT_LEVEL), bpy.types.Collection) and following not in collections:
        collections.append(following)
    fading = [collection[FADING] for collection in collections if isinstance(collection.get(FADING), bpy.types.Collection)]
    try:
        figures = parse_json(str(first[FIGURES]))
        low, high = (np.array(figures[name], np.float64).reshape(3) for name in ("low", "high"))
        sizes, triangles = [float(size) for size in figures["pixel_sizes"]], [int(count) for count in figures["triangles"]]
        chain = Chain(str(figures["name"]), str(figures["fingerprint"]), collections, fading, sizes, triangles, low, high)
    except (KeyError, TypeError, ValueError):
        return None
    is_complete = len(sizes) == len(triangles) == len(collections) and all(collection.objects for collection in chain.all_collections)
    return chain if is_complete else None


def remove_unused_chains() -> None:
    """Remove the levels that nothing shows, with their meshes, materials, images and node groups that nothing else uses."""
    chains = read_chains()
    users = bpy.data.user_map(subset=[collection for chain in chains for collection in chain.all_collections])
    for chain in chains:
        if not any(isinstance(user, bpy.types.Object) for collection in chain.all_collections for user in users[collection]):
            _remove_chain(chain)


def _remove_chain(chain: Chain) -> None:
    objects = chain.objects
    data = [item.data for item in objects]
    slots = [slot.material for item in objects for slot in item.material_slots]
    materials = [material for material in slots if material is not None]
    images = find_images(materials)
    trees = [node.node_tree for material in materials if material.node_tree for node in material.node_tree.nodes if node.type == "GROUP"]
    bpy.data.batch_remove([*objects, *chain.all_collections])
    remove_unused_data(data, materials, images, trees)
