"""Cameras of photographs from the files of other programs."""

from pathlib import Path

from ...errors import FileError
from ...geometry.lenses import PhotoCamera
from . import colmap


def read_cameras(path: Path) -> list[PhotoCamera]:
    """Read the cameras of a folder of COLMAP, with text or binary files, also in its subfolder `sparse/0`.

    Raises:
        FileError: there are none, or a file cannot be read.
    """
    for folder in (path, path / "sparse" / "0", path / "sparse"):
        if any((folder / f"images{extension}").is_file() for extension in colmap.EXTENSIONS):
            return colmap.read_folder(folder)
    raise FileError(f'There are no cameras in "{path}"; name a folder with the files cameras and images of COLMAP, .txt or .bin.')
