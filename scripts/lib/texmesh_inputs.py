"""What the commands of `texmesh.py` read: settings and objects."""

from argparse import Namespace
from collections.abc import Sequence
from pathlib import Path

import bpy

from lib import environment

environment.import_farfield()

from farfield.addon.core.errors import SettingsError
from farfield.addon.core.settings import Settings, from_flags
from farfield.addon.core.texmesh.level_chain import AllSettings
from farfield.addon.core.texmesh.ratios import parse_ratios
from farfield.addon.core.texmesh.settings import BUDGETS
from lib import scene_files


def read_all_settings(given: Namespace, settings_types: Sequence[type[Settings]]) -> AllSettings:
    """Return the settings of levels. The choice of levels follows from the flags if it is not given.

    settings_types: in the order of `AllSettings`.

    Raises:
        SettingsError: a value is invalid, or two flags imply different choices of levels.
    """
    implied = [choice for choice, name in BUDGETS.items() if getattr(given, name) is not None]
    if given.choice is None and implied:
        if len(implied) > 1:
            names = " and ".join(f"--{BUDGETS[choice].replace('_', '-')}" for choice in implied)
            raise SettingsError(f"{names} exclude each other; give one, or name the one that counts by --choice.")
        given.choice = implied[0]
    levels, *others = (from_flags(settings_type, given) for settings_type in settings_types)
    if levels.choice == "ratio":
        parse_ratios(levels.ratio)
    return AllSettings(levels, *others)


def open_objects(path: Path) -> list[bpy.types.Object]:
    """Open the input and return its meshes that are visible in renders. Raises FarfieldError."""
    scene_files.open_scene(path.absolute())
    return scene_files.objects_in_renders([item for item in bpy.context.scene.objects if item.type == "MESH"], path)
