"""Cameras of Agisoft Metashape: the XML file of *Export Cameras*."""

from functools import cache
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree as ET

import numpy as np

from ...errors import FileError
from ...files.file_access import read_file
from ...geometry.lenses import Lens, PhotoCamera
from .camera_notes import CameraNotes, UnusableCameraError
from .reading import ReadSize, check_rotation

FORBIDDEN = (b"<!DOCTYPE", b"<!ENTITY")  # entities may expand without limit
FRAME_TYPES = {"frame": "FULL_OPENCV", "fisheye": "OPENCV_FISHEYE"}
COEFFICIENTS = ("f", "b1", "b2", "cx", "cy", "k1", "k2", "k3", "k4", "p1", "p2", "p3", "p4")
MIN_EARTH, MAX_EARTH = 6.3e6, 6.5e6  # distances in meters of cameras from the center of the Earth
GEOGRAPHIC = ("GEOGCS", "PROJCS", "COMPD_CS", "GEOCCS")  # coordinate systems whose chunks have a geocentric world


class _World(NamedTuple):
    """The similarity from the space of cameras to the world: rotation (3, 3), translation (3,) and scale."""

    rotation: np.ndarray
    translation: np.ndarray
    scale: float


def read_metashape(path: Path, _read_size: ReadSize, notes: CameraNotes) -> list[PhotoCamera]:
    """Read the aligned cameras of the first chunk that has some, in its world coordinates.

    Cameras that are disabled, or whose sensor has no calibration, is spherical, or has coefficients that no lens model here has, are
    skipped. Raises FileError if the file cannot be read, or has no chunk.
    """
    data = read_file(path)
    if any(word in data for word in FORBIDDEN):
        raise ValueError("declares entities")
    chunks = ET.fromstring(data).findall("chunk")
    if not chunks:
        raise FileError(f'"{path}" is no file of Metashape with cameras; export them as Agisoft XML.')
    aligned = [chunk for chunk in chunks if _find_aligned(chunk)] or chunks
    if len(aligned) > 1:
        notes.remark(f'Only the first of {len(aligned)} chunks was read, "{aligned[0].get("label", "")}".')
    return _read_chunk(aligned[0], notes)


def _find_aligned(chunk: ET.Element) -> list[ET.Element]:
    return [camera for camera in chunk.iterfind(".//camera") if camera.find("transform") is not None]


def _read_chunk(chunk: ET.Element, notes: CameraNotes) -> list[PhotoCamera]:
    sensors = {sensor.get("id"): sensor for sensor in chunk.iterfind("sensors/sensor")}
    read_lens = cache(lambda sensor_id: _read_lens(sensors[sensor_id]))
    chunk_world = _read_world(chunk)
    components = chunk.find("components")
    worlds = {} if components is None else {component.get("id"): _read_world(component) for component in components}
    active = None if components is None else components.get("active_id")
    reference = (chunk.findtext("reference") or "").strip()
    cameras = []
    for camera in _find_aligned(chunk):
        name = camera.get("label", "")
        with notes.skip_unusable(name):
            if not name:
                raise UnusableCameraError("no label")
            if camera.get("enabled", "true").lower() in ("false", "0"):
                raise UnusableCameraError("disabled")
            component = camera.get("component_id")
            if worlds.get(component, chunk_world) is None and component in worlds and active not in (None, component):
                raise UnusableCameraError("it belongs to a component that is not aligned with the active one")
            # Since version 1.6, a component has the transform, and the chunk none, or that of the active component.
            world = worlds.get(component) or chunk_world or _World(np.eye(3), np.zeros(3), 1.0)
            cameras.append(_build_camera(camera, name, read_lens(camera.get("sensor_id")), world))
    is_geocentric = cameras and MIN_EARTH < min(np.linalg.norm(camera.position) for camera in cameras) < MAX_EARTH
    if is_geocentric or (cameras and reference.startswith(GEOGRAPHIC)):
        notes.remark("The cameras have geocentric coordinates; export the mesh with the coordinate system WGS 84, EPSG::4978, too.")
    slaves = [camera for camera in chunk.iterfind(".//camera") if camera.get("master_id") not in (None, camera.get("id"))]
    if any(camera.find("transform") is None for camera in slaves):
        notes.remark("Cameras of a rig but its first are left out, since the file places them relative to it.")
    return cameras


def _read_lens(sensor: ET.Element) -> Lens:
    """Return the lens of a sensor. Raises UnusableCameraError."""
    calibration = sensor.find("calibration[@class='adjusted']")
    calibration = sensor.find("calibration") if calibration is None else calibration
    kind = (sensor if calibration is None else calibration).get("type", sensor.get("type", "frame"))
    if kind not in FRAME_TYPES:
        raise UnusableCameraError(f'its lens is of the type "{kind}"')
    if calibration is None:
        raise UnusableCameraError("its sensor is not calibrated")
    resolution = calibration.find("resolution")
    resolution = sensor.find("resolution") if resolution is None else resolution
    size = (int(resolution.get("width")), int(resolution.get("height")))
    f, b1, b2, cx, cy, k1, k2, k3, k4, p1, p2, p3, p4 = (float(calibration.findtext(name, "0")) for name in COEFFICIENTS)
    is_fisheye = kind == "fisheye"
    if (is_fisheye and (b2 or p1 or p2)) or p3 or p4:
        raise UnusableCameraError("its lens has coefficients that Farfield does not know")
    focal, center = (f + b1, f), (0.5 * size[0] + cx, 0.5 * size[1] + cy)
    # Metashape's p1 and p2 are those of OpenCV exchanged.
    if b2 or (k4 and not is_fisheye):
        return Lens("METASHAPE", size, focal, center, (k1, k2, p2, p1, k3, k4, b2 / focal[0]))
    coefficients = (k1, k2, k3, k4) if is_fisheye else (k1, k2, p2, p1, k3, 0.0, 0.0, 0.0)
    return Lens(FRAME_TYPES[kind], size, focal, center, coefficients)


def _read_world(element: ET.Element) -> _World | None:
    """Return the similarity of a chunk or a component, None if it has none."""
    transform = element.find("transform")
    if transform is None:
        return None
    parts = {child.tag: _numbers(child) for child in transform}
    rotation, translation = parts.get("rotation", np.eye(3)).reshape(3, 3), parts.get("translation", np.zeros(3)).reshape(3)
    return _World(rotation, translation, float(parts.get("scale", np.ones(1))[0]))


def _build_camera(camera: ET.Element, name: str, lens: Lens, world: _World) -> PhotoCamera:
    pose = _numbers(camera.find("transform")).reshape(4, 4)
    rotation = (world.rotation @ pose[:3, :3]).T
    center = world.scale * world.rotation @ pose[:3, 3] + world.translation
    check_rotation(rotation, center)
    return PhotoCamera(name, lens, rotation, -rotation @ center)


def _numbers(element: ET.Element) -> np.ndarray:
    return np.array([float(value) for value in element.text.split()])
