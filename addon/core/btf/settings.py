"""Settings of the tool `btf`: baking, compressing and exporting relightable textures."""

from dataclasses import dataclass
from functools import partial
from typing import ClassVar

from ..errors import SettingsError
from ..geometry.directions import DirectionGrid
from ..settings import Choice, Settings, setting

CODECS = {
    "pca": Choice("PCA", "One set of components for all quads. Linear: filtered and mip-mapped like any texture"),
    "lpca": Choice("Local PCA", "Clusters of texels with a set of components each. Sharper, but cannot be filtered like a texture"),
}
MODELS = {
    "surface": Choice("Surface", "The PBR material with silhouettes that depend on the view. Works with all lights, shadows and bounces"),
    "emission": Choice("Emission", "All lighting is baked, for up to four Sun lights and uniform World lighting. For export; takes longer"),
}
EMISSION = "emission"
IF_EMISSION = {"model": (EMISSION,)}
in_directions, in_compression, in_performance = (partial(setting, group=group) for group in ("Directions", "Compression", "Performance"))
for_emission = partial(setting, group="Emission", used_if=IF_EMISSION)
for_local_pca = partial(for_emission, used_if=IF_EMISSION | {"codec": ("lpca",)})
SURFACE_CHANNELS = 2  # renders per view of the model *surface*: color and normal
SILHOUETTE_SAMPLES_FACTOR = 4  # color and coverage of a view come from one render, those of the model *emission* from dozens
MAX_NORMAL_SAMPLES = 4
MAX_IMAGE_SIDE = 16384  # pixels; limit of graphics cards

EXPORT_DIRECTIONS = {
    "bonn": Choice("Bonn", "The 81 directions of the Bonn measurements, all above the horizon, interpolated from the baked directions"),
    "baked": Choice("Baked", "The baked directions"),
}


@dataclass(frozen=True, kw_only=True)
class ExportSettings(Settings):
    """Settings of an export to other programs."""

    directions: str = setting("bonn", "View and light directions of an exported image folder or .btf file", choices=EXPORT_DIRECTIONS)


@dataclass(frozen=True, kw_only=True)
class BakeSettings(Settings):
    """Settings of every bake."""

    model: str = setting("surface", "What is baked", choices=MODELS)
    views_per_side: int = in_directions(8, "View directions along each side of their square grid: 8 for 64 views", minimum=2, maximum=32)
    upper_hemisphere: bool = in_directions(
        False, "Only bake views and lights above the horizon, at twice the density. Use for objects that are never seen or lit from below"
    )
    alpha_components: int = in_compression(
        12, "Number of silhouette components; four share a pixel", minimum=1, maximum=64, panel_label="Alpha"
    )
    refine: bool = in_compression(
        True, "Refine silhouettes against renders of the source, so that overlapping quads add up to its coverage"
    )
    samples: int = in_performance(
        4, "Cycles samples per pixel under each light of the model Emission. Silhouettes take 4 times as many", minimum=1, maximum=4096
    )
    executor: str = in_performance("processes", "Where renders run: serial, processes, or processes:N for N at a time", in_presets=False)
    seed: int = in_performance(0, "Random seed", minimum=0, maximum=2**31 - 1)


@dataclass(frozen=True, kw_only=True)
class EmissionSettings(Settings):
    """Settings of the model *Emission*: its lights, and how their radiance is compressed."""

    depends_on: ClassVar[tuple[type[Settings], ...]] = (BakeSettings,)

    lights_per_side: int = for_emission(
        8,
        "Light directions along each side of their square grid: 8 for 64 Sun lights. Uniform World lighting is added",
        minimum=2,
        maximum=32,
    )
    codec: str = for_emission("pca", "Compression method", choices=CODECS)
    components: int = for_emission(
        12, "Number of color components; four share a pixel", minimum=1, maximum=64, used_if=IF_EMISSION | {"codec": ("pca",)}
    )
    clusters: int = for_local_pca(32, "Number of texel clusters", minimum=1, maximum=256)
    cluster_components: int = for_local_pca(8, "Number of color components per cluster", minimum=1, maximum=32, panel_label="Per Cluster")
    blend_texels: bool = for_local_pca(True, "Randomly blend neighboring texels per sample. Removes blockiness; needs more render samples")
    shadows_per_side: int = for_emission(
        16,
        "Light directions along each side of the grid whose self-shadowing is captured: 16 for 256; 0 for none",
        minimum=0,
        maximum=64,
        panel_label="Shadow Grid",
    )
    shadow_components: int = for_emission(
        24,
        "Number of self-shadowing components; four share a pixel",
        minimum=1,
        maximum=64,
        panel_label="Shadow Detail",
        used_if=IF_EMISSION | {"shadows_per_side": True},
    )


