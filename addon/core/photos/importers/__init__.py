"""Cameras of photographs from the files of other programs."""

import struct
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np

from ...errors import FileError
from ...geometry.lenses import PhotoCamera
from . import bundler, colmap, meshroom, metashape, openmvs, pairs, transforms
from .reading import ReadSize

PROGRAMS = (
    "a folder with the files cameras and images of COLMAP (.txt or .bin), a transforms.json, an .sfm file of Meshroom, an .out file of "
    "Bundler, an .nvm file of VisualSFM, an .mvs file of OpenMVS, an .xml file of Metashape, or a .pairs file with pairs of points"
)
READERS = {  # by extension; formats that contain the sizes of the photographs do not ask for them
    ".xml": metashape.read_metashape,
    ".sfm": meshroom.read_meshroom,
    ".json": transforms.read_transforms,
    ".out": bundler.read_bundler,
    ".nvm": bundler.read_nvm,
    ".mvs": openmvs.read_openmvs,
    ".pairs": pairs.read_pairs,
}
DAMAGE = (
    *(ValueError, KeyError, TypeError, IndexError, AttributeError, OverflowError, RecursionError),
    *(struct.error, ET.ParseError),
)  # what readers raise where a file is damaged


def read_cameras(path: Path, read_size: ReadSize | None = None) -> list[PhotoCamera]:
    """Read the registered cameras in a file of one of PROGRAMS, or in the subfolder `sparse/0` of a folder.

    read_size: returns width and height of the photograph with a name; needed by formats that do not contain them.

    Raises:
        FileError: there are none, a file cannot be read or is damaged, or sizes are needed and cannot be read.
        GeometryError: a photograph cannot be registered by its pairs of points, see `register`.
    """
    extension = path.suffix.lower()
    source = path if extension in READERS and not path.is_dir() else _find_model(path)
    try:
        with np.errstate(over="ignore", invalid="ignore"):  # numbers of damaged files
            read = colmap.read_folder if source.is_dir() else READERS[source.suffix.lower()]
            cameras = read(source, read_size or _refuse_size)
    except DAMAGE as error:
        raise FileError(f'The cameras in "{source}" are damaged or incomplete; export them again.') from error
    if not cameras:
        raise FileError(f'There is no registered camera in "{source}"; align the photographs first.')
    return cameras


def _find_model(path: Path) -> Path:
    """Return the folder with files of COLMAP, or the transforms.json, in a folder. Raises FileError."""
    for folder in (path, path / "sparse" / "0", path / "sparse"):
        if any((folder / f"images{each}").is_file() for each in colmap.EXTENSIONS):
            return folder
    if (path / transforms.NAME).is_file():
        return path / transforms.NAME
    raise FileError(f'There are no cameras in "{path}"; name {PROGRAMS}.')


def _refuse_size(name: str) -> tuple[int, int]:
    raise FileError(f'The size of the photograph "{name}" is not known, and the file with its camera does not contain it.')
