"""How *Drop to Ground* places objects on terrain."""

from dataclasses import dataclass

from .settings import Choice, Settings, Unit, setting

TARGETS = {
    "origins": Choice("Origins", "Put the origins of the selected objects on the ground"),
    "bottoms": Choice("Bottoms", "Put the centers of the lower sides of bounding boxes on the ground"),
    "points": Choice("Points", "Put all vertices of the selected meshes and all points of the selected point clouds on the ground"),
}


@dataclass(frozen=True, kw_only=True)
class PlacingSettings(Settings):
    """How *Drop to Ground* places objects."""

    has_flags = False

    target: str = setting("origins", "What is put on the ground", choices=TARGETS)
    align_to_normal: bool = setting(
        False, "Rotate objects until their Z axes are perpendicular to the ground", used_if={"target": ("origins", "bottoms")}
    )
    offset: float = setting(0.0, "Height above the ground", minimum=-1e6, maximum=1e6, unit=Unit.LENGTH)
