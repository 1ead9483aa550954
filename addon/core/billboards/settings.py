"""Settings of billboard clouds."""

import math
from dataclasses import dataclass
from functools import partial
from typing import ClassVar

from ..settings import Choice, Settings, Unit, setting

METHODS = {
    "clusters": Choice(
        "Face Clusters", "Generalized hierarchical face clustering: few quads, little texture, bounded normals (section 4.3)"
    ),
    "hough": Choice("Hough Space", "Greedy planes in Hough space: fewest quads for tangled geometry, much texture (section 4.1)"),
    "decimate": Choice("Decimate", "Edge collapse with a measured error: for smooth connected surfaces (section 4.2)"),
}

SOLID_PARTS = {
    "mesh": Choice("Mesh", "Decimated meshes for parts that these show with about as few triangles, quads for the others"),
    "quads": Choice("Quads", "Flat quads for everything"),
}

in_detail, in_textures = partial(setting, group="Detail"), partial(setting, group="Textures")


@dataclass(frozen=True, kw_only=True)
class CrossfadeSettings(Settings):
    """Settings of the cross-fade between levels of detail."""

    fade_range: float = setting(
        0.25,
        "Distance range of the cross-fade to the next level, relative to the distance where it starts; 0 switches instantly",
        minimum=0.0,
        maximum=4.0,
        unit=Unit.FRACTION,
    )


@dataclass(frozen=True, kw_only=True)
class BuildOptions(Settings):
    """Settings of a build that concern the selected objects, not their clouds."""

    has_flags: ClassVar[bool] = False

    combine_selected: bool = setting(
        False,
        "Build one cloud of all selected objects, with shared textures. Otherwise each object gets its own, together with selected objects "
        "that are parented to it or to the same armature",
        panel_label="One Cloud for All",
    )
    keep_original_visible: bool = setting(
        False, "Keep the original visible after the build. When off, it is hidden in the viewport and in renders"
    )


@dataclass(frozen=True, kw_only=True)
class BillboardSettings(Settings):
    """Settings of the tool `billboards`. Fractions are of the longest bounding-box side unless the help says otherwise."""

    method: str = setting("clusters", "Method that finds the planes of the quads", choices=METHODS)
    error: float = setting(
        0.01,
        "Maximum distance between the surface and its quads at the finest level, relative to the longest bounding-box side",
        minimum=1e-4,
        maximum=0.25,
        unit=Unit.FRACTION,
        used_if={"quads": False, "triangles": False, "texture_mb": False},
    )
    levels: int = setting(3, "Number of levels of detail; the error doubles per level", minimum=1, maximum=8)
    nested_levels: bool = in_detail(
        False,
        "Let quads of a coarser level replace whole quads of the finer one, for streaming. Such levels have more quads; none is left out",
        used_if={"method": ("clusters",)},
    )
    quads: int = in_detail(0, "Target number of quads of the finest level. Overrides Error; 0 disables", minimum=0, maximum=100_000)
    triangles: int = in_detail(
        0, "Target number of triangles of the finest level. Overrides Error; 0 disables", minimum=0, maximum=1_000_000
    )
    texture_mb: float = in_detail(0.0, "Target texture memory of all levels. Overrides Error; 0 disables", minimum=0.0, maximum=65_536.0)
    max_normal_deviation: float = in_detail(
        math.radians(60.0),
        "Maximum angle between a face and the quad that replaces it",
        minimum=math.radians(5.0),
        maximum=math.radians(90.0),
        unit=Unit.ANGLE,
        panel_label="Max Angle",
    )
    normal_scale: float = in_detail(
        0.25,
        "Radius around a face, relative to the error, in which the surface decides its normal: smaller bolts, grooves and noise need "
        "no quads. 0 takes each face's own",
        minimum=0.0,
        maximum=8.0,
        used_if={"method": ("clusters",)},
    )
    max_texture_waste: float = in_detail(
        8.0,
        "Maximum area of a quad relative to the area of the faces that it replaces",
        minimum=1.5,
        maximum=1000.0,
        panel_label="Max Waste",
        used_if={"method": ("clusters", "decimate")},
    )
    solid_parts: str = in_detail(
        "mesh",
        "What shows trunks, walls and other connected surfaces: decimated meshes where these need about as few triangles, or quads only",
        choices=SOLID_PARTS,
        used_if={"method": ("clusters",), "nested_levels": False},
    )
    texel_size: float = in_textures(0.5, "Side length of a texel relative to the level's error", minimum=0.05, maximum=4.0)
    loose_fraction: float = in_detail(
        0.5,
        "Fraction of a quad or texture budget for loose parts, such as leaves, if the mesh also has connected surfaces",
        minimum=0.0,
        maximum=1.0,
        unit=Unit.FRACTION,
    )
    cutout_corners: int = in_detail(
        8, "Maximum corners of the polygon that each quad is cut to; 4 keeps the rectangle", minimum=4, maximum=8
    )
    textures: bool = setting(True, "Capture textures from the materials with Cycles")
    samples: int = in_textures(16, "Cycles samples per texel of the captured textures", minimum=1, maximum=4096, used_if={"textures": True})
    seed: int = setting(0, "Seed of the random choices", minimum=0, maximum=2**31 - 1, group="Advanced")

    @property
    def meshes_parts(self) -> bool:
        """Whether solid parts may be meshes. Quads of nested levels must merge to larger quads."""
        return self.solid_parts == "mesh" and self.method == "clusters" and not self.nested_levels

    @property
    def keeps_all_levels(self) -> bool:
        """Whether levels nest, so that none may be left out."""
        return self.nested_levels and self.method == "clusters"
