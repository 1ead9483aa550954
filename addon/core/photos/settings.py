"""Settings of the tool `photos`."""

from dataclasses import dataclass

from ..settings import Choice, Settings, setting

METHODS = {
    "best": Choice("Best Photograph", "Texture each face from the photograph that shows it best, and blend between neighbors. Sharpest"),
    "average": Choice("Average", "Average all photographs, weighted by resolution, angle and distance from borders"),
    "paper": Choice("Cosine", "Average all photographs, weighted by the cosine of the angle between normal and view direction"),
}
FILLS = {
    "none": Choice("None", "Leave what no photograph shows transparent"),
    "interpolate": Choice("Interpolate", "Interpolate colors over the surface"),
    "restore": Choice("Restore", "Continue the texture around each hole over the surface, and interpolate what is too small or too large"),
}


@dataclass(frozen=True, kw_only=True)
class PhotosSettings(Settings):
    """Settings of a texture from photographs."""

    size: int = setting(4096, "Pixels per side of the texture", minimum=16, maximum=32768)
    method: str = setting("average", "How photographs are combined", choices=METHODS)
    exposure: bool = setting(True, "Adjust the brightness and color balance of the photographs to each other")
    alignment: bool = setting(
        False, "Warp the photographs a little, so that they show details at the same places. For cameras that are some pixels off"
    )
    leveling: bool = setting(True, "Correct colors so that regions from different photographs meet without a seam. Used by Best Photograph")
    fill: str = setting("interpolate", "What fills the parts that no photograph shows", choices=FILLS)
