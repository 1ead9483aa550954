"""Settings of the tool `clipbox`."""

from dataclasses import dataclass

from ..errors import SettingsError
from ..settings import Settings, Unit, setting
from . import forest, heights, voxels  # noqa: F401 - their terrains join the others when they are imported
from .terrains import NAMES

LEAST_PART = 8  # of a box: a threshold beyond this part of its side would let it leave the next one
SURFACES = {
    "smooth": "The surface passes where the density is 0 (surface nets)",
    "blocky": "The faces of voxels, as in the paper; smoothing rounds them",
}


@dataclass(frozen=True, kw_only=True)
class ClipboxSettings(Settings):
    """What a user can choose about a terrain in nested boxes."""

    terrain: str = setting("cascades", "What the terrain is made of", choices=NAMES)
    formula: str = setting(
        "30*sin(x/40)*sin(y/40) - z", "For the terrain formula: a function of x, y and z in scene units, solid where it is above 0"
    )
    source: str = setting("", "For the terrains heights, volume and forest: the file they come from")
    source_size: float = setting(
        1000.0, "How far the longest side of the file reaches; of the largest copy in a forest", minimum=1e-3, maximum=1e7, unit=Unit.LENGTH
    )
    source_height: float = setting(
        100.0, "How high white is above black where a picture gives the heights", minimum=0.0, maximum=1e6, unit=Unit.LENGTH
    )
    source_color: str = setting("", "For the terrain heights: a picture of the ground from above, of the same extent as the file")
    forest_spacing: float = setting(
        0.8, "For the terrain forest: how far apart copies stand, in sizes of the largest", minimum=0.25, maximum=100.0
    )
    forest_hills: float = setting(15.0, "How far the ground under them rises and falls", minimum=0.0, maximum=1e5, unit=Unit.LENGTH)
    sphere_radius: float = setting(
        120.0, "For the terrain spheres: radius of the largest; each class has half of the last", minimum=0.1, maximum=1e5, unit=Unit.LENGTH
    )
    sphere_classes: int = setting(7, "How many classes of size there are", minimum=1, maximum=12)
    sphere_count: int = setting(4, "How many spheres of a class there are in a cube of four of its radii", minimum=1, maximum=64)
    sphere_taken: float = setting(0.5, "Share of the spheres that take ground away", minimum=0.0, maximum=1.0, unit=Unit.SHARE)
    sphere_height: float = setting(
        60.0, "How far above and below 0 the largest have their centres", minimum=0.0, maximum=1e6, unit=Unit.LENGTH
    )
    seed: int = setting(0, "Another number gives another terrain of the same kind", minimum=0, maximum=2**31 - 1)
    scale: float = setting(1.0, "How many times as large the terrain's features are", minimum=1e-3, maximum=1e3)
    voxel: float = setting(1.0, "Side of the smallest voxels", minimum=1e-4, maximum=1e4, unit=Unit.LENGTH)
    resolution: int = setting(64, "Voxels along each side of every box", minimum=32, maximum=256)
    boxes: int = setting(7, "Boxes, each twice as wide as the one within it", minimum=1, maximum=10)
    threshold: int = setting(
        4,
        "Voxels of its own that the viewer may go before a box follows; more moves it less often",
        minimum=1,
        maximum=8,
    )
    subdivided: int = setting(
        0, "How many of the innermost boxes are made by subdividing the surface around them instead of from voxels", minimum=0, maximum=9
    )
    roughness: float = setting(
        0.25, "How far the vertices that subdivision adds may be moved, as a share of the voxel", minimum=0.0, maximum=1.0, unit=Unit.SHARE
    )
    surface: str = setting("smooth", "Where the surface passes", choices=SURFACES)
    smoothing: int = setting(0, "How many times every vertex is moved half way to the mean of its neighbours", minimum=0, maximum=8)

    def __post_init__(self) -> None:
        """Also check what the settings say together."""
        super().__post_init__()
        if self.subdivided >= self.boxes:
            raise SettingsError(f"--subdivided is {self.subdivided} of {self.boxes} boxes; at least one has to come from voxels.")
        if self.threshold > self.resolution // LEAST_PART:
            raise SettingsError(
                f"--threshold is {self.threshold} in boxes of {self.resolution} voxels; the largest is {self.resolution // LEAST_PART}."
            )


@dataclass(frozen=True, kw_only=True)
class FreezeSettings(Settings):
    """What a user can choose about meshes that a terrain is frozen to."""

    per_box: bool = setting(False, "A mesh for each box instead of one for all; only one for all is watertight")
    closed: bool = setting(True, "Close the ground with walls at the border of the outermost box")
    collider: bool = setting(True, "Make a mesh of few triangles for collisions as well")
    collider_share: float = setting(
        0.05, "How many triangles the collider has, as a share of all", minimum=1e-3, maximum=1.0, unit=Unit.SHARE
    )
    keep_terrain: bool = setting(False, "Keep the terrain that follows beside its frozen mesh")
