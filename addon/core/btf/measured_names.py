"""Names of directions and pictures as the measured textures of the Bonn and UTIA databases have them."""

import numpy as np

from ..directions import to_spherical
from ..errors import SettingsError


def direction_names(directions: np.ndarray, letter: str) -> list[str]:
    """One name for each of unit `directions` (N, 3): `tv030_pv060` for 30 degrees from +Z and 60 around it, with `letter` v.

    letter: v for views, l for lights. Degrees are whole, as readers expect.

    Raises:
        SettingsError: when two directions would have one name.
    """
    degrees = np.rint(np.degrees(to_spherical(directions))).astype(int) % [360, 360]
    names = [f"t{letter}{polar:03d}_p{letter}{turn:03d}" for polar, turn in degrees]
    if len(set(names)) < len(names):
        raise SettingsError("Some of these directions are less than a degree apart and would share a name; take the directions of Bonn.")
    return names


def direction_list(directions: np.ndarray) -> str:
    """A text with a line for each of unit `directions` (N, 3): its number from 1 on, degrees from +Z, degrees around it."""
    degrees = np.degrees(to_spherical(directions))
    return "".join(f"{number} {polar:.6f} {turn:.6f}\n" for number, (polar, turn) in enumerate(degrees, 1))
