"""Cameras of NeRF programs: `transforms.json`, as written by instant-ngp, nerfstudio and many converters.

Matrices turn camera space into world space; cameras look along -z, with y up, as in OpenGL and Blender.
"""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import FileError
from ...geometry.lenses import Lens, PhotoCamera
from .reading import FLIP, ReadSize, read_file

NAME = "transforms.json"
MAX_SCALE_ERROR = 1e-3  # between products of the columns of a matrix and those of perpendicular vectors, relative


def read_transforms(path: Path, _read_size: ReadSize) -> list[PhotoCamera]:
    """Read the cameras of all frames, in the order of the file. Raises FileError if the file cannot be read, or lacks a size or a focal
    length."""
    document = json.loads(read_file(path))
    return [_build_camera({**document, **frame}, path) for frame in document["frames"]]


def _build_camera(values: dict[str, Any], path: Path) -> PhotoCamera:
    matrix = np.array(values["transform_matrix"], np.float64)
    if matrix.shape not in ((4, 4), (3, 4)) or not np.isfinite(matrix).all():
        raise ValueError("not a matrix")
    axes = matrix[:3, :3]
    lengths = np.linalg.norm(axes, axis=0)
    if np.abs(axes.T @ axes - np.diag(lengths**2)).max() > MAX_SCALE_ERROR * max(lengths.max() ** 2, 1e-30) or np.linalg.det(axes) <= 0.0:
        raise FileError(f'A frame in "{path}" has a mirrored or sheared matrix; export the cameras again.')
    rotation = FLIP @ (axes / lengths).T
    return PhotoCamera(str(values["file_path"]).removeprefix("./"), _build_lens(values, path), rotation, -rotation @ matrix[:3, 3])


def _build_lens(values: dict[str, Any], path: Path) -> Lens:
    if "w" not in values or "h" not in values:
        raise FileError(f'"{path}" does not contain the sizes of the photographs (w and h); add them to the file.')
    size = (int(values["w"]), int(values["h"]))
    if "fl_x" in values:
        focal_x = float(values["fl_x"])
    elif "camera_angle_x" in values:
        focal_x = 0.5 * size[0] / math.tan(0.5 * float(values["camera_angle_x"]))
    else:
        raise FileError(f'"{path}" contains no focal length (fl_x or camera_angle_x); add it to the file.')
    focal = (focal_x, float(values.get("fl_y", focal_x)))
    center = (float(values.get("cx", 0.5 * size[0])), float(values.get("cy", 0.5 * size[1])))
    k1, k2, k3, k4, p1, p2 = (float(values.get(name, 0.0)) for name in ("k1", "k2", "k3", "k4", "p1", "p2"))
    if values.get("camera_model") == "OPENCV_FISHEYE" or values.get("is_fisheye"):
        return Lens("OPENCV_FISHEYE", size, focal, center, (k1, k2, k3, k4))
    if k4:
        raise FileError(f'A lens in "{path}" has a coefficient k4, which only fisheye lenses may have; undistort the photographs first.')
    if k3:
        return Lens("FULL_OPENCV", size, focal, center, (k1, k2, p1, p2, k3, 0.0, 0.0, 0.0))
    return Lens("OPENCV", size, focal, center, (k1, k2, p1, p2))
