"""Cameras of Agisoft Metashape: the XML file of *Export Cameras*."""

from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np

from ...errors import FileError
from ...geometry.lenses import Lens, PhotoCamera
from .reading import ReadSize, check_rotation, read_file

FORBIDDEN = (b"<!DOCTYPE", b"<!ENTITY")  # entities may expand without limit
FRAME_TYPES = {"frame": "FULL_OPENCV", "fisheye": "OPENCV_FISHEYE"}


def read_metashape(path: Path, _read_size: ReadSize) -> list[PhotoCamera]:
    """Read the aligned cameras of the first chunk, in its world coordinates. Raises FileError if the file cannot be read, or has a lens
    with skew, spherical projection or other coefficients that no lens model here has."""
    data = read_file(path)
    if any(word in data for word in FORBIDDEN):
        raise ValueError("declares entities")
    chunk = ET.fromstring(data).find("chunk")
    if chunk is None:
        raise ValueError("no chunk")
    lenses = {sensor.get("id"): _read_lens(sensor, path) for sensor in chunk.iterfind("sensors/sensor")}
    matrix = _read_chunk_matrix(chunk)
    return [_build_camera(camera, lenses, matrix) for camera in chunk.iterfind(".//camera") if camera.find("transform") is not None]


def _read_lens(sensor: ET.Element, path: Path) -> Lens | None:
    """Return the lens of a sensor, or None if it was not calibrated."""
    calibration = sensor.find("calibration[@class='adjusted']")
    calibration = sensor.find("calibration") if calibration is None else calibration
    if calibration is None:
        return None
    kind = calibration.get("type", sensor.get("type", "frame"))
    if kind not in FRAME_TYPES:
        raise FileError(f'"{path}" has a lens of the type "{kind}"; export undistorted photographs instead.')
    resolution = calibration.find("resolution")
    size = (int(resolution.get("width")), int(resolution.get("height")))
    values = {child.tag: float(child.text) for child in calibration if child.tag != "resolution"}
    f, b1, b2, cx, cy, k1, k2, k3, k4, p1, p2 = (
        values.get(name, 0.0) for name in ("f", "b1", "b2", "cx", "cy", "k1", "k2", "k3", "k4", "p1", "p2")
    )
    is_fisheye = kind == "fisheye"
    if b2 or (p1 or p2 if is_fisheye else k4) or values.get("p3") or values.get("p4"):
        raise FileError(f'A lens in "{path}" has skew or coefficients that Farfield does not know; export undistorted photographs instead.')
    focal, center = (f + b1, f), (0.5 * size[0] + cx, 0.5 * size[1] + cy)
    # Metashape's p1 and p2 are those of OpenCV exchanged.
    coefficients = (k1, k2, k3, k4) if is_fisheye else (k1, k2, p2, p1, k3, 0.0, 0.0, 0.0)
    return Lens(FRAME_TYPES[kind], size, focal, center, coefficients)


def _read_chunk_matrix(chunk: ET.Element) -> tuple[np.ndarray, np.ndarray, float]:
    """Return rotation (3, 3), translation (3,) and scale from the chunk to its world."""
    transform = chunk.find("transform")
    parts = {} if transform is None else {child.tag: _numbers(child) for child in transform}
    rotation = parts.get("rotation", np.eye(3)).reshape(3, 3)
    return rotation, parts.get("translation", np.zeros(3)).reshape(3), float(parts.get("scale", np.ones(1))[0])


def _build_camera(camera: ET.Element, lenses: dict, matrix: tuple[np.ndarray, np.ndarray, float]) -> PhotoCamera:
    chunk_rotation, chunk_translation, scale = matrix
    pose = _numbers(camera.find("transform")).reshape(4, 4)
    rotation = (chunk_rotation @ pose[:3, :3]).T
    center = scale * chunk_rotation @ pose[:3, 3] + chunk_translation
    lens = lenses[camera.get("sensor_id")]
    if lens is None:
        raise ValueError("no lens")
    check_rotation(rotation, center)
    return PhotoCamera(camera.get("label", ""), lens, rotation, -rotation @ center)


def _numbers(element: ET.Element) -> np.ndarray:
    return np.array([float(value) for value in element.text.split()])