@dataclass(frozen=True, kw_only=True)
class BtfSettings(EmissionSettings, BakeSettings):
    """All settings of a bake, and what follows from them."""

    @property
    def view_count(self) -> int:
        """Number of view directions."""
        return self.views_per_side**2

    @property
    def light_count(self) -> int:
        """Number of light directions, without the dome."""
        return self.lights_per_side**2

    @property
    def bakes_emission(self) -> bool:
        """Whether the lighting is baked, under the lights of `light_grid`; otherwise views suffice."""
        return self.model == EMISSION

    @property
    def images_per_view(self) -> int:
        """Number of renders per view that are stored per texel."""
        return self.light_count + 1 if self.bakes_emission else SURFACE_CHANNELS

    @property
    def silhouette_samples(self) -> int:
        """Samples per pixel of the color and coverage of a view, for the model *surface*."""
        return SILHOUETTE_SAMPLES_FACTOR * self.samples

    @property
    def normal_samples(self) -> int:
        """Samples per pixel of the normals of a view, for the model *surface*."""
        return min(self.silhouette_samples, MAX_NORMAL_SAMPLES)

    @property
    def shadow_count(self) -> int:
        """Number of light directions for which self-shadowing is captured; may be 0."""
        return self.shadows_per_side**2 if self.bakes_emission else 0

    @property
    def capture_fingerprint(self) -> str:
        """The settings that the renders depend on, as text. The same renders can be compressed again with other settings."""
        common = f"model={self.model} views={self.view_count} upper={self.upper_hemisphere} samples={self.samples} seed={self.seed}"
        return f"{common} lights={self.light_count} shadows={self.shadow_count}" if self.bakes_emission else common

    @property
    def view_grid(self) -> DirectionGrid:
        """The view directions."""
        return DirectionGrid(self.views_per_side, self.upper_hemisphere)

    @property
    def light_grid(self) -> DirectionGrid:
        """The light directions, without the dome."""
        return DirectionGrid(self.lights_per_side, self.upper_hemisphere)

    @property
    def shadow_grid(self) -> DirectionGrid | None:
        """The light directions for which self-shadowing is captured; None when it is disabled."""
        return DirectionGrid(self.shadows_per_side, self.upper_hemisphere) if self.shadow_count else None

    @property
    def sun_solid_angle(self) -> float:
        """Solid angle of each baked Sun light in steradians: one cell of the light grid.

        A point light makes highlights narrower than a grid cell: a single view and light would hold a spike, and its neighbors nothing.
        """
        return float(self.light_grid.solid_angles.mean())

    def check_table_size(self) -> None:
        """Raise SettingsError when the lookup table of the colors would exceed the size limit of images.

        Those of silhouettes and shadows cannot: their settings have limits, and they do not grow with the lights.
        """
        if not self.bakes_emission:
            return
        tile = (self.view_grid.size + 2) * (self.light_grid.size + 2)
        is_local = self.codec == "lpca"
        width, height = tile * (self.clusters if is_local else 1), tile * (self.cluster_components if is_local else self.components)
        if max(width, height) > MAX_IMAGE_SIDE:
            counts = ("clusters", "cluster_components") if is_local else ("components",)
            raise SettingsError(
                f"{self.view_count} views, {self.light_count} lights and this number of components need a lookup table of {width} x "
                f"{height} pixels; the limit is {MAX_IMAGE_SIDE}. Reduce one of them.",
                ("views_per_side", "lights_per_side", *counts),
            )
