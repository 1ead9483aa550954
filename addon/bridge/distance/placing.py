"""Shows levels by distance at all places of an asset, shows the originals again, and removes the levels."""

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager

import bpy

from ...compat import read_node_input, set_node_input
from ..active_camera import VIEW_NAME
from ..blender import remove_unused_data
from ..geometry.geometry_nodes import TREE, GeometryBuilder
from ..lod_sets import KIND
from ..objects import parent_collection
from ..rendering.render_properties import ensure_transparent_bounces, estimate_transparent_bounces
from ..shading.node_builder import NodeBuilder, ensure_shared_group
from .assets import Asset
from .chains import CHAIN, HOST, Chain, remove_unused_chains
from .level_switch import MAX_ERROR, NAME, Places, ensure_level_switch, level_modifiers
from .particles import EMITTER, find_scatters, restore_particles

MODIFIER = "Farfield Distance"
QUADS = "farfield_quads"  # Property of the levels of billboard clouds.
MIN_FADE_BOUNCES = 16  # Transparent surfaces of two levels that fade, one behind the other.
PLACES_NAME, PLACES_VERSION = "Farfield Places", 1
PLACES = "farfield_places"  # Property of the object that shows the levels of empties: the collection of these.
INSTANCE_TYPE = "farfield_instance_type"  # Property of an empty that levels stand for.
CARD_BOUNCES = 32  # Of cards of leaves, one behind the other.
BOUNCES = "farfield_distance_bounces"  # Property of a scene: its limit of transparent bounces before and after the levels were added.


def attach_chain(asset: Asset, chain: Chain, scene: bpy.types.Scene, fade_range: float, max_error: float) -> None:
    """Show an asset by its levels at all its places. They may leave out `max_error` pixels."""
    ranges = {"Fade Range": fade_range, MAX_ERROR: max_error}
    for hosts, places in ((asset.hosts, Places.OBJECT), (asset.scatterers, Places.MATCHING)):
        for host in dict.fromkeys(hosts):
            _add_modifier(host, chain, ranges, places, asset.tolerances.get(host, 0.0))
    if asset.empties:
        _add_placements(asset, chain, scene, ranges)
    quads = [item for item in chain.objects if QUADS in item]
    _raise_bounces(scene, max(MIN_FADE_BOUNCES if fade_range else 0, estimate_transparent_bounces(quads) if quads else 0))
    chain.collections[0].use_fake_user = False


def _add_modifier(host: bpy.types.Object, chain: Chain, ranges: dict[str, float], places: Places, tolerance: float = 0.0) -> None:
    """Show levels of an object, or of its instances whose bounding box differs from that of the asset by less than `tolerance`."""
    modifier = host.modifiers.new(f"{MODIFIER}: {chain.name}"[:63], "NODES")
    modifier.node_group = ensure_level_switch(len(chain.collections), places)
    modifier.show_expanded = False
    center = 0.5 * (chain.low + chain.high)
    values = {"Center": center.tolist(), "Half Size": (chain.high - center).tolist(), **ranges}
    if places is Places.MATCHING:
        values |= {"Low": chain.low.tolist(), "High": chain.high.tolist(), "Tolerance": tolerance}
    for number, (collection, size) in enumerate(zip(chain.collections, chain.pixel_sizes, strict=True)):
        values |= {f"Level {number}": collection, f"Pixel Size {number}": size}
    values |= {f"Fading Level {number}": collection for number, collection in enumerate(chain.fading)}
    for name, value in values.items():
        set_node_input(modifier, name, value)
    host.update_tag()


def _add_placements(asset: Asset, chain: Chain, scene: bpy.types.Scene, ranges: dict[str, float]) -> None:
    """Add an object that instances the levels wherever an empty is, and hide the instances of the empties, which stay movable."""
    places = bpy.data.collections.new(f"{asset.name} Places")
    host = bpy.data.objects.new(f"{asset.name} Levels", bpy.data.meshes.new(f"{asset.name} Levels"))
    places[KIND], host[KIND], host[PLACES] = HOST, HOST, places
    parent_collection(asset.empties[0], scene).objects.link(host)
    host.hide_select = True
    for empty in asset.empties:
        places.objects.link(empty)
        empty[INSTANCE_TYPE], empty.instance_type = empty.instance_type, "NONE"
    modifier = host.modifiers.new(PLACES_NAME, "NODES")
    sockets = [("Geometry", "Geometry")]
    modifier.node_group = ensure_shared_group(
        PLACES_NAME, PLACES_VERSION, [*sockets, ("Places", "Collection")], sockets, _fill_places, tree_type=TREE
    )
    set_node_input(modifier, "Places", places)
    _add_modifier(host, chain, ranges, Places.ALL)


def _fill_places(builder: NodeBuilder) -> None:
    builder = GeometryBuilder(builder.tree)
    given = builder.node("NodeGroupInput").outputs
    inputs = {"Collection": given["Places"], "Separate Children": True}
    places = builder.call("GeometryNodeCollectionInfo", inputs, {"transform_space": "RELATIVE"})
    builder.tree.links.new(places.outputs[0], builder.node("NodeGroupOutput").inputs[0])


def _raise_bounces(scene: bpy.types.Scene, bounces: int) -> None:
    """Let Cycles show the quads behind quads, and remember the limit that the scene had."""
    if hasattr(scene, "cycles"):
        before = scene.cycles.transparent_max_bounces
        ensure_transparent_bounces(scene, bounces)
        if scene.cycles.transparent_max_bounces != before:
            scene[BOUNCES] = [scene.get(BOUNCES, [before])[0], scene.cycles.transparent_max_bounces]


