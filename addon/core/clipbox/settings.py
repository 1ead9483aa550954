"""Settings of the tool `clipbox`."""

from dataclasses import dataclass
from functools import partial

from ..errors import SettingsError
from ..placing import PlacingSettings
from ..settings import Choice, Settings, Unit, setting

TERRAIN, EDITS = "Terrain", "Edits"
in_terrain, in_boxes, in_detail, in_edits = (partial(setting, group=group) for group in (TERRAIN, "Boxes", "Detail", EDITS))
for_spheres, for_forest, for_heights = (partial(in_terrain, used_if={"terrain": (kind,)}) for kind in ("spheres", "forest", "heights"))
for_files = partial(in_terrain, used_if={"terrain": ("heights", "volume", "forest")})
MIN_RESOLUTION_PER_THRESHOLD = 8  # voxels; with a larger threshold a box could leave the next coarser one
LANDSCAPES = {
    "alps": Choice("Alps", "High mountains with valleys that branch into gullies"),
    "hills": Choice("Hills", "Rounded hills with brooks between them"),
    "canyon": Choice("Canyon", "A plateau that rivers have cut into, down through layers of hard and soft rock"),
    "mesas": Choice("Mesas", "Table mountains with cliffs above scree"),
    "coast": Choice("Coast", "Cliffs, beaches and sea stacks, with the level of the sea at z = 0"),
    "dunes": Choice("Dunes", "Sand that the wind has piled up, gentle on its side and steep behind"),
    "karst": Choice("Karst", "Towers of limestone on a plain, with sinkholes, and caves with columns"),
    "arches": Choice("Arches", "Walls of red rock with arches"),
    "alien": Choice("Alien", "Spires, and roots that wind through ground and air"),
    "lava": Choice("Lava", "Volcanoes with craters on a plain of basalt, with rivers of lava at z = 0"),
}
TERRAINS = LANDSCAPES | {
    "cascades": Choice("Cascades", "Ridged mountains with overhangs, arches and caves"),
    "islands": Choice("Islands", "Layers of floating rocks"),
    "spheres": Choice("Spheres", "Spheres of several sizes, added and subtracted"),
    "formula": Choice("Formula", "A density function typed as a formula"),
    "xor": Choice("XOR", "Steps whose height is the exclusive or of x and y"),
    "sawtooth": Choice("Sawtooth", "Sawtooth waves along every axis"),
    "sine": Choice("Sine", "Crossing sine waves with overhangs"),
    "volume": Choice("Volume", "A voxel model from a file"),
    "forest": Choice("Forest", "Copies of a voxel model from a file, scattered over hills"),
    "heights": Choice("Heights", "A height map from a file: an image, an elevation model or an array"),
}
for_landscapes = partial(in_terrain, used_if={"terrain": tuple(LANDSCAPES)})
SURFACES = {
    "smooth": Choice("Smooth", "Surface nets: vertices lie where the density is 0"),
    "blocky": Choice("Blocky", "Cuberille: the faces of the voxels, which Smoothing rounds off"),
}


