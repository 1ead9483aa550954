"""Settings of refit levels."""

from dataclasses import dataclass

from ...settings import Settings, Unit, setting


@dataclass(frozen=True, kw_only=True)
class RefitSettings(Settings):
    """Settings of the fit of a level to its fine mesh."""

    iterations: int = setting(12, "Moves of vertices and texture coordinates; large levels get fewer", minimum=1, maximum=100)
    samples_per_triangle: int = setting(
        8, "Points of the fine mesh per triangle of the level, to which it is fitted", minimum=4, maximum=100
    )
    normal_weight: float = setting(
        8.0,
        "How much a squared deviation of the surface counts, relative to one of the texture along the surface",
        minimum=1.0,
        maximum=1000.0,
    )
    peak_weight: float = setting(
        1.0, "How much more the places count where the surface deviates most; 0 for the smallest mean", minimum=0.0, maximum=10.0
    )
    split_fraction: float = setting(
        0.05,
        "Of the triangles of a level, those that are added where the surface deviates most",
        minimum=0.0,
        maximum=0.5,
        unit=Unit.FRACTION,
    )
