"""Settings of the tool `texmesh`: what an artist sets, and research controls, which most levels need as they are.

`TexmeshSettings` has both.
"""

from dataclasses import dataclass
from functools import partial
from typing import ClassVar

from ..settings import Choice, Settings, Unit, setting
from .scale_space.features import SCALES

VERTICES = {
    "optimized": Choice("Optimized", "Positions and texture coordinates are moved to deviate least from the original"),
    "original": Choice("Original", "Vertices are those of the original, unmoved: levels can be sent one after the other"),
}
LEVELS = {
    "perceptual": Choice("Perceptual", "All levels that look different from each other"),
    "number": Choice("Number", "A number of levels"),
    "triangles": Choice("Triangles", "Levels with a total number of triangles"),
    "size": Choice("File Size", "Levels with a total size as quantized geometry"),
    "pixels": Choice("Pixels", "Levels for an object that is never seen larger than a number of pixels"),
    "ratios": Choice("Ratios", "Levels with fractions of the triangles"),
}
REMOVAL_ORDERS = {
    "visibility": Choice("Visibility", "What changes shape and texture least first; features of coarse scales count more"),
    "scale": Choice("Scale", "By the last scale at which vertices are features, as in the paper"),
}
ANALYSES = {
    "surface": Choice("Surface", "Diffuse curvature and texture on the surface; for meshes of any shape"),
    "range_image": Choice("Range Image", "Filter the distance from an axis, as in the paper; for shapes without overhangs around the axis"),
}
AXES = {
    "x": Choice("X", "Parallel to the X axis"),
    "y": Choice("Y", "Parallel to the Y axis"),
    "z": Choice("Z", "Parallel to the Z axis, upwards"),
}
PERCEPTUAL_VALUES = {
    "cross_section": Choice("Cross-Section", "Displacement relative to the length of the object in its direction, as in the paper"),
    "center": Choice("Center", "Displacement relative to the distance from the center of the object"),
    "skeleton": Choice("Skeleton", "Displacement relative to half the thickness of the object"),
    "quadric": Choice("Quadric", "Square root of the quadric error, relative to the length of the object in the direction"),
}
RESEARCH_GROUP = "Research"

of_research = partial(setting, group=RESEARCH_GROUP)
of_surface = partial(of_research, used_if={"analysis": ("surface",)})
of_comparison = partial(setting, group="Comparison")


@dataclass(frozen=True, kw_only=True)
class LevelSettings(Settings):
    """Which levels of detail are made."""

    vertices: str = setting("optimized", "Which vertices levels have", choices=VERTICES)
    levels: str = setting("perceptual", "What determines the levels", choices=LEVELS)
    number: int = setting(4, "Number of levels, the original included", minimum=2, maximum=24, used_if={"levels": ("number",)})
    max_triangles: int = setting(
        100_000,
        "Triangles of all levels together, without the original",
        minimum=4,
        maximum=1_000_000_000,
        used_if={"levels": ("triangles",)},
    )
    max_size: float = setting(
        1.0,
        "Size of all levels together, without the original and textures",
        minimum=1e-3,
        maximum=1e5,
        used_if={"levels": ("size",)},
    )
    max_pixels: int = setting(
        512, "Largest size of the object in images, in pixels", minimum=8, maximum=2048, used_if={"levels": ("pixels",)}
    )
    ratios: str = setting("0.5,0.25,0.125", "Fractions of the triangles of the original, one per level", used_if={"levels": ("ratios",)})
    drastic_simplification: bool = setting(
        True,
        "If a triangle count cannot be reached otherwise: ignore folds of small triangles, seams of normals and colors; drop thin"
        " UV islands and small components; close holes and tunnels",
    )
    max_difference: float = of_comparison(
        0.04, "Largest mean FLIP difference over the pixels of the object where levels switch", minimum=0.001, maximum=0.5
    )
    max_local_difference: float = of_comparison(
        0.2,
        "Largest FLIP difference of all but 5% of the object's pixels where levels switch",
        minimum=0.001,
        maximum=1.0,
        panel_label="Max Local",
    )
    shaded: bool = of_comparison(True, "Compare shaded images, in which the shape of the surface counts")


