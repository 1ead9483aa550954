"""Cameras of photographs from the files of other programs."""

from pathlib import Path

from ...errors import FileError
from ...geometry.lenses import PhotoCamera
from . import colmap
from .metashape import EXTENSION as METASHAPE_EXTENSION
from .metashape import read_metashape
from .transforms import NAME as TRANSFORMS_NAME
from .transforms import read_transforms


def read_cameras(path: Path) -> list[PhotoCamera]:
    """Read the cameras of COLMAP (a folder, or its subfolder `sparse/0`), of a `transforms.json`, or of an .xml file of Metashape.

    Raises:
        FileError: there are none, or a file cannot be read.
    """
    if path.suffix.lower() == METASHAPE_EXTENSION:
        return read_metashape(path)
    if path.suffix.lower() == ".json":
        return read_transforms(path)
    for folder in (path, path / "sparse" / "0", path / "sparse"):
        if any((folder / f"images{extension}").is_file() for extension in colmap.EXTENSIONS):
            return colmap.read_folder(folder)
    if (path / TRANSFORMS_NAME).is_file():
        return read_transforms(path / TRANSFORMS_NAME)
    raise FileError(
        f'There are no cameras in "{path}"; name a folder with the files cameras and images of COLMAP (.txt or .bin), a transforms.json, '
        "or an .xml file of Metashape."
    )
