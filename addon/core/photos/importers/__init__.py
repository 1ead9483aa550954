"""Cameras of photographs from the files of other programs."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from ...errors import FileError
from ...geometry.lenses import PhotoCamera
from . import bundler, colmap, meshroom, metashape, openmvs, pairs, transforms

PROGRAMS = (
    "a folder with the files cameras and images of COLMAP (.txt or .bin), a transforms.json, an .sfm file of Meshroom, an .out file of "
    "Bundler, an .nvm file of VisualSFM, an .mvs file of OpenMVS, an .xml file of Metashape, or a .pairs file with pairs of points"
)


def read_cameras(path: Path, read_size: Callable[[str], tuple[int, int]] | None = None) -> list[PhotoCamera]:
    """Read the cameras in a file of one of PROGRAMS, or in the subfolder `sparse/0` of a folder.

    read_size: returns width and height of the photograph with a name; needed by formats that do not contain them.

    Raises:
        FileError: there are none, a file cannot be read, or sizes are needed and cannot be read.
    """
    extension = path.suffix.lower()
    sizes = read_size or _refuse_size
    readers = {
        metashape.EXTENSION: metashape.read_metashape,
        meshroom.EXTENSION: meshroom.read_meshroom,
        ".json": transforms.read_transforms,
        bundler.BUNDLER_EXTENSION: lambda file: bundler.read_bundler(file, sizes),
        bundler.NVM_EXTENSION: lambda file: bundler.read_nvm(file, sizes),
        pairs.EXTENSION: lambda file: pairs.read_pairs(file, sizes),
        openmvs.EXTENSION: lambda file: openmvs.read_openmvs(file, sizes),
    }
    if extension in readers and not path.is_dir():
        with np.errstate(over="ignore", invalid="ignore"):  # numbers of damaged files
            return readers[extension](path)
    for folder in (path, path / "sparse" / "0", path / "sparse"):
        if any((folder / f"images{each}").is_file() for each in colmap.EXTENSIONS):
            return colmap.read_folder(folder)
    if (path / transforms.NAME).is_file():
        return transforms.read_transforms(path / transforms.NAME)
    raise FileError(f'There are no cameras in "{path}"; name {PROGRAMS}.')


def _refuse_size(name: str) -> tuple[int, int]:
    raise FileError(f'The size of the photograph "{name}" is not known, and the file with its camera does not contain it.')
