"""Settings of the tool `texmesh`, beside those of its analysis, simplification and perception."""

from dataclasses import dataclass
from typing import ClassVar

from ..settings import Choice, Settings, Unit, setting
from .scale_space.scale_map import SCALES

PRODUCTS = {
    "subset": Choice("Subset", "Vertices are those of the original, unmoved: levels can be sent one after the other"),
    "refit": Choice("Refit", "Positions and texture coordinates are moved to deviate least from the original"),
}
ORDERS = {
    "visibility": Choice("Visibility", "What changes shape and texture least first; features of coarse scales count more"),
    "scale": Choice("Scale", "By the last scale at which vertices are features, as in the paper"),
}
LEVEL_CHOICES = {
    "perceptual": Choice("Perceptual", "All levels that look different from each other"),
    "count": Choice("Number", "A number of levels"),
    "triangles": Choice("Triangles", "Levels with a total number of triangles"),
    "size": Choice("File Size", "Levels with a total size as quantized geometry"),
    "pixels": Choice("Pixels", "Levels for an object that is never seen larger than a number of pixels"),
    "ratio": Choice("Ratio", "Levels with fractions of the triangles"),
}
BUDGETS = {  # the setting that each choice of levels needs
    "count": "levels",
    "triangles": "max_triangles",
    "size": "max_size",
    "pixels": "max_pixels",
    "ratio": "ratio",
}


@dataclass(frozen=True, kw_only=True)
class LevelSettings(Settings):
    """Which levels of detail are made."""

    product: str = setting("refit", "Whether vertices may be moved", label="Kind", choices=PRODUCTS)
    rebake: bool = setting(
        False,
        "Give each level a texture of its own, as small as its distance allows, with the colors of the original. For refit levels",
        label="Rebake Textures",
    )
    order: str = setting("visibility", "In which order vertices are removed", label="Removal Order", panel_label="Order", choices=ORDERS)
    choice: str = setting("perceptual", "What determines the levels", label="Levels", choices=LEVEL_CHOICES)
    levels: int = setting(
        4, "Number of levels, the original included", label="Number of Levels", panel_label="Number", minimum=2, maximum=24, unit=Unit.COUNT
    )
    max_triangles: int = setting(
        100_000, "Triangles of all levels together, without the original", minimum=4, maximum=1_000_000_000, unit=Unit.COUNT
    )
    max_size: float = setting(
        1.0, "Size of all levels together, without the original and textures", minimum=1e-3, maximum=1e5, unit=Unit.MEGABYTES
    )
    max_pixels: int = setting(512, "Largest size of the object in images, in pixels", minimum=8, maximum=2048, unit=Unit.COUNT)
    ratio: str = setting("0.5,0.25,0.125", "Fractions of the triangles of the original, one per level", label="Ratios")


@dataclass(frozen=True, kw_only=True)
class SceneSettings(Settings):
    """What happens in the scene when levels are made."""

    crossfade: bool = setting(True, "Cross-fade the levels for the active camera", label="Cross-Fade")
    fade_range: float = setting(
        0.2,
        "Distance range of the cross-fade to the next level, relative to the distance where it starts; 0 switches instantly",
        minimum=0.0,
        maximum=2.0,
        unit=Unit.FRACTION,
    )
    keep_source_visible: bool = setting(False, "Keep the original visible in addition to its levels", label="Keep Original Visible")


@dataclass(frozen=True, kw_only=True)
class InspectionSettings(Settings):
    """How features and levels are shown; they change no result."""

    has_flags: ClassVar[bool] = False

    lowest_scale: int = setting(
        1, "Scale at which the smallest colored features end", minimum=0, maximum=SCALES - 1, unit=Unit.COUNT, group="Inspect"
    )
    flicker_seconds: float = setting(0.5, "Seconds between two levels", minimum=0.1, maximum=10.0, label="Flicker Time", group="Inspect")
