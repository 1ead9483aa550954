"""Where an image is used: normal maps, replacement in materials, new masks, and links between original, mask and restored image."""

import hashlib
from collections.abc import Iterator

import bpy

from ...compat import image_paint_settings, set_brush_diameter

ORIGINAL_PROPERTY = "farfield_original"  # the property of a restored image that points to its original
MASKED_PROPERTY = "farfield_masked"  # the property of a mask that points to its image
RESULT_PROPERTY = "farfield_result"  # the property of a result that Restore may replace: its digest, see `mark_replaceable`
MASK_SUFFIX = " mask"
BLACK, WHITE = (0.0, 0.0, 0.0, 1.0), (1.0, 1.0, 1.0)


def read_image_property(image: bpy.types.Image | None, name: str) -> bpy.types.Image | None:
    """Return the image that a custom property of `image` points to, None if there is none."""
    value = None if image is None else image.get(name)
    return value if isinstance(value, bpy.types.Image) else None


def find_restored(original: bpy.types.Image) -> bpy.types.Image | None:
    """Return the newest image that was restored from `original`, None if there is none."""
    return next(reversed(list_restored(original)), None)


def list_restored(original: bpy.types.Image) -> list[bpy.types.Image]:
    """Return the images that were restored from `original`, the oldest first."""
    found = [image for image in bpy.data.images if read_image_property(image, ORIGINAL_PROPERTY) == original]
    return sorted(found, key=lambda image: image.session_uid)


def mark_replaceable(result: bpy.types.Image) -> None:
    """Let the next restoration replace `result`, unless it is saved, renamed, painted or used for another restoration before."""
    result[RESULT_PROPERTY] = _digest(result)


def find_replaceable(original: bpy.types.Image) -> bpy.types.Image | None:
    """Return the newest result of `original` if a restoration may replace it, otherwise None."""
    result = find_restored(original)
    if result is None or RESULT_PROPERTY not in result or not _is_editable(result) or result.is_dirty:
        return None
    links = (read_image_property(image, name) for image in bpy.data.images for name in (ORIGINAL_PROPERTY, MASKED_PROPERTY))
    return result if result not in links and result[RESULT_PROPERTY] == _digest(result) else None


def take_place(former: bpy.types.Image, new: bpy.types.Image) -> None:
    """Let `new` have the users and the name of `former`, which is removed."""
    name = former.name
    former.user_remap(new)
    bpy.data.images.remove(former)
    new.name = name


def list_maps(image: bpy.types.Image) -> list[bpy.types.Image]:
    """Return the other images that Image Texture nodes use in the materials of `image`, and in their node groups. Of a material that uses a
    result of `image` in its place, these are the originals of other results."""
    results, found = list_restored(image), {}
    for material in bpy.data.materials:
        used = _find_textures(material.node_tree)
        if image in used:
            found |= used
        elif any(result in used for result in results):
            found |= {read_image_property(each, ORIGINAL_PROPERTY) or each: None for each in used}
    return [each for each in found if each not in {image, *results}]


def is_normal_map(image: bpy.types.Image) -> bool:
    """Return whether a node tree links `image`, or a result of its restoration, to a Normal Map node, directly or through reroutes."""
    used = [image, *list_restored(image)]
    return any(_feeds_normal_map(node) for _, tree in _node_trees() for node in tree.nodes if getattr(node, "image", None) in used)


def replace_image(original: bpy.types.Image, new: bpy.types.Image) -> list[str]:
    """Use `new` in place of `original`, and of other images restored from it, in nodes of materials, Worlds, lights, scenes and node
    groups, and in textures.

    Returns the names of the data-blocks that use such an image but cannot be changed, because they are linked or library overrides.
    """
    old, skipped = [original, *(image for image in list_restored(original) if image != new)], []
    for owner, tree in _node_trees():
        nodes = [node for node in tree.nodes if getattr(node, "image", None) in old]
        if nodes and not _is_editable(owner):
            skipped.append(owner.name)
        elif nodes:
            for node in nodes:
                node.image = new
    for texture in bpy.data.textures:
        if texture.type == "IMAGE" and texture.image in old:
            if _is_editable(texture):
                texture.image = new
            else:
                skipped.append(texture.name)
    return skipped


