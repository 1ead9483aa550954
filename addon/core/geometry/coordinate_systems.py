"""Units of coordinate reference systems by their EPSG code, and from text in WKT (OGC 01-009, Coordinate Transformation Services).

Maps may name a system without its unit. The tables hold all projected systems of the EPSG Geodetic Parameter Dataset 11.022 that are not in
meters, common ones in degrees, which some files name as if they were projected, and the projections whose scale depends on the latitude
alone.
"""

import math
import re
from dataclasses import dataclass

from .map_projections import SEMI_MAJOR_AXIS

FOOT, SURVEY_FOOT = 0.3048, 1200.0 / 3937.0  # meters

# Ranges of codes "first-last", "first-last/step" for every step-th code. Ranges may contain codes that no system has.
SURVEY_FOOT_CODES = (
    "2155 2194 2204 2225-2250 2254-2263/3 2255-2267/3 2259-2262 2268-2277/3 2272-2278/2 2275-2279 2283-2289 2870-2895 2899-2911/3 "
    "2900-2906/2 2903-2907 2912-2918/3 2916-2920 2924-2930 2964-2968 3089 3091 3102 3363 3365 3404 3417-3438 3441-3446 3451-3459 3485 3487 "
    "3490-3512/2 3515-3553/2 3560-3570 3582-3586/2 3598 3600 3608-3632/2 3640 3642 3650-3654/2 3658-3664/2 3668-3674/2 3677-3686/3 "
    "3688-3692/2 3696-3700/2 3728-3739 3753-3760 3991-3992 4217 4399-4413 4418-4433 4438-4457 5623-5625 5646 5654-5655 6200-6202 6411 6413 "
    "6416-6438/2 6441-6479/2 6484-6492/2 6501-6507/2 6510 6517-6543/2 6549-6555/2 6563 6565 6568 6572-6578/2 6582-6590/2 6593-6609/2 "
    "6612-6618/2 6625-6627 6633 6880 6923 6925 6966 6997 7057-7070 7128 7132 7258-7370/2 7587-7645 8035-8036 8091 8093 8096-8182/2 8177 "
    "8185 8189 8193 8197 8200-8210/2 8213 8216 8220 8224 8226 8380-8384/2 8387 8518-8540 9748-9749 10481-10516 10622 23301-23333 "
    "26729-26813 26847-26870 32001-32058 32064-32077 32099 32164-32167 32664-32667"
)
FOOT_CODES = (
    "2222-2224 2251-2253 2256 2265-2266 2269-2270 2273 2280-2282 2867-2869 2896-2898 2901 2909-2910 2913-2914 2921-2923 2992 2994 3080 "
    "3359 3361 3479-3483/2 3588 3590 3593 3605 3634 3636 3644-3648/2 3656 3676-3682/3 5588 6128-6141 6391 6405-6409/2 6494 6496 6499 6515 "
    "6545 6547 6557-6561/2 6570 6785-6863/2 6868 6885 6887 7119-7127 8065-8068 8312-8348/2 20050"
)
UNIT_CODES = {  # codes by meters per unit
    SURVEY_FOOT: SURVEY_FOOT_CODES,
    FOOT: FOOT_CODES,
    0.3047972654: "2314 3407 5589 24100",  # feet of Clarke, of the Gold Coast, of Sears
    0.304799710182: "2136 2159-2160",
    0.304799471539: "29872",
    0.914398530744: "24370-24374 24382",  # yards of India, of Sears, of Clarke
    0.914398414616: "27291-27292",
    0.9143917962: "5472",
    0.201166195164: "2066 30200",  # links
    0.201168: "3139-3140",
    20.116756: "3167",  # chains
    20.116782494376: "24571",
    20.116765121553: "29871",
    1.0000135965: "29371-29385",  # German legal meters
    1000.0: "22300",
}
GEOGRAPHIC_CODES = frozenset({4258, 4267, 4269, 4283, 4326, 4490, 4612, 4617, 4674, 4979, 6318, 7844, 9000, 9057})
GRAD_CODES = frozenset({4807, 4810, 4811, 4816, 4819, 4821, 4901, 4902})  # geographic systems in grads
DEGREES_PER_GRAD = 0.9
MERCATOR_CODES = frozenset({"EPSG:3395", "EPSG:3785", "EPSG:3857"})  # their scale is 1 at the equator only
WEB_MERCATOR = "EPSG:3857"
WEB_MERCATOR_NAME = re.compile(r"pseudo.mercator|web.mercator|popular.visuali[sz]ation|mercator.auxiliary.sphere", re.IGNORECASE)
VERTICAL_CODES = {  # meters per unit of heights that are not in meters
    **dict.fromkeys((5702, 6358, 6359, 6360, 8052, 8053), SURVEY_FOOT),
    **dict.fromkeys((5614, 6130, 6131, 6132, 8050, 8051, 8228, 8897), FOOT),
}
LENGTH_UNITS = {  # by name, in lower case without punctuation, in American spelling
    **dict.fromkeys(("m", "meter", "meters"), 1.0),
    **dict.fromkeys(("ft", "foot", "feet", "international foot", "international feet", "ft int", "ft intl"), FOOT),
    **dict.fromkeys(("us survey foot", "us survey feet", "us ft", "ft us", "ftus", "sft", "survey foot", "foot us"), SURVEY_FOOT),
    **dict.fromkeys(("km", "kilometer", "kilometers"), 1000.0),
    **dict.fromkeys(("dm", "decimeter", "decimeters"), 0.1),
    **dict.fromkeys(("cm", "centimeter", "centimeters"), 0.01),
    **dict.fromkeys(("mm", "millimeter", "millimeters"), 0.001),
}
MAX_DEGREE_CELL = 0.2  # cells of degrees are smaller, those of meters wider
OPEN_SEA = 4.0  # degrees around 0 north, 0 east without land
WKT_UNIT = re.compile(r'UNIT\s*\[\s*"[^"]*"\s*,\s*([0-9.eE+-]+)')  # the last one of a projection is that of its coordinates
WKT_VERTICAL = re.compile(r"\bVERT(?:_?CS|CRS)\s*\[", re.IGNORECASE)
GEOGRAPHIC_WKT, PROJECTED_WKT = ("GEOGCS", "GEOGCRS", "GEODCRS"), ("PROJCS", "PROJCRS", "COMPD_CS", "COMPOUNDCRS", "BOUNDCRS")


