"""Settings of the tool `distance`."""

from dataclasses import dataclass, replace

from ..settings import Choice, Settings, Unit, setting

METHODS = {
    "automatic": Choice("Automatic", "Levels and a cloud, as in the settings"),
    "levels": Choice("Perceptual Levels", "Meshes with fewer triangles only"),
    "cloud": Choice("Billboard Cloud", "A few quads with images only"),
    "original": Choice("Original", "It stays as it is"),
}


@dataclass(frozen=True, kw_only=True)
class DistanceSettings(Settings):
    """How a scene is made ready for any distance."""

    max_error: float = setting(
        1.0,
        "Largest size, in pixels of a render, of what a level leaves out. Larger values show lighter levels nearer",
        minimum=0.25,
        maximum=16.0,
    )
    fade_range: float = setting(
        0.0,
        "Distance range of the cross-fade to the next level in renders, relative to the distance where it starts; 0 switches instantly, "
        "which takes less time and memory",
        minimum=0.0,
        maximum=2.0,
        unit=Unit.FRACTION,
    )
    min_triangles: int = setting(500, "Objects with fewer triangles stay as they are", minimum=0, maximum=1_000_000_000)
    perceptual_levels: bool = setting(
        True,
        "Make meshes with fewer triangles: decimated ones, perceptual levels where these stay heavy, foliage with fewer and larger leaves",
    )
    billboard_cloud: bool = setting(
        True, "Make a billboard cloud, a few quads with images of the original, where meshes stay heavy far away"
    )
    triangle_budget: int = setting(
        0,
        "Largest number of triangles that levels have together in any image. Max Error is raised until they fit. 0 is no limit",
        minimum=0,
        maximum=2_000_000_000,
        group="Budget",
        panel_label="Triangles",
    )
    texture_budget: float = setting(
        0.0,
        "Memory in megabytes of all images that levels need for any frame. Max Error is raised until they fit. 0 is no limit",
        minimum=0.0,
        maximum=1e6,
        group="Budget",
        panel_label="Textures (MB)",
    )
    seconds_budget: float = setting(
        0.0,
        "Seconds that Cycles may take for a frame on this computer. Max Error is raised until a trial render of one frame is that fast. "
        "0 is no limit",
        minimum=0.0,
        maximum=1e6,
        group="Budget",
        panel_label="Seconds",
    )


@dataclass(frozen=True)
class AssetOptions:
    """What differs for one object. method: one of `METHODS`. error_factor: of *Max Error*."""

    method: str = "automatic"
    error_factor: float = 1.0

    def adjust(self, settings: DistanceSettings) -> DistanceSettings:
        """Return the settings of the levels of the object."""
        if self.method in {"levels", "cloud"}:
            return replace(settings, perceptual_levels=self.method == "levels", billboard_cloud=self.method == "cloud")
        return settings
