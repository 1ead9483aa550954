"""Cameras in JSON files, whose content tells which program wrote them."""

import json
from pathlib import Path
from typing import Any

from ...errors import FileError
from ...files.file_access import read_file
from ...geometry.lenses import PhotoCamera
from .camera_notes import CameraNotes
from .meshroom import read_meshroom
from .reading import ReadSize
from .transforms import read_transforms

OTHERS = (  # files that are not read: keys of the document or its first item, and what it is
    ({"sfm_data_version"}, "a file of OpenMVG, which can export COLMAP or OpenMVS"),
    ({"cameras", "shots"}, "a reconstruction of OpenSfM or WebODM, which can export COLMAP, Bundler or VisualSFM"),
    ({"img_name", "rotation"}, "a cameras.json of Gaussian Splatting, which is made of the cameras of COLMAP"),
    ({"file_path", "transform"}, "a list of poses without lenses of nerfstudio, which reads a transforms.json"),
    ({"camera_path"}, "a camera path of nerfstudio, which has no photographs"),
    ({"keyframes"}, "a camera path of nerfstudio, which has no photographs"),
    ({"transform", "scale"}, "a transform of the scene of nerfstudio, and its cameras are in a transforms.json"),
    ({"class_name", "version_major"}, "a file of Open3D, which has no photographs"),
    ({"t_00", "t_03"}, "the camera of one photograph of Polycam, which nerfstudio converts to a transforms.json"),
)


def read_json_file(path: Path, read_size: ReadSize, notes: CameraNotes) -> list[PhotoCamera]:
    """Read the cameras of a transforms.json or a file of Meshroom. Raises FileError if the file cannot be read, or is another one."""
    document = json.loads(read_file(path))
    if isinstance(document, dict) and "frames" in document:
        return read_transforms(document, path, read_size, notes)
    found = _name_program(document)
    if found is None and isinstance(document, dict) and ("views" in document or "intrinsics" in document or path.suffix.lower() == ".sfm"):
        return read_meshroom(document, path, notes)
    found = found or "no file with cameras that Farfield reads: it has neither frames, as a transforms.json, nor views, as one of Meshroom"
    raise FileError(f'"{path}" is {found}; export the cameras in another format.')


def _name_program(document: Any) -> str | None:
    first = document[0] if isinstance(document, list) and document else document
    keys = set(first) if isinstance(first, dict) else set()
    return next((name for marks, name in OTHERS if marks <= keys), None)
