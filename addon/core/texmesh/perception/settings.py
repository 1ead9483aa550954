"""Settings of perception: which differences are visible."""

from dataclasses import dataclass

from ...settings import Choice, Settings, Unit, setting

PERCEPTUAL_VALUES = {
    "cross_section": Choice("Cross-Section", "Displacement relative to the length of the object in its direction, as in the paper"),
    "center": Choice("Center", "Displacement relative to the distance from the center of the object"),
    "skeleton": Choice("Skeleton", "Displacement relative to half the thickness of the object"),
    "quadric": Choice("Quadric", "Square root of the quadric error, relative to the length of the object in the direction"),
}


@dataclass(frozen=True, kw_only=True)
class PerceptionSettings(Settings):
    """Settings that decide which changes of a mesh are visible."""

    pixels_per_degree: float = setting(
        67.0,
        "Pixels of the display within one degree of the viewer's visual field",
        minimum=5.0,
        maximum=300.0,
        group="Perception",
    )
    max_difference: float = setting(
        0.04,
        "Largest mean FLIP difference over the pixels of the object where levels switch",
        minimum=0.001,
        maximum=0.5,
        group="Perception",
    )
    max_local_difference: float = setting(
        0.2,
        "Largest FLIP difference of all but 5% of the object's pixels where levels switch",
        minimum=0.001,
        maximum=1.0,
        group="Perception",
    )
    views: int = setting(
        8,
        "Views around the object in which levels are compared",
        minimum=1,
        maximum=64,
        unit=Unit.COUNT,
        group="Perception",
    )
    max_image: int = setting(
        512,
        "Pixels of the largest image of the object in which levels are compared",
        minimum=16,
        maximum=2048,
        unit=Unit.COUNT,
        group="Perception",
    )
    is_lit: bool = setting(True, "Compare shaded images, in which the shape of the surface counts", label="Shaded", group="Perception")
    weber_threshold: float = setting(
        0.096,
        "Weber fraction above which a change of shape is noticed. The paper measured 0.096",
        minimum=0.001,
        maximum=1.0,
        group="Perception",
    )
    perceptual_value: str = setting("cross_section", "How much a change of shape is seen", choices=PERCEPTUAL_VALUES, group="Perception")
