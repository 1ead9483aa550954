"""The result of a build."""

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class BuildReport:
    """Figures of a terrain that was built.

    origin: world position of the local zero, meters of the projection, or degrees of longitude and latitude. crs: the coordinate reference
    system in words. rows, columns: samples. holes: unknown samples of the sources. patches, triangles: of all levels. tiles: of textures.
    bytes: of the store. seconds: by stage, of this run. warnings: sentences for the user.
    """

    origin: tuple[float, float]
    crs: str
    rows: int
    columns: int
    holes: int
    patches: int
    triangles: int
    tiles: int
    bytes: int
    seconds: Mapping[str, float]
    warnings: tuple[str, ...]
