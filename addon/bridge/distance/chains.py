"""Chains of levels: collections in no scene, which geometry nodes instance where they show; and the modifiers that do so."""

import json
from collections.abc import Sequence
from dataclasses import dataclass

import bpy
import mathutils
import numpy as np

from ...compat import set_node_input
from .. import lod_crossfade
from ..lod_sets import KIND
from .assets import Asset
from .level_switch import NAME, ensure_level_switch

CHAIN = "distance_level"  # The KIND of collections and objects of levels.
HOST = "distance_host"  # The KIND of objects that show collection instances.
MODIFIER = "Farfield Distance"
FIGURES = "farfield_distance"  # Property of the collection of the first level: JSON, see `Chain`.


@dataclass(frozen=True)
class NewLevel:
    """A level to be added. objects: with their matrices in the space of the asset. pixel_size: above which it shows, in units of the asset."""

    objects: list[tuple[bpy.types.Object, mathutils.Matrix]]
    pixel_size: float


@dataclass(frozen=True)
class Chain:
    """The levels of an asset.

    Attributes:
        name: of the asset.
        collections: of the levels, finest first.
        pixel_sizes: of a level, above which it shows, in units of the asset.
        low: lowest corner of the asset.
        high: highest corner of the asset.
    """

    name: str
    collections: list[bpy.types.Collection]
    pixel_sizes: list[float]
    low: np.ndarray
    high: np.ndarray


def create_chain(asset: Asset, levels: Sequence[NewLevel], low: np.ndarray, high: np.ndarray, fade_range: float) -> Chain:
    """Create the collections of levels, whose objects are in no other collection. With a `fade_range` above 0 they cross-fade."""
    collections = []
    sizes = [level.pixel_size for level in levels]
    ends = [*sizes[1:], lod_crossfade.MAX_PIXEL]
    for number, (level, end) in enumerate(zip(levels, ends, strict=True)):
        collection = bpy.data.collections.new(f"{asset.name} Distance {number}")
        collection[KIND] = CHAIN
        for item, matrix in level.objects:
            item.parent = None
            item.matrix_world = matrix
            item.hide_viewport = item.hide_render = False
            item[KIND] = CHAIN
            collection.objects.link(item)
            if fade_range:
                scale = max(float(np.cbrt(abs(matrix.to_3x3().determinant()))), 1e-12)
                start = level.pixel_size / scale if number else lod_crossfade.MIN_PIXEL
                lod_crossfade.add_crossfade(item, start, end / scale, fade_range)
        collections.append(collection)
    collections[0][FIGURES] = json.dumps({"pixel_sizes": sizes, "low": low.tolist(), "high": high.tolist()})
    return Chain(asset.name, collections, sizes, low, high)


def attach_chain(asset: Asset, chain: Chain, scene: bpy.types.Scene, fade_range: float) -> list[bpy.types.Object]:
    """Show an asset by its levels at all its places. Returns the objects that do so."""
    shown = []
    for host in asset.hosts:
        shown.append(_add_modifier(host, chain, fade_range, shows_instances=False))
    for host in asset.scatterers:
        shown.append(_add_modifier(host, chain, fade_range, shows_instances=True))
    if asset.empties:
        shown.append(_add_placements(asset, chain, scene, fade_range))
    return shown


def _add_modifier(host: bpy.types.Object, chain: Chain, fade_range: float, shows_instances: bool) -> bpy.types.Object:
    modifier = host.modifiers.new(f"{MODIFIER}: {chain.name}"[:63], "NODES")
    modifier.node_group = ensure_level_switch(len(chain.collections), shows_instances)
    center = 0.5 * (chain.low + chain.high)
    values = {"Center": center.tolist(), "Radius": float(np.linalg.norm(chain.high - center)), "Fade Range": fade_range}
    if shows_instances:
        values |= {"Low": chain.low.tolist(), "High": chain.high.tolist()}
    for number, (collection, size) in enumerate(zip(chain.collections, chain.pixel_sizes, strict=True)):
        values |= {f"Level {number}": collection, f"Pixel Size {number}": size}
    for name, value in values.items():
        set_node_input(modifier, name, value)
    host.update_tag()
    return host


def _add_placements(asset: Asset, chain: Chain, scene: bpy.types.Scene, fade_range: float) -> bpy.types.Object:
    """Return a new object that instances an asset wherever an empty does, and hide the empties."""
    raise NotImplementedError


def level_modifiers(item: bpy.types.Object) -> list[bpy.types.NodesModifier]:
    """Return the modifiers of an object that show levels by distance."""
    return [
        modifier
        for modifier in item.modifiers
        if modifier.type == "NODES" and modifier.node_group is not None and modifier.node_group.name.startswith(NAME)
    ]
