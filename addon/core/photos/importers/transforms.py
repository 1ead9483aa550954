"""Cameras of NeRF programs: `transforms.json`, as written by instant-ngp, nerfstudio and many converters.

Matrices turn camera space into world space; cameras look along -z, with y up, as in OpenGL and Blender.
"""

import math
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import FileError
from ...geometry.lenses import Lens, PhotoCamera
from .camera_notes import UNUSED_MASKS, CameraNotes, UnusableCameraError
from .reading import FLIP, ReadSize

NAMES = ("transforms.json", "transforms_train.json")
MAX_SCALE_ERROR = 1e-3  # between products of the columns of a matrix and those of perpendicular vectors, relative
PERSPECTIVE_MODELS = {"", "PERSPECTIVE", "SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV"}
FULL_MODEL, FISHEYE_MODEL = "FULL_OPENCV", "OPENCV_FISHEYE"
OTHER_LENSES = ("equirectangular", "latlong", "ftheta_p0", "orthographic")  # keys by which instant-ngp marks lenses


def read_transforms(document: dict[str, Any], path: Path, read_size: ReadSize, notes: CameraNotes) -> list[PhotoCamera]:
    """Read the cameras of all frames of a `document`, in the order of the file.

    The world is that before `applied_transform` and `applied_scale`, by which nerfstudio moves the cameras of other programs.

    read_size: returns width and height of a photograph; called if the file does not contain them.

    Raises:
        FileError: the file lacks a focal length, or a matrix is none of a camera.
    """
    applied = _read_applied(document)
    if applied is not None:
        notes.remark("The cameras are where they were before the applied_transform of nerfstudio.")
    if any("mask_path" in frame for frame in document["frames"]):
        notes.remark(UNUSED_MASKS)
    cameras = []
    for frame in document["frames"]:
        with notes.skip_unusable(str(frame["file_path"])):
            cameras.append(_build_camera({**document, **frame}, applied, path, read_size))
    return cameras


def _read_applied(document: dict[str, Any]) -> tuple[np.ndarray, np.ndarray] | None:
    """Return the matrix (3, 3) and the translation (3,) that were applied to the cameras, None if there are none. Raises ValueError."""
    if "applied_transform" not in document and "applied_scale" not in document:
        return None
    matrix = np.array(document.get("applied_transform", np.eye(4)[:3]), np.float64)[:3]
    matrix = float(document.get("applied_scale", 1.0)) * matrix
    if matrix.shape != (3, 4) or not np.isfinite(matrix).all() or np.linalg.det(matrix[:, :3]) <= 0.0:
        raise ValueError("not a transform")
    is_identity = np.array_equal(matrix, np.eye(4)[:3])
    return None if is_identity else (matrix[:, :3], matrix[:, 3])


def _build_camera(values: dict[str, Any], applied: tuple[np.ndarray, np.ndarray] | None, path: Path, read_size: ReadSize) -> PhotoCamera:
    matrix = np.array(values["transform_matrix"], np.float64)
    if matrix.shape not in ((4, 4), (3, 4)) or not np.isfinite(matrix).all():
        raise ValueError("not a matrix")
    if len(matrix) == 4 and not np.allclose(matrix[3], (0.0, 0.0, 0.0, 1.0)):
        raise FileError(f'A frame in "{path}" has a transposed or damaged matrix: its last row is not 0, 0, 0, 1; export it again.')
    axes, position = matrix[:3, :3], matrix[:3, 3]
    if applied is not None:
        axes, position = np.linalg.solve(applied[0], axes), np.linalg.solve(applied[0], position - applied[1])
    lengths = np.linalg.norm(axes, axis=0)
    if np.abs(axes.T @ axes - np.diag(lengths**2)).max() > MAX_SCALE_ERROR * max(lengths.max() ** 2, 1e-30) or np.linalg.det(axes) <= 0.0:
        raise FileError(f'A frame in "{path}" has a mirrored or sheared matrix; export the cameras again.')
    rotation = FLIP @ (axes / lengths).T
    name = str(values["file_path"]).removeprefix("./")
    return PhotoCamera(name, _build_lens(values, name, path, read_size), rotation, -rotation @ position)


def _build_lens(values: dict[str, Any], name: str, path: Path, read_size: ReadSize) -> Lens:
    model = str(values.get("camera_model") or "").upper()
    is_fisheye = model in (FISHEYE_MODEL, "FISHEYE") or bool(values.get("is_fisheye"))
    other = next((key for key in OTHER_LENSES if values.get(key)), None)
    if other or not (is_fisheye or model == FULL_MODEL or model in PERSPECTIVE_MODELS):
        raise UnusableCameraError(f"its camera model is {other or model}")
    size = (int(values["w"]), int(values["h"])) if "w" in values and "h" in values else read_size(name)  # the first ones of NeRF have none
    focal, center = _read_focal(values, size, path), (float(values.get("cx", 0.5 * size[0])), float(values.get("cy", 0.5 * size[1])))
    k1, k2, k3, k4, k5, k6, p1, p2 = (float(values.get(key, 0.0)) for key in ("k1", "k2", "k3", "k4", "k5", "k6", "p1", "p2"))
    if is_fisheye:
        return Lens(FISHEYE_MODEL, size, focal, center, (k1, k2, k3, k4))
    if k4 and model != FULL_MODEL:
        raise UnusableCameraError("its lens has a coefficient k4, which only fisheye lenses may have")
    if k3 or model == FULL_MODEL:
        return Lens(FULL_MODEL, size, focal, center, (k1, k2, p1, p2, k3, k4, k5, k6))
    return Lens("OPENCV", size, focal, center, (k1, k2, p1, p2))


def _read_focal(values: dict[str, Any], size: tuple[int, int], path: Path) -> tuple[float, float]:
    """Return the focal lengths in pixels from those in the file, or from fields of view. Raises FileError if there is none."""
    found = []
    for axis, side in zip("xy", size, strict=True):
        if f"fl_{axis}" in values:
            found.append(float(values[f"fl_{axis}"]))
        elif f"camera_angle_{axis}" in values and "fl_x" not in values:
            found.append(0.5 * side / math.tan(0.5 * float(values[f"camera_angle_{axis}"])))
    if not found:
        raise FileError(f'"{path}" contains no focal length (fl_x or camera_angle_x); add it to the file.')
    return found[0], found[-1]
