"""Light of the Sun and haze of the air for landscapes."""

import math
from dataclasses import dataclass

import numpy as np

from .settings import Choice, Settings, Unit, setting

LIGHTS = {
    "midday": Choice("Midday", "A high Sun and clear air"),
    "morning": Choice("Late Morning", "A Sun that reaches the floors of canyons, and clear air"),
    "afternoon": Choice("Afternoon", "A Sun that models the ground with its shadows"),
    "golden_hour": Choice("Golden Hour", "A low, warm Sun with long shadows"),
    "overcast": Choice("Overcast", "Light from all of the sky"),
}
# Optical depth of the air at the zenith for red, green and blue: scattering by molecules at sea level, and some by dust.
OPTICAL_DEPTH = np.array([0.11, 0.17, 0.30])


@dataclass(frozen=True, kw_only=True)
class SkySettings(Settings):
    """Settings of Sun, sky and haze."""

    light: str = setting("afternoon", "Time of day and weather", choices=LIGHTS)
    sun_direction: float = setting(
        math.radians(235.0), "Where the Sun is, clockwise from the Y axis", minimum=0.0, maximum=2.0 * math.pi, unit=Unit.ANGLE
    )
    clouds: float = setting(0.35, "How much of the sky clouds cover", minimum=0.0, maximum=1.0, unit=Unit.FRACTION)
    haze: float = setting(
        0.2, "How much of the light of the farthest ground the air replaces by its own", minimum=0.0, maximum=0.99, unit=Unit.FRACTION
    )


@dataclass(frozen=True)
class Light:
    """Light of a time of day.

    Attributes:
        elevation: of the Sun above the horizon, radians.
        energy: of a Sun light above the air, as Blender's strength, W/m².
        angle: diameter of the Sun, radians.
        sky: factor of the radiance of the sky.
        dust: density of dust in the sky, 1 is that of clear air.
    """

    elevation: float
    energy: float
    angle: float
    sky: float
    dust: float

    @property
    def color(self) -> np.ndarray:
        """Linear color (3,) of sunlight through the air, of which the largest value is 1."""
        transmitted = self._transmitted
        return transmitted / transmitted.max()

    @property
    def strength(self) -> float:
        """Strength of a Sun light through the air, W/m²."""
        return self.energy * float(self._transmitted.max())

    @property
    def _transmitted(self) -> np.ndarray:
        """The fraction (3,) of sunlight that passes through the air, by the relative air mass of Kasten and Young, 1989."""
        degrees = math.degrees(self.elevation)
        air_mass = 1.0 / (math.sin(self.elevation) + 0.50572 * (degrees + 6.07995) ** -1.6364)
        return np.exp(-OPTICAL_DEPTH * air_mass)


LIGHT_VALUES = {
    "midday": Light(math.radians(58.0), 8.4, math.radians(0.53), 1.0, 1.0),
    "morning": Light(math.radians(46.0), 8.8, math.radians(0.53), 1.0, 1.0),
    "afternoon": Light(math.radians(32.0), 9.2, math.radians(0.53), 1.0, 1.2),
    "golden_hour": Light(math.radians(8.0), 12.0, math.radians(0.6), 1.3, 1.6),
    "overcast": Light(math.radians(50.0), 1.0, math.radians(60.0), 1.3, 6.0),
}
