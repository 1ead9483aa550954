"""Specification of the capture of one level, and the file that passes it to worker processes."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from ...billboards.texels import Texels
from ...errors import FileError
from .array_archives import READ_ERRORS, read_archive, write_archive
from .observations import QuadFaceTable

ARRAYS = ("texture_size", "pixels", "quad_indices", "positions", "steps", "shown_face_offsets", "shown_faces", "error")


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
            OSError: the file cannot be written.
        """
        texels = self.texels
        texel_arrays = texels.pixels, texels.quad_indices, texels.positions, texels.steps
        arrays = np.array(texels.texture_size), *texel_arrays, self.shown_face_offsets, self.shown_faces, np.array(self.error)
        path.write_bytes(write_archive(dict(zip(ARRAYS, arrays, strict=True))))


def load_capture_spec(path: Path) -> LevelCaptureSpec:
    """Read a specification that `LevelCaptureSpec.save` has written.

    Raises:
        FileError: the file is missing or damaged.
    """
    try:
        with path.open("rb") as stream:
            texture_size, *texel_arrays, offsets, faces, error_length = read_archive(stream, *ARRAYS)
        width, height = texture_size.tolist()
        return LevelCaptureSpec(Texels((width, height), *texel_arrays), offsets, faces, float(error_length))
    except (*READ_ERRORS, TypeError) as error:
        raise FileError(f'The snapshot "{path}" cannot be read: {error}. Start the bake again; finished views are reused.') from error
