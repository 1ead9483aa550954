"""Transverse Mercator projection of the ellipsoid WGS84, by Krueger's series of the sixth order.

Sources: L. Krueger, Konforme Abbildung des Erdellipsoids in der Ebene, 1912; C. F. F. Karney, Transverse Mercator with an accuracy of a few
nanometers, Journal of Geodesy 85, 2011, equations 7 to 36. Within 35 degrees of longitude of the central meridian the series are exact to
less than a micrometer. The package pyproj knows all projections, but would add 9 MB to the zip of every platform; terrain needs this one.
"""

from dataclasses import dataclass

import numpy as np

SEMI_MAJOR_AXIS = 6378137.0  # meters, WGS84
FLATTENING = 1.0 / 298.257223563
ECCENTRICITY = (FLATTENING * (2.0 - FLATTENING)) ** 0.5
THIRD_FLATTENING = FLATTENING / (2.0 - FLATTENING)
MAX_LONGITUDE_OFFSET = 80.0  # degrees from the central meridian; the projection has a pole at 90 degrees
INVERSE_ROUNDS = 3  # Steps of Newton's method for the latitude; two reach the precision of float64.

# Coefficients of powers of the third flattening, for the sines of 2, 4, ... 12 times the conformal (FORWARD) and rectifying latitudes.
FORWARD_COEFFICIENTS = (  # equation 35; the first column is for THIRD_FLATTENING to the first power
    (1 / 2, -2 / 3, 5 / 16, 41 / 180, -127 / 288, 7891 / 37800),
    (0.0, 13 / 48, -3 / 5, 557 / 1440, 281 / 630, -1983433 / 1935360),
    (0.0, 0.0, 61 / 240, -103 / 140, 15061 / 26880, 167603 / 181440),
    (0.0, 0.0, 0.0, 49561 / 161280, -179 / 168, 6601661 / 7257600),
    (0.0, 0.0, 0.0, 0.0, 34729 / 80640, -3418889 / 1995840),
    (0.0, 0.0, 0.0, 0.0, 0.0, 212378941 / 319334400),
)
INVERSE_COEFFICIENTS = (  # equation 36
    (1 / 2, -2 / 3, 37 / 96, -1 / 360, -81 / 512, 96199 / 604800),
    (0.0, 1 / 48, 1 / 15, -437 / 1440, 46 / 105, -1118711 / 3870720),
    (0.0, 0.0, 17 / 480, -37 / 840, -209 / 4480, 5569 / 90720),
    (0.0, 0.0, 0.0, 4397 / 161280, -11 / 504, -830251 / 7257600),
    (0.0, 0.0, 0.0, 0.0, 4583 / 161280, -108847 / 3991680),
    (0.0, 0.0, 0.0, 0.0, 0.0, 20648693 / 638668800),
)
POWERS = THIRD_FLATTENING ** np.arange(1, 7)
ALPHA, BETA = np.array(FORWARD_COEFFICIENTS) @ POWERS, np.array(INVERSE_COEFFICIENTS) @ POWERS
# Equation 14: the radius of the circle that is as long as a meridian.
RECTIFYING_RADIUS = SEMI_MAJOR_AXIS / (1.0 + THIRD_FLATTENING) * (1.0 + POWERS[1] / 4.0 + POWERS[3] / 64.0 + POWERS[5] / 256.0)


