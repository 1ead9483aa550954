"""Settings of packages."""

from dataclasses import dataclass
from urllib.parse import urlsplit

from ..errors import SettingsError
from ..settings import Settings, Unit, setting
from .textures.settings import TextureSettings
from .textures.texture_tiles import TILE_UNIT

SCHEMES = ("http", "https")


@dataclass(frozen=True, kw_only=True)
class PackageSettings(Settings):
    """What a package is made for."""

    time_limit: float = setting(
        10.0,
        "Time within which the model is complete. The page can change it",
        minimum=0.5,
        maximum=3600.0,
        unit=Unit.SECONDS,
    )
    pixels: int = setting(
        512,
        "Size of the object in the image that bytes are divided for between mesh and parts of textures, in pixels",
        minimum=16,
        maximum=4096,
        unit=Unit.COUNT,
    )
    quality: int = setting(TextureSettings.quality, "AVIF quality of complete textures", minimum=1, maximum=100, unit=Unit.COUNT)
    tile_size: int = setting(
        TextureSettings.tile_size,
        "Side of the tiles of textures in pixels, a multiple of 16",
        minimum=16,
        maximum=1024,
        unit=Unit.COUNT,
    )
    feature_weight: float = setting(
        TextureSettings.feature_weight,
        "Weight of features of the surface for the order in which parts of textures are sent; 0 for images alone",
        minimum=0.0,
        maximum=10.0,
    )
    mirrors: str = setting("", "URLs of folders with copies of the package, separated by commas")
    with_glb: bool = setting(True, "Also write a .glb file with all levels, for other programs", label="glTF File")

    def texture_settings(self, pixels_per_degree: float) -> TextureSettings:
        """Return the settings of the textures.

        Raises:
            SettingsError: the size of tiles is no multiple of 16.
        """
        if self.tile_size % TILE_UNIT:
            raise SettingsError(f"Tile Size is {self.tile_size}; it must be a multiple of {TILE_UNIT}.", ("tile_size",))
        return TextureSettings(
            tile_size=self.tile_size,
            quality=self.quality,
            pixels=self.pixels,
            pixels_per_degree=pixels_per_degree,
            feature_weight=self.feature_weight,
        )

    def mirror_urls(self) -> tuple[str, ...]:
        """Return the URLs of the mirrors, each ending in "/".

        Raises:
            SettingsError: one is no URL of a web server.
        """
        urls = [url.strip() for url in self.mirrors.split(",") if url.strip()]
        for url in urls:
            if urlsplit(url).scheme not in SCHEMES or not urlsplit(url).netloc:
                raise SettingsError(f'Mirrors has "{url}", which is no URL; write it as https://example.org/folder/.', ("mirrors",))
        return tuple(url if url.endswith("/") else f"{url}/" for url in urls)
