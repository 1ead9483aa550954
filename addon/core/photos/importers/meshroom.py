"""Cameras of Meshroom (AliceVision): `.sfm` files and their `.json` twins. Numbers are texts; rotations are column-major."""

from pathlib import Path
from typing import Any

import numpy as np

from ...errors import FileError
from ...geometry.lenses import MODELS, Lens, PhotoCamera
from .camera_notes import CameraNotes, UnusableCameraError
from .reading import check_rotation

OFFSET_VERSION = (1, 2, 1)  # from here on, principal points are offsets from the center of the image
LENSES = {  # model of the distortion to that of the lens, and the places of its parameters among the coefficients
    "none": ("PINHOLE", ()),
    "radialk1": ("FULL_OPENCV", (0,)),
    "radialk3": ("FULL_OPENCV", (0, 1, 4)),
    "brown": ("FULL_OPENCV", (0, 1, 4, 2, 3)),
    "fisheye4": ("OPENCV_FISHEYE", (0, 1, 2, 3)),
    "fisheye1": ("FOV", (0,)),
}
PROJECTIONS = {"pinhole", "radial1", "radial3", "brown", "fisheye1", "fisheye4"}  # types of intrinsics; in old files those of distortions
OLD_TYPES = {"pinhole": "none", "radial1": "radialk1", "radial3": "radialk3"}  # other names are the same in old files
MAX_RATIO_ERROR = 1e-6


def read_meshroom(document: dict[str, Any], path: Path, notes: CameraNotes) -> list[PhotoCamera]:
    """Read the cameras of all views of a `document` with a pose, in the order of their names. Views of rigs, with anamorphic pixels, or
    with a projection or distortion that no lens model here has are skipped. Raises FileError if there is no view with a pose."""
    version = tuple(int(part) for part in document.get("version", ("1", "0", "0")))
    intrinsics = {item["intrinsicId"]: item for item in document.get("intrinsics", [])}
    poses = {item["poseId"]: item["pose"]["transform"] for item in document.get("poses", [])}
    if not poses:
        raise FileError(f'"{path}" has no poses; run the node StructureFromMotion, and name its file.')
    cameras = []
    for view in document.get("views", []):
        if view["poseId"] in poses:
            with notes.skip_unusable(str(view["path"])):
                cameras.append(_build_camera(view, intrinsics.get(view["intrinsicId"]), poses[view["poseId"]], version))
    return sorted(cameras, key=lambda camera: camera.name)


def _build_camera(view: dict[str, Any], intrinsic: dict[str, Any] | None, pose: dict[str, Any], version: tuple[int, ...]) -> PhotoCamera:
    if "rigId" in view and "subPoseId" in view and view.get("isPoseIndependant") in ("false", "0", False):
        raise UnusableCameraError("it belongs to a rig of cameras")
    if intrinsic is None:
        raise UnusableCameraError("it has no intrinsics")
    rotation = np.array([float(value) for value in pose["rotation"]]).reshape(3, 3).T
    center = np.array([float(value) for value in pose["center"]]).reshape(3)
    check_rotation(rotation, center)
    return PhotoCamera(str(view["path"]), _build_lens(intrinsic, version), rotation, -rotation @ center)


def _build_lens(intrinsic: dict[str, Any], version: tuple[int, ...]) -> Lens:
    size = (int(intrinsic["width"]), int(intrinsic["height"]))
    center = np.array([float(value) for value in intrinsic["principalPoint"]]).reshape(2)
    if version >= OFFSET_VERSION:
        center = center + 0.5 * np.array(size)
    projection, undistortion = str(intrinsic.get("type", "pinhole")), str(intrinsic.get("undistortionType") or "none")
    kind = intrinsic.get("distortionType") or OLD_TYPES.get(projection, projection)
    for unknown in (projection not in PROJECTIONS and projection, kind not in LENSES and kind, undistortion != "none" and undistortion):
        if unknown:
            raise UnusableCameraError(f'its lens is of the type "{unknown}"')
    model, places = LENSES[kind]
    coefficients = np.zeros(MODELS[model].coefficient_count)
    parameters = [float(value) for value in intrinsic.get("distortionParams") or ()]
    if len(parameters) > len(places) and any(parameters[len(places) :]):
        raise ValueError("more parameters than the model has")
    for place, value in zip(places, parameters, strict=False):
        coefficients[place] = value
    return Lens(model, size, _read_focal(intrinsic, size), (float(center[0]), float(center[1])), tuple(coefficients.tolist()))


def _read_focal(intrinsic: dict[str, Any], size: tuple[int, int]) -> tuple[float, float]:
    if "pxFocalLength" in intrinsic:
        values = intrinsic["pxFocalLength"]
        numbers = [float(value) for value in (values if isinstance(values, list) else [values])]
        return numbers[0], numbers[-1]
    if abs(float(intrinsic.get("pixelRatio", 1.0)) - 1.0) > MAX_RATIO_ERROR:
        raise UnusableCameraError("its pixels are not square")
    focal = float(intrinsic["focalLength"]) / float(intrinsic["sensorWidth"]) * size[0]
    return focal, focal
