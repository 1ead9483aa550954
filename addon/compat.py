"""Where Blender 4.5 to 5.2 differ. No other file asks for Blender's version."""

import bpy


def eevee_engine() -> str:
    """The identifier of EEVEE for `scene.render.engine`."""
    return "BLENDER_EEVEE" if bpy.app.version >= (5, 0, 0) else "BLENDER_EEVEE_NEXT"


def set_file_format(settings: bpy.types.ImageFormatSettings, file_format: str) -> None:
    """Choose the format that renders are saved in, for instance `PNG`, `OPEN_EXR` or `OPEN_EXR_MULTILAYER`.

    Blender 5 sorts formats by medium and refuses those of another medium than the one that is set.
    """
    if bpy.app.version >= (5, 0, 0):
        settings.media_type = "MULTI_LAYER_IMAGE" if file_format == "OPEN_EXR_MULTILAYER" else "IMAGE"
    settings.file_format = file_format


def uses_nodes(material: bpy.types.Material) -> bool:
    """Whether `material` is drawn by its nodes; from Blender 5 on every material is."""
    return material.node_tree is not None and (bpy.app.version >= (5, 0, 0) or material.use_nodes)


def give_nodes(material: bpy.types.Material) -> None:
    """Let `material` be drawn by nodes."""
    if not uses_nodes(material):
        material.use_nodes = True
