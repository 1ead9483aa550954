"""Settings of *Large Terrain*."""

from dataclasses import dataclass
from functools import partial

from ..placing import PlacingSettings
from ..settings import Choice, Settings, setting

PATCH_SIZES = {
    "16": Choice("16", "Patches of about 256 triangles, as in the paper: finer steps of detail, more patches"),
    "32": Choice("32", "Patches of about 1,000 triangles"),
    "64": Choice("64", "Patches of about 4,000 triangles: fewer and larger steps of detail"),
}

VOIDS = {
    "none": Choice("None", "All voids stay holes, through which the sky is seen"),
    "small": Choice("Small", "Voids of up to 40,000 samples, but not those along the border"),
    "all": Choice("All", "All voids, also seas, gaps between files, and the surroundings of the data"),
}

TEXTURE_FORMATS = {
    "jpeg": Choice("JPEG", "Small files, with further ones for alpha; tiles meet without seams"),
    "webp": Choice("WebP", "Smaller files; faint seams"),
    "raw": Choice("Raw", "Exact colors in files of 0.8 to 1 MB per tile"),
}
TEXTURE_ERRORS = {
    "magnification": Choice("Magnification", "The size of texels: all images are as sharp as the screen"),
    "feature": Choice("Feature", "The size of the largest visible detail that is lost: fewer tiles where images are blurred or even"),
}


in_options = partial(setting, group="Options")


@dataclass(frozen=True, kw_only=True)
class BdamSettings(Settings):
    """Settings of the build of a large terrain."""

    patch_size: str = in_options("32", "Samples along the short edges of the finest patches", choices=PATCH_SIZES)
    height_step: float = in_options(
        0.0,
        "Meters between two heights that are stored. 0 for that of the source, or a two-hundredth of a cell",
        minimum=0.0,
        maximum=1000.0,
    )
    cell_size: float = in_options(1.0, "Meters between two samples of a source without a position", minimum=1e-3, maximum=1e6)
    image_height: float = in_options(100.0, "Meters between black and white of a source that is an image", minimum=1e-3, maximum=1e6)
    allow_gaps: bool = setting(False, "Accept several sources that do not fill their common rectangle; the gaps become holes")
    fill_holes: str = setting("small", "Which voids, areas without known heights, are filled smoothly from their rims", choices=VOIDS)
    erosion: float = setting(
        0.0,
        "How deeply rivers cut valleys into heights that are fractal, smooth or enlarged. 0 for no erosion, 1 for natural valleys",
        minimum=0.0,
        maximum=5.0,
    )
    texture_format: str = in_options("jpeg", "How texture tiles are coded", choices=TEXTURE_FORMATS)
    texture_quality: int = in_options(
        0,
        "Quality of the tiles, 1 to 100. 0 for 85 of JPEG and 95 of WebP",
        minimum=0,
        maximum=100,
        used_if={"texture_format": ("jpeg", "webp")},
    )
    texture_error: str = in_options("magnification", "What decides how fine textures must be", choices=TEXTURE_ERRORS)
    normal_maps: bool = in_options(
        True, "Store the directions of all samples, so that coarse triangles are shaded like the finest ones; about 1.3 bytes per sample"
    )
    executor: str = in_options("processes", "Where patches are built: serial, processes, or processes:N for N at a time", in_presets=False)


SHADINGS = {
    "texture": Choice("Texture", "Images that the terrain was built with; without images, by slope"),
    "slope": Choice("Slope", "Rock where the ground is steep, grass where it is flat, snow in the heights"),
    "height": Choice("Height", "Colors of a map by height"),
    "level": Choice("Level", "A color per level of detail"),
}


@dataclass(frozen=True, kw_only=True)
class ViewSettings(Settings):
    """How a large terrain is shown."""

    has_flags = False

    tolerance: float = setting(1.0, "Largest error of the terrain in the image, in pixels", minimum=0.1, maximum=100.0)
    triangle_budget: int = setting(
        1_500_000,
        "Largest number of triangles; the tolerance is raised until the terrain has no more. 0 for no limit",
        minimum=0,
        maximum=100_000_000,
    )
    exaggeration: float = setting(1.0, "Factor of all heights", minimum=0.01, maximum=100.0)
    curvature: bool = setting(False, "Lower the ground as the curvature of the Earth does, by the distance from the center of the terrain")
    shading: str = setting("texture", "What the colors of the terrain show", choices=SHADINGS)
    culling: bool = setting(
        True, "Keep the terrain coarse where the 3D Viewport does not show it. Renders always have all of it, for shadows and reflections"
    )


SURFACES = {
    "finest": Choice("Finest Data", "The ground as it is in the store, with all samples"),
    "shown": Choice("As Shown", "The triangles of the terrain in the scene, as coarse as they are now"),
}


@dataclass(frozen=True, kw_only=True)
class GroundSettings(PlacingSettings):
    """How *Drop to Ground* places objects on a large terrain."""

    surface: str = setting("finest", "The ground that is used", choices=SURFACES)


@dataclass(frozen=True, kw_only=True)
class FreezeSettings(Settings):
    """The objects that *Freeze* and *Freeze Camera Path* create."""

    has_flags = False

    joined: bool = setting(False, "Create one object instead of one per tile")
    keep_terrain: bool = setting(False, "Keep the terrain in addition to its meshes")


@dataclass(frozen=True, kw_only=True)
class FreezePathSettings(Settings):
    """The frames of *Freeze Camera Path*."""

    has_flags = False

    scene_frame_range: bool = setting(True, "Use all frames of the scene, or of its preview range")
    first_frame: int = setting(1, "First frame", minimum=-1_000_000, maximum=1_000_000, used_if={"scene_frame_range": False})
    last_frame: int = setting(250, "Last frame", minimum=-1_000_000, maximum=1_000_000, used_if={"scene_frame_range": False})
    frame_step: int = setting(1, "Use every frame, every second, and so on; frames between may be too coarse", minimum=1, maximum=1000)
