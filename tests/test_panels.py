"""Panels show every setting once, where it counts."""

import importlib
import inspect

import bpy
import numpy as np
import pytest

from farfield.addon.core.photos.previews import CLASS_COLORS, INTERPOLATED, PHOTOGRAPHED, UNBOUND
from farfield.addon.core.settings import Settings, describe
from farfield.addon.core.unwrap.distortion import stretch_colors
from farfield.addon.panels import photos, sidebar, texmesh, unwrap
from lib import environment

pytestmark = pytest.mark.usefixtures("extension", "empty_scene")
TOOLS = sorted(path.parent.name for path in (environment.ROOT / "addon" / "core").glob("*/settings.py"))
WITHOUT_PANEL = {"ExportSettings"}  # which the file browser of the operator shows


def panels_of(tool: str) -> list[type]:
    """Return the panels of a tool that show settings."""
    module = importlib.import_module(f"farfield.addon.panels.{tool}")
    return [item for item in module.CLASSES if hasattr(item, "shown_settings")]


def shown(tool: str, name: str) -> list[str]:
    """Return the names of the settings that a panel shows, none if it is hidden."""
    panel = next(item for item in panels_of(tool) if item.bl_idname == f"FARFIELD_PT_{tool}{name}")
    is_visible = not hasattr(panel, "poll") or panel.poll(bpy.context)
    return [item.name for item in panel.shown_settings(bpy.context)] if is_visible else []


@pytest.mark.parametrize("tool", TOOLS)
def test_every_setting_is_in_one_panel(tool):
    module = importlib.import_module(f"farfield.addon.core.{tool}.settings")
    types = [item for _, item in inspect.getmembers(module, inspect.isclass) if issubclass(item, Settings) and item is not Settings]
    panels = panels_of(tool)
    wanted = {(item.name, item.help) for each in types if each.__name__ not in WITHOUT_PANEL for item in describe(each)}
    for editor in {panel.bl_space_type for panel in panels}:
        in_editor = [panel for panel in panels if panel.bl_space_type == editor]
        drawn = [(item.name, item.help) for panel in in_editor for item in panel.settings if item.group == panel.group_name]
        assert set(drawn) == wanted and len(drawn) == len(wanted)


def test_settings_are_shown_where_they_count():
    group = bpy.context.scene.farfield_clipbox
    assert shown("clipbox", "_terrain") == ["terrain", "ruggedness", "erosion", "seed", "scale", "water"]
    group.terrain, group.water = "forest", True
    names = ["terrain", "source", "plant_size", "forest_spacing", "forest_hills", "seed", "scale", "water", "water_level"]
    assert shown("clipbox", "_terrain") == names
    assert "roughness" not in shown("clipbox", "_detail")
    group.subdivided_boxes = 1
    assert "roughness" in shown("clipbox", "_detail")


def test_sub_panels_without_a_setting_that_counts_are_hidden():
    scene = bpy.context.scene
    assert shown("btf", "_emission") == shown("restore", "_pixels") == []
    scene.farfield_btf.model, scene.farfield_restore.method = "emission", "pixels"
    assert shown("btf", "_emission") == ["lights_per_side", "codec", "components", "shadows_per_side", "shadow_components"]
    assert shown("restore", "_pixels") == ["pyramid_levels", "order", "coherence"]
    scene.farfield_restore.split = "diffusion"
    assert shown("restore", "_pixels") == [] and shown("restore", "_structure_and_texture") == ["split", "tileable"]


def test_legends_have_the_colors_of_their_overlays():
    icons = {item.identifier for item in bpy.types.UILayout.bl_rna.functions["label"].parameters["icon"].enum_items}
    assert {icon for legend in (photos.LEGEND, texmesh.LEGEND, unwrap.LEGEND) for icon, _ in legend} <= icons
    channels = {sidebar.RED: 0, sidebar.GREEN: 1, sidebar.BLUE: 2}
    for colors, legend in (
        (stretch_colors(np.array([2.0, 1.0, 0.5])), unwrap.LEGEND),
        (CLASS_COLORS[[PHOTOGRAPHED, INTERPOLATED, UNBOUND]], photos.LEGEND),
    ):
        for color, (icon, _) in zip(colors, legend, strict=True):
            assert color.argmax() == channels[icon] if icon in channels else color.min() > 0.8
