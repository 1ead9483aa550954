"""Settings of what helps to judge levels; they change no result."""

from dataclasses import dataclass

from ..settings import Settings, Unit, setting
from .scale_space.scale_map import SCALES


@dataclass(frozen=True, kw_only=True)
class InspectionSettings(Settings):
    """How features and levels are shown."""

    lowest_scale: int = setting(
        1, "Scale at which the smallest colored features end", minimum=0, maximum=SCALES - 1, unit=Unit.COUNT, group="Inspect"
    )
    flicker_seconds: float = setting(0.5, "Seconds between two levels", minimum=0.1, maximum=10.0, label="Flicker Time", group="Inspect")
