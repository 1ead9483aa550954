"""Positions of maps in another coordinate reference system: degrees, UTM and Web Mercator.

WGS 84 and systems of the same ellipsoid or nearly so, such as ETRS89 and NAD83, count as one: they differ by up to two meters. Source: IOGP
Publication 373-7-2, Geomatics Guidance Note 7, part 2 (Transverse Mercator, and the Pseudo Mercator of web maps).
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from .coordinate_systems import GEOGRAPHIC_CODES
from .map_projections import SEMI_MAJOR_AXIS, TransverseMercator
from .placements import Placement

OTHER_ELLIPSOIDS = frozenset({4267})  # geographic systems that are farther away: NAD27
WEB_MERCATOR_CODES = frozenset({3785, 3857})
ZONE_WIDTH, FIRST_MERIDIAN = 6.0, -183.0  # degrees; the central meridian of UTM zone n is n widths east of it
UTM_SCALE, FALSE_EASTING, FALSE_NORTHING = 0.9996, 500_000.0, 10_000_000.0  # meters, the last one in the south
UTM_CODES = {  # zones, and whether they are southern, by code: WGS 84, ETRS89 and NAD83
    **{32600 + zone: (zone, False) for zone in range(1, 61)},
    **{32700 + zone: (zone, True) for zone in range(1, 61)},
    **{25800 + zone: (zone, False) for zone in range(28, 39)},
    **{26900 + zone: (zone, False) for zone in range(1, 24)},
}
MAX_LATITUDE = 89.9  # degrees; Web Mercator has no poles


@dataclass(frozen=True)
class Degrees:
    """Longitudes and latitudes as they are."""

    def project(self, longitudes: np.ndarray, latitudes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the positions on the map, float64, of positions in degrees."""
        return np.asarray(longitudes, np.float64), np.asarray(latitudes, np.float64)

    def unproject(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return longitudes and latitudes in degrees, float64."""
        return np.asarray(x, np.float64), np.asarray(y, np.float64)


@dataclass(frozen=True)
class WebMercator:
    """Mercator projection of a sphere of the larger radius of the Earth, whose positions are those of the ellipsoid."""

    def project(self, longitudes: np.ndarray, latitudes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return meters to the east and to the north, float64, of positions in degrees."""
        latitudes = np.radians(np.clip(np.asarray(latitudes, np.float64), -MAX_LATITUDE, MAX_LATITUDE))
        return SEMI_MAJOR_AXIS * np.radians(np.asarray(longitudes, np.float64)), SEMI_MAJOR_AXIS * np.arcsinh(np.tan(latitudes))

    def unproject(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return longitudes and latitudes in degrees, float64, of positions in meters."""
        east, north = np.asarray(x, np.float64) / SEMI_MAJOR_AXIS, np.asarray(y, np.float64) / SEMI_MAJOR_AXIS
        return np.degrees(east), np.degrees(np.arctan(np.sinh(north)))


@dataclass(frozen=True)
class Utm:
    """Universal Transverse Mercator. zone: 1 to 60. is_south: whether northings count from 10,000 km south of the equator."""

    zone: int
    is_south: bool = False

    def project(self, longitudes: np.ndarray, latitudes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return eastings and northings in meters, float64, of positions in degrees."""
        east, north = self._projection.project(longitudes, latitudes)
        return east + FALSE_EASTING, north + self._false_northing

    def unproject(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return longitudes and latitudes in degrees, float64, of positions in meters."""
        return self._projection.unproject(np.asarray(x, np.float64) - FALSE_EASTING, np.asarray(y, np.float64) - self._false_northing)

    @property
    def _false_northing(self) -> float:
        return FALSE_NORTHING if self.is_south else 0.0

    @cached_property
    def _projection(self) -> TransverseMercator:
        return TransverseMercator(FIRST_MERIDIAN + ZONE_WIDTH * self.zone, UTM_SCALE)


MapProjection = Degrees | WebMercator | Utm


def find_projection(placement: Placement) -> MapProjection | None:
    """Return the projection of a placement, None if it is another one, or unknown. Degrees without a code are those of WGS 84."""
    code = None if placement.code is None else int(placement.code.removeprefix("EPSG:"))
    if placement.is_geographic:
        return Degrees() if code is None or code in GEOGRAPHIC_CODES - OTHER_ELLIPSOIDS else None
    if code in WEB_MERCATOR_CODES:
        return WebMercator()
    return Utm(*UTM_CODES[code]) if code in UTM_CODES else None


def reproject(
    positions: tuple[np.ndarray, np.ndarray], source: MapProjection, target: MapProjection, longitude: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return the positions on another map, float64, of positions (x, y) of any shape.

    longitude: degrees, the center of the other map. Longitudes are moved by whole turns to within 180 degrees of it.
    """
    longitudes, latitudes = source.unproject(*positions)
    return target.project(longitudes - 360.0 * np.rint((longitudes - longitude) / 360.0), latitudes)
