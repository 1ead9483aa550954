"""Settings of the tool `unwrap`."""

from dataclasses import dataclass

from ..settings import Settings, Unit, setting

IMPORTANCE = {
    "even": "Every part of the surface gets as many texels for its area",
    "direction": "What faces a direction gets more texels, all of it alike",
    "look": "The more something faces a direction, the more texels it gets, as in the paper",
    "camera": "What the scene's camera sees gets texels as it shows pixels",
    "cameras": "The same for all cameras of the scene together",
    "group": "What a vertex group is painted on gets more texels",
}
CHARTS = {
    "one": "Each connected part in one piece, cut open where it has to be",
    "atlas": "Many pieces that hardly stretch, cut along creases",
}
BOUNDARIES = {
    "free": "The border lies where the stretch is least",
    "square": "The border of each piece around a square",
    "circle": "The border of each piece around a circle",
}


@dataclass(frozen=True, kw_only=True)
class UnwrapSettings(Settings):
    """What a user can choose about an unwrap."""

    importance: str = setting("even", "What gets more texels", choices=IMPORTANCE)
    direction: tuple = setting((0.0, -1.0, 0.0), "From the surface to the viewer, in world space, for direction and look")
    group: str = setting("", "Vertex group that is painted where texels should go; the active one when empty")
    density_ratio: float = setting(
        4.0, "How many times as many texels for its area the most important part gets as the least", minimum=1.0, maximum=64.0
    )
    min_shape: float = setting(
        0.0,
        "What height over base of every UV triangle is kept above: 0.05 to 0.15 where textures crack along slivers, 0 for no bound",
        minimum=0.0,
        maximum=0.3,
    )
    chart: str = setting("one", "Into how many pieces the surface is laid out", choices=CHARTS)
    further_cuts: bool = setting(
        True, "Cut parts that are all but closed as if they were closed; others are only cut where they have to be"
    )
    boundary: str = setting("free", "Where the border of each piece lies", choices=BOUNDARIES)
    margin: float = setting(
        0.004, "Room around each piece, as a share of the side of the UV square", minimum=0.0, maximum=0.1, unit=Unit.SHARE
    )
    uv_map: str = setting("Unwrap", "Name of the UV map, made when missing")
