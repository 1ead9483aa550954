"""What a user can choose about relightable textures."""

import math
from dataclasses import dataclass

from ..direction_grids import DirectionGrid
from ..errors import SettingsError
from ..settings import Settings, Unit, setting

CODECS = {
    "pca": "One set of components for all quads: linear, filtered and mip-mapped like any texture",
    "lpca": "Local PCA: texels in clusters, each with components of its own; sharper, but not filtered like a texture",
}
LARGEST_SIDE = 16384  # pixels of an image that graphics cards take

DIRECTIONS = {
    "bonn": "The 81 directions of the Bonn measurements, above the horizon, interpolated from those of the bake",
    "baked": "The directions of the bake, as they are",
}


@dataclass(frozen=True, kw_only=True)
class ExportSettings(Settings):
    """What a user can choose about files for other programs."""

    directions: str = setting("bonn", "Views and lights of an exported folder or .btf file", choices=DIRECTIONS)


@dataclass(frozen=True, kw_only=True)
class BtfSettings(Settings):
    """Settings of the tool `btf`."""

    views: int = setting(64, "Number of view directions, a square number", minimum=4, maximum=1024, unit=Unit.COUNT)
    lights: int = setting(
        64, "Number of light directions, a square number; a dome of even light comes on top", minimum=4, maximum=1024, unit=Unit.COUNT
    )
    upper_hemisphere: bool = setting(False, "Views and lights from above the horizon only, twice as dense, for what stands on the ground")
    codec: str = setting("pca", "How the textures are compressed", choices=CODECS)
    components: int = setting(12, "Components of colour; four share a pixel", minimum=1, maximum=64, unit=Unit.COUNT)
    clusters: int = setting(32, "Clusters of texels, for lpca", minimum=1, maximum=256, unit=Unit.COUNT)
    cluster_components: int = setting(8, "Components of colour of each cluster, for lpca", minimum=1, maximum=32, unit=Unit.COUNT)
    blend_texels: bool = setting(True, "For lpca: blend neighbouring texels at random from sample to sample, which more samples smooth")
    alpha_components: int = setting(12, "Components of the silhouette; four share a pixel", minimum=1, maximum=64, unit=Unit.COUNT)
    shadows: int = setting(
        256,
        "Number of sun directions from which the original's shadows upon itself are looked up, a square number; 0 for none",
        minimum=0,
        maximum=4096,
        unit=Unit.COUNT,
    )
    shadow_components: int = setting(24, "Components of shadows; four share a pixel", minimum=1, maximum=64, unit=Unit.COUNT)
    refine: bool = setting(True, "Refine the silhouettes against whole pictures of the original, so that quads fit together")
    samples: int = setting(
        4, "Cycles samples a pixel of every render; compression removes their noise", minimum=1, maximum=4096, unit=Unit.COUNT
    )
    executor: str = setting(
        "processes",
        "Where the renders run: serial, processes, processes:N for N at a time, or dask:tcp://HOST:PORT for a Dask scheduler",
    )
    seed: int = setting(0, "Seed of random choices", minimum=0, maximum=2**31 - 1)

    @property
    def of_capture(self) -> str:
        """Those settings that the renders depend on, in words; the same renders can be compressed again in other ways."""
        return (
            f"views={self.views} lights={self.lights} upper={self.upper_hemisphere} shadows={self.shadows} samples={self.samples} "
            f"seed={self.seed}"
        )

    @property
    def view_grid(self) -> DirectionGrid:
        """The views.

        Raises:
            SettingsError: when their number is no square.
        """
        return DirectionGrid(_side(self.views, "views"), self.upper_hemisphere)

    @property
    def light_grid(self) -> DirectionGrid:
        """The lights without the dome; see `view_grid`."""
        return DirectionGrid(_side(self.lights, "lights"), self.upper_hemisphere)

    @property
    def shadow_grid(self) -> DirectionGrid | None:
        """The directions of suns whose shadows are looked up, None for none; see `view_grid`."""
        return DirectionGrid(_side(self.shadows, "shadows"), self.upper_hemisphere) if self.shadows else None

    @property
    def sun_size(self) -> float:
        """The solid angle of each sun of a bake, in steradians: a cell of the lights' grid.

        A sun like a point makes highlights narrower than the grid: one view and light would hold a spike, and its neighbours nothing.
        """
        return float(self.light_grid.solid_angles.mean())

    def check(self) -> None:
        """Raise SettingsError when the numbers of views, lights and shadows are no squares, or a table would be larger than images are."""
        in_shadow = 0 if self.shadow_grid is None else -(-self.shadow_components // 4) * (self.shadow_grid.size + 2)
        tile = (self.view_grid.size + 2) * (self.light_grid.size + 2)
        local = self.codec == "lpca"
        width, height = tile * (self.clusters if local else 1), tile * (self.cluster_components if local else self.components)
        if max(width, height, in_shadow) > LARGEST_SIDE:
            raise SettingsError(
                f"{self.views} views, {self.lights} lights and these components would make a table of {width} x "
                f"{max(height, in_shadow)} pixels, more than "
                f"the {LARGEST_SIDE} that an image can have; take fewer of one of them."
            )


def _side(count: int, what: str) -> int:
    side = math.isqrt(count)
    if side * side != count:
        raise SettingsError(f"--{what} {count} is no square number; take {side * side} or {(side + 1) ** 2}.")
    return side
