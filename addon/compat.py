"""Differences between Blender 4.5 and 5.2. No other module depends on Blender's version."""

import bpy


def eevee_engine() -> str:
    """Return the identifier of EEVEE for `scene.render.engine`."""
    return "BLENDER_EEVEE" if bpy.app.version >= (5, 0, 0) else "BLENDER_EEVEE_NEXT"


def blender_version() -> str:
    """Return the version of Blender for reports, for instance `5.0.1`."""
    return bpy.app.version_string


def set_file_format(settings: bpy.types.ImageFormatSettings, file_format: str) -> None:
    """Set the file format of renders, for instance `PNG`, `OPEN_EXR` or `OPEN_EXR_MULTILAYER`.

    Blender 5 groups formats by media type and rejects those of another type than the current one.
    """
    if bpy.app.version >= (5, 0, 0):
        settings.media_type = "MULTI_LAYER_IMAGE" if file_format == "OPEN_EXR_MULTILAYER" else "IMAGE"
    settings.file_format = file_format


def compositor_trees(scene: bpy.types.Scene) -> list[bpy.types.NodeTree]:
    """Return the trees whose nodes may process the renders of a scene: that of its compositor, and all groups."""
    tree = scene.compositing_node_group if bpy.app.version >= (5, 0, 0) else scene.node_tree
    return [*filter(None, [tree]), *(group for group in bpy.data.node_groups if group.bl_idname == "CompositorNodeTree")]


def uses_nodes(owner: bpy.types.Material | bpy.types.World) -> bool:
    """Return whether a material or World is rendered with its nodes; from Blender 5 on, all of them are."""
    return owner.node_tree is not None and (bpy.app.version >= (5, 0, 0) or owner.use_nodes)


def enable_nodes(owner: bpy.types.Material | bpy.types.World) -> None:
    """Render a material or World with its nodes."""
    if not uses_nodes(owner):
        owner.use_nodes = True


def image_paint_settings(tools: bpy.types.ToolSettings) -> bpy.types.UnifiedPaintSettings:
    """Return the settings that all brushes share when images are painted; from Blender 5 on, each kind of painting has its own."""
    return tools.image_paint.unified_paint_settings if bpy.app.version >= (5, 0, 0) else tools.unified_paint_settings


def set_brush_diameter(brush: bpy.types.Brush | bpy.types.UnifiedPaintSettings, pixels: int) -> None:
    """Set the size of a brush, or of the settings that brushes share, on screen."""
    brush.size = pixels if bpy.app.version >= (5, 0, 0) else max(pixels // 2, 1)


def read_node_input(modifier: bpy.types.NodesModifier, name: str) -> object:
    """Return the input `name` of the node group of a Geometry Nodes modifier, see `set_node_input`."""
    identifier = modifier.node_group.interface.items_tree[name].identifier
    return getattr(modifier.properties.inputs, identifier).value if bpy.app.version >= (5, 2, 0) else modifier[identifier]


def set_node_input(modifier: bpy.types.NodesModifier, name: str, value: object) -> None:
    """Set the input `name` of the node group of a Geometry Nodes modifier. From Blender 5.2 on, inputs are no custom properties."""
    identifier = modifier.node_group.interface.items_tree[name].identifier
    if bpy.app.version >= (5, 2, 0):
        getattr(modifier.properties.inputs, identifier).value = value
    else:
        modifier[identifier] = value