@dataclass(frozen=True, kw_only=True)
class AnalysisSettings(Settings):
    """How features are found in scale space."""

    analysis: str = of_research("surface", "How features are found", choices=ANALYSES)
    axis: str = of_research("z", "Axis through the center of a range image", choices=AXES, used_if={"analysis": ("range_image",)})
    texture_weight: float = of_surface(
        0.5,
        "Weight of features of the texture. 0% for the shape alone, 50% for both alike, 100% for the texture alone",
        minimum=0.0,
        maximum=1.0,
        unit=Unit.FRACTION,
    )
    convergence: float = of_research(
        0.25,
        "Range of the filtered signal at the coarsest scale, relative to the largest. Smaller values give larger scales",
        minimum=0.001,
        maximum=0.9,
        unit=Unit.FRACTION,
    )
    noise: float = of_surface(
        0.01,
        "Strength of the weakest feature on a surface, relative to the range of the signal",
        minimum=0.0,
        maximum=0.5,
        unit=Unit.FRACTION,
    )
    spacing: float = of_surface(
        1.0,
        "Distance between features on a surface, relative to the scale; closer ones that are weaker end at a lower scale. "
        "0 to keep all, as in the paper",
        minimum=0.0,
        maximum=4.0,
    )


@dataclass(frozen=True, kw_only=True)
class ResearchSettings(AnalysisSettings):
    """How features are found, vertices are removed and levels are compared."""

    depends_on: ClassVar[tuple[type[Settings], ...]] = (LevelSettings,)

    removal_order: str = of_research("visibility", "In which order vertices are removed", choices=REMOVAL_ORDERS)
    protected_fraction: float = of_research(
        0.5,
        "Fraction of vertices that are kept regardless of scale because removing them would be most visible; 0 for the order of scales"
        " alone",
        minimum=0.0,
        maximum=0.95,
        unit=Unit.FRACTION,
        panel_label="Protected",
        used_if={"removal_order": ("scale",)},
    )
    drastic_size: float = of_research(
        1.0,
        "Size of parts that drastic simplification drops or closes, relative to the mean edge length of a mesh with the intended triangle"
        " count",
        minimum=0.0,
        maximum=10.0,
        used_if={"drastic_simplification": True},
    )
    pixels_per_degree: float = of_research(
        67.0,
        "Pixels of the display within one degree of the viewer's visual field",
        minimum=5.0,
        maximum=300.0,
        panel_label="Pixels / Degree",
    )
    views: int = of_research(8, "Views around the object in which levels are compared", minimum=1, maximum=64)
    max_image: int = of_research(512, "Pixels of the largest image of the object in which levels are compared", minimum=16, maximum=2048)
    weber_threshold: float = of_research(
        0.096, "Weber fraction above which a change of shape is noticed. The paper measured 0.096", minimum=0.001, maximum=1.0
    )
    distance_factor: float = of_research(
        1.0,
        "Factor of the distances from which levels are shown, relative to those where FLIP sees no difference. The answers of a calibration"
        " tell it",
        minimum=0.1,
        maximum=10.0,
    )
    perceptual_value: str = of_research(
        "cross_section", "How much a change of shape is seen", choices=PERCEPTUAL_VALUES, panel_label="Perception"
    )


@dataclass(frozen=True, kw_only=True)
class TexmeshSettings(LevelSettings, ResearchSettings):
    """All settings that levels depend on."""


@dataclass(frozen=True, kw_only=True)
class SceneSettings(Settings):
    """What happens in the scene when levels are made."""

    cross_fade: bool = setting(True, "Cross-fade the levels for the active camera", label="Cross-Fade")
    fade_range: float = setting(
        0.2,
        "Distance range of the cross-fade to the next level, relative to the distance where it starts; 0 switches instantly",
        minimum=0.0,
        maximum=2.0,
        unit=Unit.FRACTION,
        used_if={"cross_fade": True},
    )
    keep_original_visible: bool = setting(False, "Keep the original visible in addition to its levels")
    billboard_cloud: bool = setting(False, "Append a billboard cloud, a few quads with images of the original, as the last level")
    cloud_quads: int = setting(
        64, "Target number of quads of the billboard cloud", minimum=2, maximum=1000, used_if={"billboard_cloud": True}
    )


@dataclass(frozen=True, kw_only=True)
class ExportSettings(Settings):
    """How levels are written as .glb files."""

    one_file: bool = setting(False, "Write one file in which levels replace each other (MSFT_lod), instead of one file per level")
    quantized: bool = setting(True, "Store positions and texture coordinates in 16 bits, normals in 8 bits")
    compressed: bool = setting(False, "Compress meshes (EXT_meshopt_compression)")
    rebake_textures: bool = setting(
        True,
        "Give each level images as small as its distance allows, with normals for its own surface, where that saves bytes",
        used_if={"one_file": False},
    )
    webp: bool = setting(False, "Store images as WebP (EXT_texture_webp), with loss, where that saves bytes", label="WebP")


@dataclass(frozen=True, kw_only=True)
class InspectionSettings(Settings):
    """How features and levels are shown; they change no result."""

    has_flags: ClassVar[bool] = False

    lowest_scale: int = setting(1, "Scale at which the smallest colored features end", minimum=0, maximum=SCALES - 1, group="Inspect")
    flicker_time: float = setting(0.5, "Seconds between two levels", minimum=0.1, maximum=10.0, group="Inspect")