def unit_of_code(code: int) -> float:
    """Return the meters per unit of a projected system by its EPSG code."""
    return next((unit for unit, ranges in UNIT_CODES.items() if any(code in _parse_range(text) for text in ranges.split())), 1.0)


def _parse_range(text: str) -> range:
    limits, _, step = text.partition("/")
    first, _, last = limits.partition("-")
    return range(int(first), int(last or first) + 1, int(step or 1))


def unit_of_name(name: str) -> float | None:
    """Return the meters per unit of length by its name, None if it is unknown."""
    words = " ".join(re.sub(r"[\W_]+", " ", name.lower()).split())
    return LENGTH_UNITS.get(re.sub(r"(?<=t)re(s?)$", r"er\1", words))


def seem_degrees(first: tuple[float, float], step: tuple[float, float]) -> bool:
    """Return whether the position and the steps of a grid in an unknown unit are longitudes and latitudes: the cells are too small for
    meters, and the position lies on the globe, but not in the sea around its origin, where grids with local coordinates would lie."""
    is_local = max(abs(first[0]), abs(first[1])) < OPEN_SEA
    return max(step) < MAX_DEGREE_CELL and abs(first[0]) <= 360.0 and abs(first[1]) <= 90.0 and not is_local


def mercator_scale(code: str | None, y: float) -> float:
    """Return true meters per meter of the map at the northing `y`: less than 1 for Mercator projections, 1 for all others."""
    return 1.0 / math.cosh(min(abs(y) / SEMI_MAJOR_AXIS, 20.0)) if code in MERCATOR_CODES else 1.0


@dataclass(frozen=True)
class Projection:
    """What text in WKT tells. unit: meters per unit, 1 for degrees. code: see `MERCATOR_CODES`, None for all other systems."""

    is_geographic: bool
    unit: float
    code: str | None = None


def parse_projection(text: str) -> Projection | None:
    """Return what the WKT of a coordinate reference system tells about horizontal positions, None if it is no such text."""
    text = WKT_VERTICAL.split(text.strip())[0]
    if text.upper().startswith(GEOGRAPHIC_WKT):
        return Projection(True, 1.0)
    units = WKT_UNIT.findall(text) if text.upper().startswith(PROJECTED_WKT) else []
    try:
        unit = float(units[-1]) if units else math.nan
    except ValueError:
        return None
    if text.upper().startswith(PROJECTED_WKT[2:]) and "PROJ" not in text.upper():
        return Projection(True, 1.0)
    return Projection(False, unit, WEB_MERCATOR if WEB_MERCATOR_NAME.search(text) else None) if 1e-9 < unit < 1e9 else None
