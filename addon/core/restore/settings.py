"""Settings of the tool `restore`."""

from dataclasses import dataclass
from functools import partial
from typing import ClassVar

from ..settings import Choice, Settings, setting

SPLITS = {
    "auto": Choice("Automatic", "Choose the number of sub-bands from the image, so that what remains as texture is homogeneous"),
    "manual": Choice("Sub-Bands", "Use a given number of sub-bands"),
    "diffusion": Choice("Diffusion Only", "Treat the whole image as structure: smooth colors, no texture"),
}
ORDERS = {
    "shrinking": Choice("Shrinking", "From the boundary of the hole inwards. Usually best"),
    "scanline": Choice("Scanline", "Row by row, always in the same direction"),
    "alternating": Choice("Alternating", "Row by row, each in the opposite direction of the one before"),
}
METHODS = {
    "regions": Choice("Regions", "Copy whole regions that continue the surroundings, with seams where they show least. Usually best"),
    "pixels": Choice("Pixels", "Copy pixel by pixel, from coarse to fine. For textures that no region of the source continues"),
}
MASKS = {
    "image": Choice("Image", "Pixels that are bright in a mask image, for instance a painted one"),
    "alpha": Choice("Alpha", "Transparent pixels of the image itself"),
    "color": Choice("Color", "Pixels of the image that have a given color"),
}
MAX_LEVELS = 5
HAS_TEXTURE = {"split": ("auto", "manual")}
in_texture, in_guides = partial(setting, group="Structure and Texture"), partial(setting, group="Guides")
for_texture = partial(in_texture, used_if=HAS_TEXTURE)
for_pixels = partial(setting, group="Pixels", used_if=HAS_TEXTURE | {"method": ("pixels",)})
for_color = partial(setting, used_if={"mask": ("color",)})


@dataclass(frozen=True, kw_only=True)
class RestoreSettings(Settings):
    """Settings of a restoration."""

    split: str = in_texture("auto", "How the image is split into structure (low frequencies) and texture", choices=SPLITS)
    sub_bands: int = in_texture(
        4,
        "Number of sub-bands of the cosine transform that are structure. 0 synthesizes everything as texture",
        label="Sub-Bands",
        minimum=0,
        maximum=65536,
        used_if={"split": ("manual",)},
    )
    method: str = for_texture("regions", "How texture is copied", choices=METHODS)
    pyramid_levels: int = for_pixels(
        3, "Levels of the pyramid for texture. More levels continue larger patterns", minimum=1, maximum=MAX_LEVELS
    )
    order: str = for_pixels("shrinking", "Order in which the pixels of a hole are synthesized", choices=ORDERS)
    coherence: float = for_pixels(
        10.0, "Preference for copying connected regions of the source. Larger values copy larger regions", minimum=0.0, maximum=1000.0
    )
    tileable: bool = in_texture(False, "Treat opposite borders of the image as neighbors, so that the result still tiles")
    seed: int = for_texture(0, "Seed of random choices. Another seed gives another texture", minimum=0, maximum=2**31 - 1)


@dataclass(frozen=True, kw_only=True)
class MaskSettings(Settings):
    """Settings of a restoration inside Blender: where pixels are missing, and where the result goes. Images are given by name."""

    has_flags: ClassVar[bool] = False

    mask: str = setting("image", "What marks the missing pixels", choices=MASKS)
    mask_image: str = setting(
        "", "Image of the same size that is bright where pixels are missing", in_presets=False, used_if={"mask": ("image",)}
    )
    threshold: float = setting(
        0.5,
        "Image: luminance above which a pixel of the mask marks a missing pixel. Alpha: alpha below which a pixel is missing",
        minimum=0.0,
        maximum=1.0,
        used_if={"mask": ("image", "alpha")},
    )
    mask_color: tuple = for_color((0.0, 0.0, 0.0), "Color of the missing pixels, as displayed", is_color=True, panel_label="Color")
    color_tolerance: float = for_color(
        0.02, "Largest difference per channel from the color, 0 to 1", minimum=0.0, maximum=1.0, panel_label="Tolerance"
    )
    source_mask: str = in_guides(
        "", "Image that is bright where texture may be copied from; empty for everywhere outside the mask", in_presets=False
    )
    barriers: str = in_guides(
        "", "Image that is bright where diffusion must not cross, for instance along edges; may be empty", in_presets=False
    )
    normal_map: bool = in_guides(
        False, "Treat the image as a normal map. Images that a Normal Map node uses are recognized without this option"
    )
    all_maps_of_material: bool = setting(
        False,
        "Restore the other images of the material with the image, as far as they have its size: the same pixels are copied in all of them. "
        "Not for image sequences",
    )
    output_folder: str = setting("", "Folder for the restored frames of an image sequence", path="folder")
    replace_in_materials: bool = setting(
        False, "Use the result in place of the image, and of earlier results, in all materials, Worlds, lights and textures"
    )
