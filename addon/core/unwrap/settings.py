"""Settings of the tool `unwrap`."""

from dataclasses import dataclass

from ..settings import Choice, Settings, Unit, setting
from .texture import Texture

OPTIONS = "Options"  # The sub-panel of settings that are rarely changed.
IMPORTANCE = {
    "uniform": Choice("Uniform", "The same texel density everywhere"),
    "direction": Choice("Direction", "Higher density on all faces towards the direction, uniformly"),
    "gradual": Choice("Direction (Gradual)", "Density grows with how directly a face looks in the direction, as in the paper"),
    "camera": Choice("Active Camera", "Density follows the pixels that the active camera shows"),
    "cameras": Choice("All Cameras", "Density follows the pixels that all cameras of the scene show"),
    "vertex_group": Choice("Vertex Group", "Higher density where a vertex group is painted"),
}
BALANCES = {
    "balanced": Choice("Balanced", "Little stretch, without faces that are drawn into long needles in the UV map"),
    "symmetric": Choice("Even Sizes", "Faces that are too large and faces that are too small count the same (symmetric Dirichlet energy)"),
    "stretch": Choice("As in the Paper", "L2 stretch alone. Faces along concave boundaries may fill much of the texture"),
}
ISLANDS = {
    "creases": Choice("Along Creases", "Cut along creases, then join islands as long as little of the texture is wasted"),
    "one": Choice("One per Part", "One UV island per connected part, cut open where necessary"),
    "atlas": Choice("Atlas", "Many UV islands with little stretch, cut along creases"),
}
ORIENTATIONS = {
    "auto": Choice("Upright if It Fits", "Upright where this costs at most two percent of the fill, otherwise as for Best Fill"),
    "upright": Choice("Upright", "Up in the world is up in the UV map, for wood grain, labels and dirt"),
    "fill": Choice("Best Fill", "Turn UV islands freely to fill the texture"),
}
BOUNDARIES = {
    "free": Choice("Free", "Place the boundary of each UV island where stretch is minimal"),
    "square": Choice("Square", "Map the boundary of each UV island to a square"),
    "circle": Choice("Circle", "Map the boundary of each UV island to a circle"),
}


@dataclass(frozen=True, kw_only=True)
class UnwrapSettings(Settings):
    """Settings of an unwrap."""

    importance: str = setting("uniform", "What determines the texel density", choices=IMPORTANCE)
    direction: tuple = setting(
        (0.0, -1.0, 0.0), "Direction from the surface to the viewer, in world space", used_if={"importance": ("direction", "gradual")}
    )
    vertex_group: str = setting(
        "",
        "Vertex group that is painted where texels are needed. Empty uses the active one",
        in_presets=False,
        used_if={"importance": ("vertex_group",)},
    )
    density_ratio: float = setting(
        4.0,
        "Texel density of the most important areas relative to the least important",
        minimum=1.0,
        maximum=64.0,
        used_if={"importance": tuple(value for value in IMPORTANCE if value != "uniform")},
    )
    islands: str = setting("creases", "How the surface is divided into UV islands", choices=ISLANDS)
    combine_selected: bool = setting(
        False,
        "Pack the UV islands of all selected meshes into one texture, with one texel density. Otherwise each mesh fills its own",
        panel_label="One Texture for All",
    )
    texture_size: tuple = setting(
        (2048, 2048),
        "Width and height of the texture in pixels. UV islands keep their proportions on a texture that is not square",
        minimum=16,
        maximum=32768,
    )
    texel_density: float = setting(
        0.0,
        "Pixels per meter on the surface, on average. 0 fills the texture. It is lowered where the UV islands do not fit",
        minimum=0.0,
        maximum=1e6,
    )
    margin: int = setting(
        8,
        "Minimum distance of UV islands from each other and from the border, in pixels of the texture",
        minimum=0,
        maximum=512,
        unit=Unit.PIXELS,
        group=OPTIONS,
    )
    max_tiles: int = setting(
        1, "Maximum number of UDIM tiles, with the UDIM numbers 1001, 1002 and so on", minimum=1, maximum=100, group=OPTIONS
    )
    orientation: str = setting(
        "auto", "How UV islands of walls and other vertical surfaces are turned", choices=ORIENTATIONS, group=OPTIONS
    )
    stack_equal_islands: bool = setting(
        False,
        "Give equal parts and UV islands the same place in the UV map, so that they share texels",
        group=OPTIONS,
    )
    balance: str = setting(
        "balanced",
        "Distortion to minimize: of faces that are too small, or also of faces that are too large in the UV map",
        choices=BALANCES,
        group=OPTIONS,
    )
    min_quality: float = setting(
        0.0,
        "Minimum height-to-base ratio of UV triangles. Use 0.05 to 0.15 to avoid cracks along thin triangles; 0 disables the limit",
        minimum=0.0,
        maximum=0.3,
        group=OPTIONS,
    )
    further_cuts: bool = setting(True, "Also cut strongly distorted parts. When off, parts are only cut where necessary", group=OPTIONS)
    boundary: str = setting("free", "Shape of the boundary of each UV island", choices=BOUNDARIES, group=OPTIONS)
    uv_map: str = setting("Unwrap", "Name of the UV map, created if missing", group=OPTIONS)

    @property
    def follows_creases(self) -> bool:
        """Whether surfaces are divided along creases."""
        return self.islands == "creases" and self.further_cuts and self.boundary == "free"

    @property
    def texture(self) -> Texture:
        """What UV islands are packed into, with as many texels per unit of length as fit."""
        return Texture(size=self.texture_size, margin=self.margin, max_tiles=self.max_tiles)
