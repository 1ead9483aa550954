"""Settings of the tool `distance`."""

from dataclasses import dataclass

from ..settings import Settings, Unit, setting


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
    perceptual_levels: bool = setting(True, "Make perceptual levels, meshes with fewer triangles")
    billboard_cloud: bool = setting(True, "Make a billboard cloud, a few quads with images of the original, for far away")
