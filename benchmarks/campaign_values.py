"""Random values of settings for campaigns: as flags of the scripts and as properties of operators, within limits that keep a case fast."""

import math
from random import Random
from typing import Any

import random_inputs
from farfield.addon.core.bdam.settings import BdamSettings
from farfield.addon.core.billboards.settings import BillboardSettings, CrossfadeSettings
from farfield.addon.core.btf.settings import BtfSettings, ExportSettings
from farfield.addon.core.clipbox.settings import ClipboxSettings, ConvertSettings
from farfield.addon.core.packages.settings import PackageSettings
from farfield.addon.core.photos.settings import PhotosSettings
from farfield.addon.core.restore.settings import RestoreSettings
from farfield.addon.core.settings import Description, Settings, Unit, describe
from farfield.addon.core.texmesh.settings import SceneSettings, TexmeshSettings
from farfield.addon.core.unwrap.settings import UnwrapSettings

FLAG_SETTINGS: dict[str, tuple[type[Settings], ...]] = {
    "billboards": (BillboardSettings, CrossfadeSettings),
    "btf": (BtfSettings, ExportSettings),
    "unwrap": (UnwrapSettings,),
    "clipbox": (ClipboxSettings, ConvertSettings),
    "restore": (RestoreSettings,),
    "texmesh": (TexmeshSettings, SceneSettings),
    "packages": (TexmeshSettings, PackageSettings),
    "photos": (PhotosSettings,),
    "bdam": (BdamSettings,),
}
# Defaults of a case, in internal units: a case takes about a second.
SMALL: dict[str, dict[str, Any]] = {
    "billboards": {"error": 0.1, "levels": 1, "samples": 1},
    "btf": {
        "views_per_side": 2, "lights_per_side": 2, "samples": 1, "components": 2, "alpha_components": 2, "shadows_per_side": 2,
        "shadow_components": 2, "clusters": 2, "cluster_components": 2, "executor": "serial", "directions": "baked",
    },
    "unwrap": {},
    "clipbox": {"resolution": 32, "boxes": 2},
    "restore": {"pyramid_levels": 1},
    "texmesh": {"views": 2, "max_image": 32, "levels": "number", "number": 2},
    "packages": {"views": 2, "max_image": 32, "levels": "number", "number": 2, "pixels": 32, "tile_size": 32},
    "photos": {"size": 32},
    "bdam": {"patch_size": "16", "executor": "serial"},
}  # fmt: skip
LIMITS: dict[str, tuple[float, float]] = {
    "error": (0.03, 0.25), "levels": (1, 3), "quads": (0, 40), "texture_mb": (0.0, 0.2), "texel_size": (0.5, 4.0), "samples": (1, 2),
    "max_texture_waste": (1.5, 50.0), "views_per_side": (2, 3), "lights_per_side": (2, 3), "components": (1, 5), "alpha_components": (1, 5),
    "clusters": (1, 4), "cluster_components": (1, 4), "shadows_per_side": (0, 3), "shadow_components": (1, 5), "resolution": (32, 40),
    "boxes": (1, 4), "subdivided_boxes": (0, 2), "smoothing": (0, 2), "sphere_count": (1, 4), "sphere_classes": (1, 4),
    "pyramid_levels": (1, 3), "views": (1, 3), "max_image": (16, 48), "number": (2, 4), "pixels": (16, 48), "max_pixels": (8, 48),
    "size": (16, 64), "tile_size": (16, 64),
}  # fmt: skip
NO_FLAGS = {("packages", "vertices")}  # Packages do not leave these open.
EXECUTORS = ("serial", "processes", "processes:2", "processes:0", "dask:tcp://127.0.0.1:1", "threads", "")


def small_flags(tool: str) -> list[str]:
    """Return the flags that keep a run of `tool` small."""
    flags = []
    for description in _descriptions(tool):
        if description.name in SMALL[tool]:
            flags += [description.flag, description.format(SMALL[tool][description.name])]
    return flags


def random_flags(random: Random, tool: str, bad_fraction: float = 0.06) -> list[str]:
    """Return none to five random flags of the settings of `tool`; a part of their values is invalid."""
    flags, descriptions = [], [item for item in _descriptions(tool) if (tool, item.name) not in NO_FLAGS]
    if tool == "clipbox" and random.random() < 0.8:  # the others need --convert-to-mesh
        descriptions = describe(ClipboxSettings)
    for description in random.sample(descriptions, random.choice((0, 0, 1, 1, 2, 3, 5))):
        if random.random() < bad_fraction and description.type is not bool:
            flags += [description.flag, random_inputs.bad_value(random)]
            continue
        value = _random_value(random, description)
        flags += [description.flags[0 if value else 1]] if isinstance(value, bool) else [description.flag, value]
    return flags


def random_properties(random: Random, *settings_types: type[Settings], tool: str) -> dict[str, Any]:
    """Return properties of an operator with these settings: the small ones, and a random part of the others."""
    properties = {}
    for settings_type in settings_types:
        for description in describe(settings_type):
            if random.random() < 0.25:
                properties[description.name] = _to_property(description, _random_value(random, description))
            elif description.name in SMALL[tool]:
                value = SMALL[tool][description.name]
                properties[description.name] = value * 100.0 if description.unit is Unit.FRACTION else value
    return properties


def _random_value(random: Random, description: Description) -> str | bool:
    if description.name == "executor":
        return random.choice(EXECUTORS)
    if description.name == "formula":
        return random_inputs.random_formula(random)
    return random_inputs.valid_value(random, description, LIMITS.get(description.name))


def _to_property(description: Description, value: str | bool) -> Any:
    """Return a value written for the command line as that of a Blender property."""
    if isinstance(value, bool) or description.choices or description.type is str:
        return value
    if description.type is tuple:
        return tuple(float(number) for number in value.split(","))
    number = float(value.rstrip("%"))
    return int(number) if description.type is int else math.radians(number) if description.unit is Unit.ANGLE else number


def _descriptions(tool: str) -> list[Description]:
    return [description for settings_type in FLAG_SETTINGS[tool] for description in describe(settings_type)]
