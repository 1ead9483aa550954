"""Cameras of OpenMVS: interface files `.mvs` (signature MVSI, versions 1 to 7), whose photographs are undistorted."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...errors import FileError
from ...files.file_access import read_file
from ...geometry.lenses import Lens, PhotoCamera
from .camera_notes import UNUSED_MASKS, CameraNotes
from .reading import BinaryReader, ReadSize, check_rotation

SIGNATURE = b"MVSI"
MAX_VERSION = 7
NO_ID = 2**32 - 1
INTRINSICS_BYTES = 72
POSE_BYTES = 96  # rotation and position
VIEW_SCORE_BYTES = 24
HALF_PIXEL = 0.5


@dataclass(frozen=True)
class _Mount:
    """A camera on a platform."""

    size: tuple[int, int]  # zeros if the intrinsics are relative to the longer side
    intrinsics: np.ndarray
    rotation: np.ndarray
    position: np.ndarray


def read_openmvs(path: Path, read_size: ReadSize, notes: CameraNotes) -> list[PhotoCamera]:
    """Read the cameras of all images with a pose.

    read_size: returns width and height of a photograph; called if the file does not contain them.

    Raises:
        FileError: the file cannot be read, or is of another kind or version.
    """
    reader = BinaryReader(read_file(path))
    if reader.read_bytes(len(SIGNATURE)) != SIGNATURE:
        raise FileError(f'"{path}" is not an interface file of OpenMVS; save the project as one (archive type 2).')
    version, _ = reader.read("II")
    if version < 1:
        raise ValueError("no version")
    if version > MAX_VERSION:
        raise FileError(f'"{path}" has version {version} of the format, which Farfield does not know; save it with version {MAX_VERSION}.')
    platforms = [_read_platform(reader, version) for _ in range(reader.read_count(24))]
    cameras = []
    for _ in range(reader.read_count(20)):
        name = reader.read_counted_text()
        if version > 4 and reader.read_counted_text():  # name of the mask
            notes.remark(UNUSED_MASKS)
        platform_id, camera_id, pose_id = reader.read("III")
        if version > 2:
            reader.read("I")  # ID of the image
        if version > 6:
            reader.read("3f")  # depths
            reader.skip(VIEW_SCORE_BYTES * reader.read_count(VIEW_SCORE_BYTES))
        if pose_id == NO_ID:
            continue
        mounts, poses = platforms[platform_id]
        mount, (rotation, position) = mounts[camera_id], poses[pose_id]
        to_camera = mount.rotation @ rotation
        center = rotation.T @ mount.position + position
        check_rotation(to_camera, center)
        cameras.append(PhotoCamera(name, _build_lens(mount, name, read_size), to_camera, -to_camera @ center))
    return cameras


def _read_platform(reader: BinaryReader, version: int) -> tuple[list[_Mount], list[tuple[np.ndarray, np.ndarray]]]:
    """Return the cameras of a platform, and its poses: rotations from the world and positions."""
    reader.read_counted_text()
    mounts = []
    for _ in range(reader.read_count(8 + INTRINSICS_BYTES + POSE_BYTES)):
        reader.read_counted_text()
        if version > 3:
            reader.read_counted_text()  # name of the band
        size = reader.read("II")
        intrinsics = np.array(reader.read("9d")).reshape(3, 3)
        mounts.append(_Mount(size, intrinsics, *_read_pose(reader)))
    return mounts, [_read_pose(reader) for _ in range(reader.read_count(POSE_BYTES))]


def _read_pose(reader: BinaryReader) -> tuple[np.ndarray, np.ndarray]:
    return np.array(reader.read("9d")).reshape(3, 3), np.array(reader.read("3d"))


def _build_lens(mount: _Mount, name: str, read_size: ReadSize) -> Lens:
    """Return the lens of a photograph. OpenMVS counts positions from the center of the first pixel."""
    size, scale = mount.size, 1.0
    if min(size) == 0:
        size = read_size(name)
        scale = float(max(size))
    (fx, _, cx), (_, fy, cy), _ = (scale * mount.intrinsics).tolist()
    return Lens("PINHOLE", size, (fx, fy), (cx + HALF_PIXEL, cy + HALF_PIXEL))
