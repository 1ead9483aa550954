"""Settings of the analysis in scale space."""

from dataclasses import dataclass

from ...settings import Choice, Settings, Unit, setting

MODES = {
    "surface": Choice("Surface", "Diffuse curvature and texture on the surface; for meshes of any shape"),
    "paper": Choice("Range Image", "Filter the distance from an axis, as in the paper; for shapes without overhangs around the axis"),
}
AXES = {
    "x": Choice("X", "Parallel to the X axis"),
    "y": Choice("Y", "Parallel to the Y axis"),
    "z": Choice("Z", "Parallel to the Z axis, upwards"),
}


@dataclass(frozen=True, kw_only=True)
class ScaleSpaceSettings(Settings):
    """Settings of the analysis in scale space."""

    mode: str = setting("surface", "How features are found", label="Analysis", choices=MODES, group="Analysis")
    axis: str = setting("z", "Axis through the center of a range image", choices=AXES, group="Analysis")
    texture_weight: float = setting(
        0.5,
        "Weight of features of the texture. 0% for the shape alone, 50% for both alike, 100% for the texture alone",
        minimum=0.0,
        maximum=1.0,
        unit=Unit.FRACTION,
        group="Analysis",
    )
    convergence: float = setting(
        0.25,
        "Range of the filtered signal at the coarsest scale, relative to the largest. Smaller values give larger scales",
        minimum=0.001,
        maximum=0.9,
        unit=Unit.FRACTION,
        group="Analysis",
    )
    noise: float = setting(
        0.01,
        "Strength of the weakest feature on a surface, relative to the range of the signal",
        minimum=0.0,
        maximum=0.5,
        unit=Unit.FRACTION,
        group="Analysis",
    )
    spacing: float = setting(
        1.0,
        "Distance between features on a surface, relative to the scale; closer ones that are weaker end at a lower scale. "
        "0 to keep all, as in the paper",
        minimum=0.0,
        maximum=4.0,
        group="Analysis",
    )