def describe_bounces(scene: bpy.types.Scene, chains: Iterable[Chain]) -> str:
    """Return a sentence if levels have raised the limit of transparent bounces, which changes how stacked transparent surfaces look, or if
    the limit makes cards of leaves darker than their levels."""
    if BOUNCES not in scene:
        limit = scene.cycles.transparent_max_bounces if scene.render.engine == "CYCLES" else CARD_BOUNCES
        if limit < CARD_BOUNCES and any(map(_shows_pieces, chains)):
            return f"With {limit} Max Transparent Bounces of Cycles, cards of leaves are darker than their levels; set {CARD_BOUNCES}."
        return ""
    before, after = scene[BOUNCES]
    return f"Max Transparent Bounces of Cycles was raised from {before} to {after}, with which stacked leaves of originals may be brighter."


def _shows_pieces(chain: Chain) -> bool:
    """Return whether a level has opaque pieces of leaves that are cut out of cards."""
    materials = (slot.material for item in chain.objects for slot in item.material_slots)
    return any(material is not None and material.get(KIND) == CHAIN for material in materials)


def find_hosts(objects: Iterable[bpy.types.Object]) -> list[bpy.types.Object]:
    """Return those of `objects` that show levels by distance."""
    return [item for item in objects if level_modifiers(item)]


def max_errors(scene: bpy.types.Scene) -> dict[bpy.types.Collection, float]:
    """Return what levels may leave out, in pixels, for the collection of the first level of each chain that a scene shows."""
    modifiers = [modifier for item in scene.objects for modifier in level_modifiers(item)]
    return {read_node_input(modifier, "Level 0"): read_node_input(modifier, MAX_ERROR) for modifier in modifiers}


def has_levels(scene: bpy.types.Scene) -> bool:
    """Return whether an object of a scene shows levels by distance. Cheap enough for every redraw."""
    return any(group.name.startswith(NAME) for group in bpy.data.node_groups) and any(map(level_modifiers, scene.objects))


def scale_errors(scene: bpy.types.Scene, factor: float) -> None:
    """Let the levels that a scene shows leave out `factor` times as many pixels."""
    for host in find_hosts(scene.objects):
        for modifier in level_modifiers(host):
            set_node_input(modifier, MAX_ERROR, factor * read_node_input(modifier, MAX_ERROR))
        host.update_tag()


def shows_levels(objects: Iterable[bpy.types.Object]) -> bool:
    """Return whether any of `objects` has levels and shows them."""
    return any(modifier.show_viewport for item in objects for modifier in level_modifiers(item))


def show_levels(scene: bpy.types.Scene, is_shown: bool) -> None:
    """Show the levels of all objects of a scene in viewports and renders, or the originals."""
    for host in find_hosts(scene.objects):
        for modifier in level_modifiers(host):
            modifier.show_viewport = modifier.show_render = is_shown
    for host in scene.objects:
        if host.get(KIND) == HOST:
            host.hide_viewport = host.hide_render = not is_shown
    for empty in scene.objects:
        if INSTANCE_TYPE in empty:
            empty.instance_type = "NONE" if is_shown else empty[INSTANCE_TYPE]


@contextmanager
def originals_shown(scene: bpy.types.Scene, view_layer: bpy.types.ViewLayer) -> Iterator[bpy.types.Depsgraph]:
    """Show the originals in place of their levels for a time, and yield the evaluated scene."""
    is_shown = shows_levels(scene.objects)
    try:
        if is_shown:
            show_levels(scene, False)
        view_layer.update()
        yield view_layer.depsgraph
    finally:
        if is_shown:
            show_levels(scene, True)
            view_layer.update()


def with_placements(scene: bpy.types.Scene, objects: Sequence[bpy.types.Object]) -> list[bpy.types.Object]:
    """Return `objects`, and for the empties among them, the object that shows their levels and all other empties for which it does so; for
    objects with particles, what stands for these."""
    found = dict.fromkeys(objects)
    found |= {host: None for host in find_scatters(scene) if host[EMITTER] in found}
    for host in scene.objects:
        places = _places_of(host)
        if places is not None and (host in found or not found.keys().isdisjoint(places.objects)):
            found |= dict.fromkeys([host, *places.objects])
    return list(found)


def _places_of(host: bpy.types.Object) -> bpy.types.Collection | None:
    """Return the collection of the empties whose levels an object shows, None if it does not show those of empties."""
    return host.get(PLACES) if host.get(KIND) == HOST else None


def detach(objects: Iterable[bpy.types.Object]) -> None:
    """Let `objects`, see `with_placements`, show no levels any more. The levels stay in the file, see `clean_up`."""
    removed = []
    for host in find_hosts(objects):
        places = _places_of(host)
        for modifier in level_modifiers(host):
            host.modifiers.remove(modifier)
        if places is None:
            continue
        for empty in places.objects:
            if INSTANCE_TYPE in empty:
                empty.instance_type = empty[INSTANCE_TYPE]
                del empty[INSTANCE_TYPE]
        removed += [host, host.data, places]
    bpy.data.batch_remove(removed)


def clean_up(scene: bpy.types.Scene) -> None:
    """Show particles without levels again, remove levels and node groups that nothing uses, and without any levels restore the limit of
    transparent bounces."""
    restore_particles(scene)
    remove_unused_chains()
    for name in (NAME, VIEW_NAME, PLACES_NAME):  # The first uses the second.
        remove_unused_data([group for group in bpy.data.node_groups if group.name.startswith(name)])
    if BOUNCES in scene and not has_levels(scene):
        before, after = scene[BOUNCES]
        if scene.cycles.transparent_max_bounces == after:
            scene.cycles.transparent_max_bounces = before
        del scene[BOUNCES]