def create_mask(source: bpy.types.Image) -> bpy.types.Image:
    """Create a packed black image with the size and the tiles of `source`, for which it is the mask from then on."""
    is_tiled = source.source == "TILED"
    width, height = source.size
    mask = bpy.data.images.new(source.name + MASK_SUFFIX, width, height, alpha=False, is_data=True, tiled=is_tiled)
    if is_tiled:
        mask.tiles[0].number = min(tile.number for tile in source.tiles)
        for tile in source.tiles:
            _fill_tile(mask, tile)
    mask.pack()
    mask[MASKED_PROPERTY] = source
    return mask


def set_brush_color(tools: bpy.types.ToolSettings, color: tuple[float, float, float]) -> None:
    """Give the brushes that paint images this color: the one that they share, and that of the active brush."""
    image_paint_settings(tools).color = color
    brush = tools.image_paint.brush
    if brush is not None and brush.is_editable:
        brush.color = color


def set_brush_size(tools: bpy.types.ToolSettings, diameter: int) -> None:
    """Give the brushes that paint images this diameter on screen in pixels: the one that they share, and that of the active brush."""
    brush = tools.image_paint.brush
    for each in (image_paint_settings(tools), *([brush] if brush is not None and brush.is_editable else [])):
        set_brush_diameter(each, diameter)


def _digest(image: bpy.types.Image) -> str:
    """Return what differs once an image is renamed, saved to a file or packed with other pixels."""
    digest = hashlib.sha256(f"{image.name}\n{image.filepath}".encode("utf-8", "surrogatepass"))
    for file in image.packed_files:
        digest.update(file.packed_file.data)
    return digest.hexdigest()


def _node_trees() -> Iterator[tuple[bpy.types.ID, bpy.types.NodeTree]]:
    """Yield every node tree in the file with the data-block that owns it; node groups own themselves."""
    for group in bpy.data.node_groups:
        yield group, group
    for owners in (bpy.data.materials, bpy.data.worlds, bpy.data.lights, bpy.data.linestyles, bpy.data.scenes):
        for owner in owners:
            tree = getattr(owner, "node_tree", None)
            if tree is not None and tree.is_embedded_data:  # in Blender 5 the nodes of a scene are a node group
                yield owner, tree


def _find_textures(tree: bpy.types.NodeTree | None) -> dict[bpy.types.Image, None]:
    """Return the images that Image Texture nodes use in a node tree and in its node groups, in their order."""
    pending, found = [tree], {}
    for each in pending:
        for node in each.nodes if each is not None else ():
            if node.type == "TEX_IMAGE" and node.image is not None:
                found[node.image] = None
            elif node.type == "GROUP" and node.node_tree not in pending:
                pending.append(node.node_tree)
    return found


def _is_editable(owner: bpy.types.ID) -> bool:
    return owner.library is None and owner.override_library is None


def _feeds_normal_map(node: bpy.types.Node) -> bool:
    pending, seen = list(node.outputs[:1]), set()
    while pending:
        for link in pending.pop().links:
            if link.to_node.type == "NORMAL_MAP":
                return True
            if link.to_node.type == "REROUTE" and link.to_node not in seen:
                seen.add(link.to_node)
                pending.extend(link.to_node.outputs)
    return False


def _fill_tile(mask: bpy.types.Image, tile: bpy.types.UDIMTile) -> None:
    """Add a black tile to `mask`, or make an existing one black, with the number and the size of `tile`."""
    mask.tiles.active = mask.tiles.get(tile.number) or mask.tiles.new(tile.number)
    with bpy.context.temp_override(edit_image=mask):
        bpy.ops.image.tile_fill(color=BLACK, width=tile.size[0], height=tile.size[1], float=False, alpha=False)
