"""The menus of Blender have the operators of Farfield, once."""

import bpy
import pytest

from farfield.addon.panels import menus

ICONS = {item.identifier for item in bpy.types.UILayout.bl_rna.functions["operator"].parameters["icon"].enum_items}
pytestmark = pytest.mark.usefixtures("extension", "empty_scene")


class Layout:
    """A layout that records its entries. entries: identifier, text and properties of each operator; menus: of each sub-menu."""

    def __init__(self):
        self.entries, self.menus = [], []

    def separator(self):
        """Ignore a line."""

    def menu(self, name):
        """Record a sub-menu."""
        self.menus.append(name)

    def operator(self, name, text="", icon="NONE"):
        """Record an operator, and return an object for its properties."""
        assert icon in ICONS
        properties = type("Properties", (), {})()
        self.entries.append((name, text, properties))
        return properties


def drawn(name):
    """Return what Farfield adds to a menu of Blender."""
    layout = Layout()
    for draw in getattr(bpy.types, name).draw._draw_funcs:
        if draw.__module__ == menus.__name__:
            draw(type("Menu", (), {"layout": layout})(), bpy.context)
    return layout


def draw(menu):
    """Return what a menu of Farfield contains."""
    layout, entries = Layout(), getattr(bpy.types, menu).entries
    getattr(bpy.types, menu).draw(type("Menu", (), {"layout": layout, "entries": entries})(), bpy.context)
    return layout


def describe(name):
    """Return the type of an operator, with its name and properties."""
    return getattr(bpy.ops.farfield, name.removeprefix("farfield.")).get_rna_type()


@pytest.mark.parametrize("name", sorted(menus.MENUS))
def test_a_menu_of_blender_has_its_operators_once(name):
    (menu,) = drawn(name).menus
    assert getattr(bpy.types, menu).bl_label == "Farfield", "the word that users search for"
    layout = draw(menu)
    names = [entry for entry, _, _ in layout.entries]
    assert names == [f"farfield.{entry.operator}" for entry in menus.MENUS[name]] and len(set(names)) == len(names)
    for identifier, text, properties in layout.entries:
        rna = describe(identifier)
        assert text or rna.name
        for key, value in vars(properties).items():
            assert value in rna.properties[key].enum_items


def test_the_menu_of_objects_has_operators_of_all_tools_for_objects():
    layout = draw(menus.menu_name("VIEW3D_MT_object"))
    tools = {name.removeprefix("farfield.").partition("_")[0] for name, _, _ in layout.entries}
    assert tools == {"distance", "texmesh", "billboards", "btf", "photos", "unwrap", "bdam", "clipbox", "scatter"}
    assert all(describe(name).name for name, _, _ in layout.entries)
