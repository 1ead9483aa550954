"""Cameras of photographs from the files of other programs."""

import struct
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath
from xml.etree import ElementTree as ET

import numpy as np

from ...errors import FileError
from ...files.file_access import convert_os_errors, is_unicode
from ...geometry.lenses import PhotoCamera
from . import bundler, colmap, json_files, metashape, openmvs, pairs, transforms
from .camera_notes import CameraNotes, UnusableCameraError
from .reading import ReadSize, check_rotation

PROGRAMS = (
    "a folder with the files cameras and images of COLMAP (.txt or .bin), a transforms.json, an .sfm file of Meshroom, an .out file of "
    "Bundler, an .nvm file of VisualSFM, an .mvs file of OpenMVS, an .xml file of Metashape, or a .pairs file with pairs of points"
)
READERS = {  # by extension; formats that contain the sizes of the photographs do not ask for them
    ".xml": metashape.read_metashape,
    ".sfm": json_files.read_json_file,
    ".json": json_files.read_json_file,
    ".out": bundler.read_bundler,
    ".nvm": bundler.read_nvm,
    ".mvs": openmvs.read_openmvs,
    ".pairs": pairs.read_pairs,
}
DAMAGE = (
    *(ValueError, KeyError, TypeError, IndexError, AttributeError, ArithmeticError, RecursionError),
    *(struct.error, ET.ParseError),
)  # what readers raise where a file is damaged
MAX_POSITION = 1e12  # along each axis


@dataclass(frozen=True)
class CameraFile:
    """The cameras in a file, and sentences about what of the file they leave out."""

    cameras: list[PhotoCamera]
    notes: list[str]


def read_cameras(path: Path, read_size: ReadSize | None = None) -> list[PhotoCamera]:
    """Return the cameras that `read_camera_file` returns."""
    return read_camera_file(path, read_size).cameras


def read_camera_file(path: Path, read_size: ReadSize | None = None) -> CameraFile:
    """Read the registered cameras in a file of one of PROGRAMS, or in the largest of the subfolders `sparse/0`, ... of a folder.

    Cameras that are disabled, or whose lens no model here has, are skipped. Backslashes in names become slashes.

    read_size: returns width and height of the photograph with a name; called for formats that do not contain them.

    Raises:
        FileError: there are none, none can be used, a file cannot be read or is damaged, or sizes are needed and cannot be read.
        GeometryError: a photograph cannot be registered by its pairs of points, see `register`.
    """
    notes = CameraNotes()
    with convert_os_errors(f'Cannot read "{path}"'):
        is_file = path.suffix.lower() in READERS and not path.is_dir()
        source = path if is_file else _find_model(path, notes)
        is_model = not is_file and source.is_dir()
    try:
        with np.errstate(all="ignore"):  # numbers of damaged files
            read = colmap.read_folder if is_model else READERS[source.suffix.lower()]
            cameras = _drop_equal_names([_check(camera) for camera in read(source, read_size or _refuse_size, notes)], notes)
    except DAMAGE as error:
        raise FileError(f'The cameras in "{source}" are damaged or incomplete; export them again.') from error
    if not cameras and notes.skipped:
        raise FileError(f'No camera in "{source}" can be used: {notes.skipped}; undistort the photographs, or export other cameras.')
    if not cameras:
        raise FileError(f'There is no registered camera in "{source}"; align the photographs first.')
    return CameraFile(cameras, notes.sentences)


def _check(camera: PhotoCamera) -> PhotoCamera:
    """Return a camera with slashes in its name. Raises ValueError if it has no name, no rotation, or is too far away; its lens has checked
    itself."""
    name = camera.name.replace("\\", "/").strip()
    last = PurePosixPath(name).name
    if (
        last in ("", "..")
        or last.endswith(":")
        or "\0" in name
        or not is_unicode(name)
        or not (np.abs(camera.position) <= MAX_POSITION).all()
    ):
        raise ValueError("not a camera")
    check_rotation(camera.rotation, camera.translation)
    return replace(camera, name=name)


def _drop_equal_names(cameras: list[PhotoCamera], notes: CameraNotes) -> list[PhotoCamera]:
    """Return the cameras without those whose name others have, too, so that nobody knows which photograph is theirs; the first one of those
    that are equal."""
    groups: dict[str, list[PhotoCamera]] = {}
    for camera in cameras:
        groups.setdefault(camera.name, []).append(camera)
    kept = []
    for name, (first, *others) in groups.items():
        with notes.skip_unusable(name):
            for other in others:
                if not (np.allclose(first.rotation, other.rotation) and np.allclose(first.translation, other.translation)):
                    raise UnusableCameraError("several cameras have this name")
            kept.append(first)
    return kept


def _find_model(path: Path, notes: CameraNotes) -> Path:
    """Return the folder with files of COLMAP, or the transforms.json, in a folder. Raises FileError or OSError."""
    models = sorted((path / "sparse").glob("[0-9]*"), key=lambda folder: (-colmap.measure_model(folder), folder.name))
    for folder in (path, *models[:1], path / "sparse"):
        if colmap.measure_model(folder):
            others = sorted(each.name for each in models[1:] if colmap.measure_model(each)) if folder in models else []
            if others:
                notes.remark(f"Only the largest model of COLMAP was read, sparse/{folder.name}, not {', '.join(others)}.")
            return folder
    for name in transforms.NAMES:
        if (path / name).is_file():
            return path / name
    if path.is_file():
        raise FileError(f'"{path}" is no file with cameras that Farfield reads; name {PROGRAMS}.')
    raise FileError(f'There are no cameras in "{path}"; name {PROGRAMS}.')


def _refuse_size(name: str) -> tuple[int, int]:
    raise FileError(f'The size of the photograph "{name}" is not known, and the file with its camera does not contain it.')
