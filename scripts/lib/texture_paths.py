"""Names of the files of a texture with several pages: `castle.<MATERIAL>.<UDIM>.png`."""

from collections.abc import Sequence
from pathlib import Path

from lib import environment

environment.import_farfield()

from farfield.addon.core.errors import FileError
from farfield.addon.core.files.filenames import unique_filenames
from farfield.addon.core.photos.texels.pages import FIRST_TILE, PageLayout
from lib.numbered_files import UDIM, numbered_path

MATERIAL = "<MATERIAL>"
NO_MATERIAL = "no material"


class TexturePaths:
    """The files of a texture.

    pages: the path of each page. groups: those of groups of pages as materials refer to them: with the placeholder of the tiles, if a group
    has others than the first.
    """

    def __init__(self, texture: Path, layout: PageLayout, materials: Sequence[str] | None) -> None:
        """Name the files of `layout`; `materials`: names by group, "" for faces without one, or None if one texture is for all.

        Raises:
            FileError: the name `texture` lacks a placeholder that the pages need, or has one that means nothing.
        """
        tiles, groups = sorted(set(layout.tiles)), set(layout.groups)
        if layout.is_tiled and UDIM not in texture.name:
            numbers = ", ".join(map(str, tiles))
            raise FileError(f'--texture is "{texture}", but the UV map uses the UDIM tiles {numbers}; put {UDIM} into its name.')
        if len(groups) > 1 and MATERIAL not in texture.name:
            raise FileError(f'--texture is "{texture}" for {len(groups)} materials; put {MATERIAL} into its name.')
        if materials is None and MATERIAL in texture.name:
            raise FileError(f'--texture is "{texture}", but there is one for all materials; leave out {MATERIAL}, or add --materials keep.')
        names = unique_filenames([name or NO_MATERIAL for name in materials or [""]])
        named = [texture.with_name(texture.name.replace(MATERIAL, name)) for name in names]
        self.pages = [numbered_path(named[group], UDIM, tile) for group, tile in zip(layout.groups, layout.tiles, strict=True)]
        self.groups = [
            numbered_path(path, UDIM, FIRST_TILE) if list(layout.find_tiles(group)) == [FIRST_TILE] else path
            for group, path in enumerate(named)
        ]


def first_path(texture: Path) -> Path:
    """Return a path like those that `texture` stands for, to check early whether it can be written."""
    return numbered_path(texture.with_name(texture.name.replace(MATERIAL, NO_MATERIAL)), UDIM, FIRST_TILE)
