"""Entries in the menus of Blender, where *Menu Search* finds them as well: the same operators and settings as in the panels."""

from collections.abc import Callable
from typing import NamedTuple

import bpy


class Entry(NamedTuple):
    """An operator in a menu. text: its name there, "" for its label. properties: values other than those of the panel."""

    operator: str
    icon: str = "NONE"
    text: str = ""
    properties: tuple[tuple[str, str], ...] = ()


class FARFIELD_MT_object(bpy.types.Menu):
    """What Farfield makes of the selected objects"""

    bl_idname = "FARFIELD_MT_object"
    bl_label = "Farfield"

    def draw(self, _context: bpy.types.Context) -> None:
        """Draw the operators."""
        _draw(self.layout, OF_OBJECTS)


OF_OBJECTS = (
    Entry("distance_build", "MOD_DECIM"),
    Entry("texmesh_levels", "MESH_ICOSPHERE"),
    Entry("billboards_build", "OUTLINER_OB_POINTCLOUD"),
    Entry("btf_bake", "RENDER_STILL"),
    Entry("photos_merge", "IMAGE_DATA"),
    Entry("unwrap", "UV"),
    Entry("bdam_drop", "TRIA_DOWN_BAR"),
    Entry("bdam_freeze", "FREEZE"),
    Entry("clipbox_convert_to_mesh", "MESH_DATA"),
)
UNWRAP = (Entry("unwrap"), Entry("unwrap_overlay"))
MENUS: dict[str, tuple[Entry, ...]] = {
    "VIEW3D_MT_mesh_add": (Entry("clipbox_create", "WORLD_DATA", "Clip-Box Terrain"), Entry("bdam_load", "RNDCURVE", "Large Terrain")),
    "VIEW3D_MT_object": (),
    "VIEW3D_MT_uv_map": UNWRAP,
    "IMAGE_MT_uvs": UNWRAP,
    "IMAGE_MT_image": (Entry("restore_mask"), Entry("restore_image"), Entry("photos_register")),
    "TOPBAR_MT_file_import": (
        Entry("photos_import_cameras", text="Cameras of Photographs"),
        Entry("bdam_add_files", text="Elevation Models of Large Terrain", properties=(("kind", "SOURCES"),)),
    ),
    "TOPBAR_MT_file_export": (
        Entry("texmesh_export", text="Perceptual Levels (.glb)"),
        Entry("packages_export", text="Package of Perceptual Levels"),
        Entry("btf_export", text="Relightable Textures"),
    ),
}
_added: list[tuple[str, Callable[[bpy.types.Menu, bpy.types.Context], None]]] = []


def _draw(layout: bpy.types.UILayout, entries: tuple[Entry, ...]) -> None:
    for entry in entries:
        operator = layout.operator(f"farfield.{entry.operator}", icon=entry.icon, **({"text": entry.text} if entry.text else {}))
        for name, value in entry.properties:
            setattr(operator, name, value)


def _drawer(entries: tuple[Entry, ...]) -> Callable[[bpy.types.Menu, bpy.types.Context], None]:
    def draw(self: bpy.types.Menu, _context: bpy.types.Context) -> None:
        self.layout.separator()
        if entries:
            _draw(self.layout, entries)
        else:
            self.layout.menu(FARFIELD_MT_object.bl_idname)

    return draw


def register() -> None:
    """Register the menu of objects and extend those of Blender."""
    bpy.utils.register_class(FARFIELD_MT_object)
    for name, entries in MENUS.items():
        _added.append((name, _drawer(entries)))
        getattr(bpy.types, name).append(_added[-1][1])


def unregister() -> None:
    """Undo `register`."""
    for name, draw in _added:
        getattr(bpy.types, name).remove(draw)
    _added.clear()
    bpy.utils.unregister_class(FARFIELD_MT_object)
