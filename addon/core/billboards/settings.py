"""What a user can choose about a billboard cloud."""

import math
from dataclasses import dataclass

from ..settings import Settings, Unit, setting

METHODS = {
    "clusters": "Generalised hierarchical face clustering: few quads, little texture, bounded normals (section 4.3)",
    "hough": "Greedy planes in Hough space: fewest quads for tangled geometry, much texture (section 4.1)",
    "decimate": "Edge collapse with a measured error: for smooth connected surfaces (section 4.2)",
}


@dataclass(frozen=True, kw_only=True)
class FadeSettings(Settings):
    """What a user can choose about levels that fade into each other."""

    fade_range: float = setting(
        0.25,
        "Range of distances over which one level fades into the next, as a share of the distance where it begins; 0 switches at once",
        minimum=0.0,
        maximum=4.0,
        unit=Unit.SHARE,
    )


@dataclass(frozen=True, kw_only=True)
class BillboardSettings(Settings):
    """Settings of the tool `billboards`. Shares are of the longest side of the bounding box."""

    method: str = setting("clusters", "How the planes are found", choices=METHODS)
    error: float = setting(
        0.01,
        "Largest distance between the surface and its quads at the finest level, as a share of the longest side",
        minimum=1e-4,
        maximum=0.25,
        unit=Unit.SHARE,
    )
    levels: int = setting(3, "Number of levels; the error doubles from one to the next", minimum=1, maximum=8, unit=Unit.COUNT)
    quads: int = setting(
        0,
        "Number of quads at the finest level to aim for instead of an error; 0 takes the error",
        minimum=0,
        maximum=100_000,
        unit=Unit.COUNT,
    )
    texture_mb: float = setting(
        0.0,
        "Texture memory of all levels to aim for instead of an error; 0 takes the error",
        minimum=0.0,
        maximum=65_536.0,
        unit=Unit.MEGABYTES,
    )
    max_normal_deviation: float = setting(
        math.radians(60.0),
        "Largest angle between a face and the quad that stands for it",
        minimum=math.radians(5.0),
        maximum=math.radians(90.0),
        unit=Unit.ANGLE,
    )
    max_texture_waste: float = setting(
        8.0, "Largest area of a quad over the area of the faces it stands for", minimum=1.5, maximum=1000.0, unit=Unit.NONE
    )
    texel_error: float = setting(0.5, "Side of a texel as a share of the level's error", minimum=0.05, maximum=4.0, unit=Unit.NONE)
    loose_part_share: float = setting(
        0.5,
        "Share of a quad or texture budget for loose parts such as leaves, when the mesh has both kinds",
        minimum=0.0,
        maximum=1.0,
        unit=Unit.SHARE,
    )
    cutout_corners: int = setting(
        8, "Corners of the polygon that each quad is cut to; 4 keeps the rectangle", minimum=4, maximum=8, unit=Unit.COUNT
    )
    textures: bool = setting(True, "Capture textures from the materials with Cycles")
    samples: int = setting(16, "Cycles samples a texel when textures are captured", minimum=1, maximum=4096, unit=Unit.COUNT)
    seed: int = setting(0, "Seed of random choices", minimum=0, maximum=2**31 - 1)
