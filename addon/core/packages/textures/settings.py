"""Settings of the textures of packages."""

from dataclasses import dataclass

from ...settings import Settings, Unit, setting


@dataclass(frozen=True, kw_only=True)
class TextureSettings(Settings):
    """How textures are coded, and for which images."""

    tile_size: int = setting(512, "Side of the tiles of textures in pixels, a multiple of 16", minimum=16, maximum=1024, unit=Unit.COUNT)
    quality: int = setting(80, "AVIF quality of complete textures", minimum=1, maximum=100, unit=Unit.COUNT)
    pixels: int = setting(
        512,
        "Size of the object in images, in pixels, for which the order of textures is best",
        minimum=16,
        maximum=4096,
        unit=Unit.COUNT,
    )
    views: int = setting(
        24, "Views from all around in which the visibility of textures is measured", minimum=1, maximum=256, unit=Unit.COUNT
    )
    pixels_per_degree: float = setting(
        67.0, "Pixels of the display within one degree of the viewer's visual field", minimum=5.0, maximum=300.0
    )
    feature_weight: float = setting(
        0.0, "Weight of features of the surface for the order of tiles; 0 for images alone", minimum=0.0, maximum=10.0
    )
