"""Settings of packages."""

from dataclasses import dataclass

from ..errors import SettingsError
from ..settings import Settings, Unit, setting
from .manifest import find_origin

TILE_UNIT = 16  # pixels
FIXED_LEVEL_SETTINGS = {"vertices": "original"}  # so that levels can be sent one after the other


@dataclass(frozen=True, kw_only=True)
class PackageSettings(Settings):
    """What a package is made for. Raises SettingsError if the size of tiles is no multiple of 16, or a mirror is no URL."""

    time_limit: float = setting(
        10.0,
        "Time for the first picture, after which the page goes on in the background. It can change the time",
        minimum=0.5,
        maximum=3600.0,
        unit=Unit.SECONDS,
    )
    pixels: int = setting(
        512, "Object size on screen, in pixels, for which bytes are divided between mesh and textures", minimum=16, maximum=4096
    )
    quality: int = setting(80, "AVIF quality of complete textures", minimum=1, maximum=100)
    tile_size: int = setting(512, "Side of the tiles of textures in pixels, a multiple of 16", minimum=16, maximum=1024)
    mirrors: str = setting("", "URLs of folders with copies of the package, separated by commas")
    gltf_file: bool = setting(True, "Also write a .glb file with all levels, for other programs", label="glTF File")

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.tile_size % TILE_UNIT:
            raise SettingsError(f"Tile Size is {self.tile_size}; it must be a multiple of {TILE_UNIT}.", ("tile_size",))
        self.mirror_urls()

    def mirror_urls(self) -> tuple[str, ...]:
        """Return the URLs of the mirrors, each ending in "/".

        Raises:
            SettingsError: one is no URL of a web server.
        """
        urls = [url.strip() for url in self.mirrors.split(",") if url.strip()]
        urls = [url if url.endswith("/") else f"{url}/" for url in urls]
        for url in urls:
            try:
                find_origin(url)
            except ValueError as error:
                raise SettingsError(
                    f'Mirrors has "{url}", which is no URL; write it as https://example.org/folder/.', ("mirrors",)
                ) from error
        return tuple(urls)
