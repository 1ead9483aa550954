"""Specification of the capture of one level, and the file that passes it to worker processes."""

import zipfile
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from ...billboards.texels import Texels
from ...errors import FileError
from .observations import QuadFaceTable


@dataclass(frozen=True)
class LevelCaptureSpec:
    """The level to capture.

    texels: in world space. shown_face_offsets (Q + 1,), shown_faces (D,) int64: the source faces that each quad shows; quad q shows
    shown_faces[shown_face_offsets[q]:shown_face_offsets[q + 1]]. error: of the level, a length.
    """

    texels: Texels
    shown_face_offsets: np.ndarray
    shown_faces: np.ndarray
    error: float

    @cached_property
    def quad_faces(self) -> QuadFaceTable:
        """Lookup table of the faces of each quad."""
        return QuadFaceTable(self.shown_face_offsets, self.shown_faces, int(self.shown_faces.max()) + 1)

    def save(self, path: Path) -> None:
        """Write the specification to `path`, a .npz file.

        Raises:
            FileError: the file cannot be written.
        """
        texels = self.texels
        arrays = {
            "texture_size": np.array(texels.texture_size),
            "pixels": texels.pixels,
            "quad_indices": texels.quad_indices,
            "positions": texels.positions,
            "steps": texels.steps,
            "shown_face_offsets": self.shown_face_offsets,
            "shown_faces": self.shown_faces,
            "error": np.array(self.error),
        }
        try:
            np.savez(path, **arrays)
        except OSError as error:
            raise FileError(f'The snapshot "{path}" cannot be written: {error}. Free disk space there and start the bake again.') from error


def load_capture_spec(path: Path) -> LevelCaptureSpec:
    """Read a specification that `LevelCaptureSpec.save` has written.

    Raises:
        FileError: the file is missing or damaged.
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            width, height = file["texture_size"].tolist()
            texels = Texels((width, height), *(file[name] for name in ("pixels", "quad_indices", "positions", "steps")))
            return LevelCaptureSpec(texels, file["shown_face_offsets"], file["shown_faces"], float(file["error"]))
    except (OSError, KeyError, ValueError, zipfile.BadZipFile) as error:
        raise FileError(f'The snapshot "{path}" cannot be read: {error}. Start the bake again; finished views are reused.') from error
