"""Settings of the tool `photos`."""

from dataclasses import dataclass

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


@dataclass(frozen=True, kw_only=True)
class PhotosSettings(Settings):
    """Settings of a texture from photographs."""

    size: int = setting(4096, "Pixels per side of the texture", minimum=16, maximum=32768)
    method: str = setting("average", "How photographs are combined", choices=METHODS)
    exposure: bool = setting(True, "Adjust the brightness and color balance of the photographs to each other")
    blending: str = setting(
        "level", "How regions from different photographs are made to meet without a seam. Used by Best Photograph", choices=BLENDINGS
    )
    sharpen: bool = setting(True, "Bring back detail that resampling has blurred")
    alignment: bool = setting(
        False, "Warp the photographs a little, so that they show details at the same places. For cameras that are some pixels off"
    )
    fill: str = setting("interpolate", "What fills the parts that no photograph shows", choices=FILLS)
    materials: str = setting("replace", "What happens to the materials of the meshes", choices=MATERIALS)
