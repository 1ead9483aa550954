"""Names of directions and images as in the BTF databases of Bonn and UTIA."""

import numpy as np

from ...errors import SettingsError
from ...geometry.directions import to_spherical


def direction_names(directions: np.ndarray, letter: str) -> list[str]:
    """Return one name for each of the unit `directions` (N, 3): `tv030_pv060` for 30 degrees from +Z and azimuth 60, with `letter` v.

    letter: v for views, l for lights. Degrees are rounded to integers, as readers expect.

    Raises:
        SettingsError: two directions would have the same name.
    """
    degrees = np.rint(np.degrees(to_spherical(directions))).astype(int) % [360, 360]
    names = [f"t{letter}{polar:03d}_p{letter}{azimuth:03d}" for polar, azimuth in degrees]
    if len(set(names)) < len(names):
        raise SettingsError(
            "Some directions are less than a degree apart and would get the same file name; set Directions to Bonn.", ("directions",)
        )
    return names


def format_direction_list(directions: np.ndarray) -> str:
    """Return a text with one line for each of the unit `directions` (N, 3): number from 1 on, degrees from +Z, azimuth in degrees."""
    degrees = np.degrees(to_spherical(directions))
    return "".join(f"{number} {polar:.6f} {azimuth:.6f}\n" for number, (polar, azimuth) in enumerate(degrees, 1))
