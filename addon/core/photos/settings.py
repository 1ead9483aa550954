"""Settings of the tool `photos`."""

from dataclasses import dataclass
from functools import partial

from ..settings import Choice, Settings, setting

METHODS = {
    "best": Choice("Best Photograph", "Texture each face from the photograph that shows it best, and blend between neighbors. Sharpest"),
    "average": Choice("Average", "Average all photographs, weighted by resolution, angle and distance from borders"),
    "paper": Choice(
        "Paper", "Average photographs by the cosine of the viewing angle on triangles that they show wholly, and blend the borders"
    ),
}
BLENDINGS = {
    "none": Choice("None", "Blend over one face"),
    "level": Choice("Level", "Correct the colors of regions at their vertices so that they meet without a seam"),
    "spline": Choice("Multi-Resolution", "Blend in frequency bands: coarse ones over long distances, fine ones over short distances"),
    "poisson": Choice("Poisson", "Keep the gradients of photographs, and spread differences between regions"),
}
FILLS = {
    "none": Choice("None", "Leave what no photograph shows transparent"),
    "interpolate": Choice("Interpolate", "Interpolate colors over the surface"),
    "restore": Choice("Restore", "Continue the texture around each hole over the surface, and interpolate what is too small or too large"),
}
MATERIALS = {
    "replace": Choice("Replace", "One texture and one new material for everything"),
    "keep": Choice("Keep", "A texture for each material, as the base color of a copy of it; UV maps may overlap those of other materials"),
}
BACKGROUNDS = {
    "none": Choice("None", "Use the photographs up to the silhouettes of the mesh"),
    "auto": Choice("Automatic", "Leave out the color of the border of each photograph, where that is uniform"),
    "border": Choice("Border", "Leave out the color of the border of each photograph, which may change smoothly across it"),
    "color": Choice("Color", "Leave out one color"),
}

of_photographs = partial(setting, group="Photographs")


@dataclass(frozen=True, kw_only=True)
class PhotosSettings(Settings):
    """Settings of a texture from photographs."""

    size: int = setting(4096, "Pixels per side of the texture", minimum=16, maximum=32768)
    method: str = setting("average", "How photographs are combined", choices=METHODS)
    blending: str = setting(
        "level", "How regions from different photographs are made to meet without a seam", choices=BLENDINGS, used_if={"method": ("best",)}
    )
    fill: str = setting("interpolate", "What fills the parts that no photograph shows", choices=FILLS)
    materials: str = setting("replace", "What happens to the materials of the meshes", choices=MATERIALS)
    exposure: bool = of_photographs(True, "Adjust the brightness and color balance of the photographs to each other")
    gamma: bool = of_photographs(False, "Adjust the contrast of the photographs to each other, too", used_if={"exposure": True})
    vignetting: bool = of_photographs(False, "Correct photographs that are darker towards their corners", used_if={"exposure": True})
    alignment: bool = of_photographs(
        False, "Warp the photographs a little, so that they show details at the same places. For cameras that are some pixels off"
    )
    reduce_highlights: bool = of_photographs(
        False, "Give photographs less weight where they are brighter than others, against highlights that move with the camera"
    )
    sharpen: bool = of_photographs(True, "Bring back detail that resampling has blurred", used_if={"method": ("best", "average")})
    background: str = of_photographs(
        "none", "Which pixels show the background: none of them may appear near silhouettes", choices=BACKGROUNDS
    )
    background_color: tuple = of_photographs(
        (0.5, 0.5, 0.5), "Color of the background, as displayed", is_color=True, panel_label="Color", used_if={"background": ("color",)}
    )
    background_threshold: float = of_photographs(
        0.0,
        "How far the color of the background may vary, 0 for automatic",
        minimum=0.0,
        maximum=1.0,
        panel_label="Threshold",
        used_if={"background": ("auto", "border", "color")},
    )
