"""Settings of the tool `restore`."""

from dataclasses import dataclass

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
MAX_LEVELS = 5


@dataclass(frozen=True, kw_only=True)
class RestoreSettings(Settings):
    """Settings of a restoration."""

    split: str = setting("auto", "How the image is split into structure (low frequencies) and texture", choices=SPLITS)
    kappa: int = setting(
        4,
        "Number of sub-bands of the cosine transform that are structure. 0 synthesizes everything as texture. Used by Sub-Bands",
        label="Sub-Bands",
        minimum=0,
        maximum=65536,
    )
    levels: int = setting(
        3, "Levels of the pyramid for texture. More levels continue larger patterns", label="Pyramid Levels", minimum=1, maximum=MAX_LEVELS
    )
    order: str = setting("shrinking", "Order in which the pixels of a hole are synthesized", choices=ORDERS)
    coherence: float = setting(
        10.0, "Preference for copying connected regions of the source. Larger values copy larger regions", minimum=0.0, maximum=1000.0
    )
    tileable: bool = setting(False, "Treat opposite borders of the image as neighbors, so that the result still tiles")
    seed: int = setting(0, "Seed of random choices. Another seed gives another texture", minimum=0, maximum=2**31 - 1)
