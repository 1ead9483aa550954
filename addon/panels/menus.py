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


UNWRAP = (Entry("unwrap"), Entry("unwrap_overlay"))
OF_OBJECTS = (
    Entry("distance_build", "MOD_DECIM"),
    Entry("texmesh_levels", "MESH_ICOSPHERE"),
    Entry("billboards_build", "OUTLINER_OB_POINTCLOUD"),
    Entry("btf_bake", "RENDER_STILL"),
    Entry("photos_merge", "IMAGE_DATA"),
    Entry("unwrap", "UV"),
    Entry("scatter_add", "OUTLINER_OB_POINTCLOUD"),
    Entry("scatter_remove", "X"),
    Entry("clipbox_drop", "TRIA_DOWN_BAR"),
    Entry("bdam_drop", "TRIA_DOWN_BAR"),
    Entry("bdam_freeze", "FREEZE"),
    Entry("clipbox_convert_to_mesh", "MESH_DATA"),
)
# What is in the menu *Farfield* of each of these menus: a search for that word finds all of it.
MENUS: dict[str, tuple[Entry, ...]] = {
    "VIEW3D_MT_mesh_add": (Entry("clipbox_create", "WORLD_DATA", "Clip-Box Terrain"), Entry("bdam_load", "RNDCURVE", "Large Terrain")),
    "VIEW3D_MT_light_add": (Entry("add_sky", "LIGHT_SUN"),),
    "VIEW3D_MT_object": OF_OBJECTS,
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


class FarfieldMenu:
    """Mixin of the menus, each in one of Blender's. entries: its operators."""

    bl_label = "Farfield"
    entries: tuple[Entry, ...] = ()

    def draw(self, _context: bpy.types.Context) -> None:
        """Draw the operators."""
        for entry in self.entries:
            operator = self.layout.operator(f"farfield.{entry.operator}", icon=entry.icon, **({"text": entry.text} if entry.text else {}))
            for name, value in entry.properties:
                setattr(operator, name, value)


def menu_name(parent: str) -> str:
    """Return the identifier of the menu that a menu of Blender gets."""
    return f"FARFIELD_MT_{parent.lower()}"


def create_menu(parent: str, entries: tuple[Entry, ...]) -> type[bpy.types.Menu]:
    """Return the class of the menu that a menu of Blender gets."""
    members = {"__doc__": "Operators of Farfield", "__module__": __name__, "bl_idname": menu_name(parent), "entries": entries}
    return type(menu_name(parent), (FarfieldMenu, bpy.types.Menu), members)


def _drawer(name: str) -> Callable[[bpy.types.Menu, bpy.types.Context], None]:
    def draw(self: bpy.types.Menu, _context: bpy.types.Context) -> None:
        self.layout.separator()
        self.layout.menu(name)

    return draw


register_classes, unregister_classes = bpy.utils.register_classes_factory([create_menu(*menu) for menu in MENUS.items()])
_added: list[tuple[str, Callable[[bpy.types.Menu, bpy.types.Context], None]]] = []


def register() -> None:
    """Register the menus, and add them to those of Blender."""
    register_classes()
    for parent in MENUS:
        _added.append((parent, _drawer(menu_name(parent))))
        getattr(bpy.types, parent).append(_added[-1][1])


def unregister() -> None:
    """Undo `register`."""
    for parent, draw in _added:
        getattr(bpy.types, parent).remove(draw)
    _added.clear()
    unregister_classes()