@dataclass(frozen=True, kw_only=True)
class ClipboxSettings(Settings):
    """Settings of a terrain in nested boxes."""

    terrain: str = in_terrain("mesas", "Shape of the terrain", choices=TERRAINS)
    formula: str = in_terrain(
        "30*sin(x/40)*sin(y/40) - z",
        "Density as a function of x, y and z in scene units; positive values are solid",
        used_if={"terrain": ("formula",)},
    )
    source: str = for_files("", "Height map or voxel model to read", path="file")
    source_size: float = in_terrain(
        1000.0,
        "Length of the longest side of the source's content",
        minimum=1e-3,
        maximum=1e7,
        unit=Unit.LENGTH,
        used_if={"terrain": ("heights", "volume")},
    )
    plant_size: float = for_forest(
        20.0, "Length of the longest side of the largest copy: the height of a tall tree", minimum=1e-3, maximum=1e7, unit=Unit.LENGTH
    )
    source_height: float = for_heights(
        100.0, "Height difference between black and white for image height maps", minimum=0.0, maximum=1e6, unit=Unit.LENGTH
    )
    source_color: str = for_heights("", "Image of the ground from above, with the same extent as the source", path="file")
    forest_spacing: float = for_forest(0.8, "Distance between copies, relative to the size of the largest", minimum=0.25, maximum=100.0)
    forest_hills: float = for_forest(15.0, "Height range of the ground below the copies", minimum=0.0, maximum=1e5, unit=Unit.LENGTH)
    sphere_radius: float = for_spheres(
        120.0, "Maximum radius of the largest size class; each further class is half as large", minimum=0.1, maximum=1e5, unit=Unit.LENGTH
    )
    sphere_classes: int = for_spheres(7, "Number of size classes", minimum=1, maximum=12)
    sphere_count: int = for_spheres(4, "Spheres of each class per cell (a cube four radii wide)", minimum=1, maximum=64)
    sphere_subtracted: float = for_spheres(
        0.5, "Fraction of spheres that are subtracted", minimum=0.0, maximum=1.0, unit=Unit.FRACTION, panel_label="Subtracted"
    )
    sphere_height: float = for_spheres(
        60.0, "Maximum distance of the largest spheres' centers above and below z = 0", minimum=0.0, maximum=1e6, unit=Unit.LENGTH
    )
    ruggedness: float = for_landscapes(1.0, "Factor of heights", minimum=0.1, maximum=3.0)
    erosion: float = for_landscapes(1.0, "Factor of the depth of gullies", minimum=0.0, maximum=2.0)
    seed: int = in_terrain(0, "Random seed; every value gives a different terrain of the same kind", minimum=0, maximum=2**31 - 1)
    scale: float = in_terrain(1.0, "Size factor of all terrain features", minimum=1e-3, maximum=1e3)
    water: bool = in_terrain(False, "Add a lake or sea. Ground below it takes on the color of deep water")
    water_level: float = in_terrain(0.0, "z of the water", minimum=-1e6, maximum=1e6, unit=Unit.LENGTH, used_if={"water": True})
    voxel_size: float = in_boxes(1.0, "Side of the smallest voxels", minimum=1e-4, maximum=1e4, unit=Unit.LENGTH)
    resolution: int = in_boxes(64, "Voxels along each side of every box", minimum=32, maximum=256)
    boxes: int = in_boxes(7, "Number of nested boxes, each twice as large as the next inner one", minimum=1, maximum=10)
    threshold: int = in_boxes(
        4,
        "Distance, in its own voxels, that the viewer moves before a box is recentered. Higher values update less often",
        minimum=1,
        maximum=8,
    )
    smooth_moves: bool = in_boxes(
        False,
        "Blend each box into the next coarser one by the distance from the viewer, so that nothing changes at once when boxes move. For "
        "animations; updates take longer, and detail ends closer to the viewer",
        used_if={"surface": ("smooth",)},
    )
    subdivided_boxes: int = in_detail(
        0,
        "Number of innermost boxes that subdivide the surface of the next coarser box instead of sampling the terrain",
        minimum=0,
        maximum=9,
        panel_label="Subdivided",
    )
    roughness: float = in_detail(
        0.25,
        "Maximum random displacement of subdivided vertices, relative to the voxel size",
        minimum=0.0,
        maximum=1.0,
        unit=Unit.FRACTION,
        used_if={"subdivided_boxes": True},
    )
    edit_blend: float = in_edits(
        0.0,
        "Distance within which added and subtracted objects blend with the ground",
        minimum=0.0,
        maximum=1e4,
        unit=Unit.LENGTH,
        panel_label="Blend",
    )
    surface: str = in_detail("smooth", "How the surface is extracted from the voxels", choices=SURFACES)
    smoothing: int = in_detail(
        0, "Smoothing iterations; each moves every vertex halfway to the mean of its neighbors", minimum=0, maximum=8
    )

    @property
    def extent(self) -> float:
        """Side of the outermost box, scene units."""
        return self.extent_of(self.boxes - 1)

    def extent_of(self, level: int) -> float:
        """Return the side of a box, 0 for the innermost one, scene units."""
        return self.voxel_size * self.resolution * 2**level

    @property
    def has_smooth_moves(self) -> bool:
        """Whether transitions between boxes are measured from the viewer. Blocks have none: their shape is exact."""
        return self.smooth_moves and self.surface == "smooth"

    @property
    def content_size(self) -> float:
        """Length of the longest side of what is in the source, before `scale`; for a forest, of its largest copy."""
        return self.plant_size if self.terrain == "forest" else self.source_size

    def __post_init__(self) -> None:
        """Also check combinations of settings."""
        super().__post_init__()
        if self.subdivided_boxes >= self.boxes:
            raise SettingsError(
                f"Subdivided Boxes is {self.subdivided_boxes} of {self.boxes} boxes; at least one box must sample the terrain.",
                ("subdivided_boxes",),
            )
        max_threshold = self.resolution // MIN_RESOLUTION_PER_THRESHOLD
        if self.threshold > max_threshold:
            raise SettingsError(
                f"Threshold is {self.threshold} in boxes of {self.resolution} voxels; the maximum is {max_threshold}.", ("threshold",)
            )


@dataclass(frozen=True, kw_only=True)
class ConvertSettings(Settings):
    """Settings of the conversion of a terrain to meshes."""

    per_box: bool = setting(False, "Create one mesh per box instead of one for all boxes. Only a single mesh is watertight")
    closed: bool = setting(True, "Close the ground with walls at the boundary of the outermost box")
    collider: bool = setting(True, "Also create a mesh with few triangles for collisions")
    collider_fraction: float = setting(
        0.05,
        "Number of collider triangles relative to the terrain mesh",
        minimum=1e-3,
        maximum=1.0,
        unit=Unit.FRACTION,
        panel_label="Fraction",
        used_if={"collider": True},
    )
    keep_terrain: bool = setting(False, "Keep the terrain in addition to its meshes")


class GroundSettings(PlacingSettings):
    """How *Drop to Ground* places objects on a clip-box terrain."""