@dataclass(frozen=True)
class TransverseMercator:
    """The projection around a central meridian (degrees). Its scale there is `scale`, 1 for true lengths, 0.9996 for UTM."""

    central_meridian: float
    scale: float = 1.0

    def project(self, longitudes: np.ndarray, latitudes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return meters east of the central meridian and north of the equator, float64, of positions in degrees.

        Longitudes are taken modulo 360. Those farther than MAX_LONGITUDE_OFFSET from the central meridian, and latitudes beyond the poles,
        are moved to these limits, so that every result is finite.
        """
        offsets = np.remainder(np.asarray(longitudes, np.float64) - self.central_meridian + 180.0, 360.0) - 180.0
        offsets = np.radians(np.clip(offsets, -MAX_LONGITUDE_OFFSET, MAX_LONGITUDE_OFFSET))
        tangents = np.tan(np.radians(np.clip(np.asarray(latitudes, np.float64), -90.0, 90.0)))
        conformal = _conformal_tangent(tangents)
        cosines = np.cos(offsets)
        squares = conformal * conformal + cosines * cosines
        north, hyperbolic_sine = np.arctan2(conformal, cosines), np.sin(offsets) / np.sqrt(squares)
        double = (  # trigonometric functions of 2 north and 2 east without further calls of slow functions
            2.0 * conformal * cosines / squares,
            (cosines - conformal) * (cosines + conformal) / squares,
            2.0 * hyperbolic_sine * np.sqrt(1.0 + hyperbolic_sine * hyperbolic_sine),
            1.0 + 2.0 * hyperbolic_sine * hyperbolic_sine,
        )
        sines, cosines = _sum_series(ALPHA, *double)
        factor = self.scale * RECTIFYING_RADIUS
        return factor * (np.arcsinh(hyperbolic_sine) + cosines), factor * (north + sines)

    def unproject(self, eastings: np.ndarray, northings: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return longitudes and latitudes in degrees, float64, of positions in meters: the inverse of `project`.

        Longitudes are within 180 degrees of the central meridian, and may be beyond 180.
        """
        factor = self.scale * RECTIFYING_RADIUS
        east, north = np.asarray(eastings, np.float64) / factor, np.asarray(northings, np.float64) / factor
        sines, cosines = _sum_series(BETA, np.sin(2.0 * north), np.cos(2.0 * north), np.sinh(2.0 * east), np.cosh(2.0 * east))
        east, north = east - cosines, north - sines
        conformal = np.sin(north) / np.hypot(np.sinh(east), np.cos(north))
        longitudes = self.central_meridian + np.degrees(np.arctan2(np.sinh(east), np.cos(north)))
        return longitudes, np.degrees(np.arctan(_geographic_tangent(conformal)))


def _conformal_tangent(tangents: np.ndarray) -> np.ndarray:
    """Return the tangents of conformal latitudes (equations 7 to 9)."""
    secants = np.sqrt(1.0 + tangents * tangents)
    sigma = np.sinh(ECCENTRICITY * np.arctanh(ECCENTRICITY * tangents / secants))
    return tangents * np.sqrt(1.0 + sigma * sigma) - sigma * secants


def _geographic_tangent(conformal: np.ndarray) -> np.ndarray:
    """Return the tangents of latitudes from those of conformal latitudes, by Newton's method (equations 19 to 21)."""
    tangents, ratio = conformal, 1.0 - ECCENTRICITY**2
    for _ in range(INVERSE_ROUNDS):
        found = _conformal_tangent(tangents)
        derivative = ratio * np.hypot(1.0, found) * np.hypot(1.0, tangents) / (1.0 + ratio * tangents**2)
        tangents = tangents + (conformal - found) / derivative
    return tangents


def _sum_series(
    coefficients: np.ndarray, sine: np.ndarray, cosine: np.ndarray, hyperbolic_sine: np.ndarray, hyperbolic_cosine: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the sums of c_j sin(2 j north) cosh(2 j east) and c_j cos(2 j north) sinh(2 j east) (equation 11).

    Args:
        sine, cosine: of 2 north. hyperbolic_sine, hyperbolic_cosine: of 2 east.
    """
    # The sine of the complex number 2 (north + i east) has both sums as its parts
    complex_sine = sine * hyperbolic_cosine + 1j * (cosine * hyperbolic_sine)
    double_cosine = 2.0 * (cosine * hyperbolic_cosine - 1j * (sine * hyperbolic_sine))
    current = following = np.zeros_like(complex_sine)
    for coefficient in coefficients[::-1]:  # Clenshaw's summation
        current, following = coefficient + double_cosine * current - following, current
    total = current * complex_sine
    return total.real, total.imag
