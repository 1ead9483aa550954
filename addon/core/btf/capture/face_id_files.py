"""ID buffers of views, kept until the other renders of their view are finished."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .shard_files import ViewFiles


@dataclass(frozen=True)
class FaceIdFiles:
    """The ID buffers in `folder`, one file per view."""

    folder: Path

    def write(self, view: int, face_ids: np.ndarray) -> None:
        """Write the ID buffer (H, W) int32 of a view. Raises FileError."""
        self._files.write(view, {"face_ids": face_ids}, compressed=True)

    def read(self, view: int) -> np.ndarray:
        """Return the ID buffer of a view. Raises FileError."""
        return self._files.read(view, "face_ids")[0]

    def remove(self, view: int) -> None:
        """Delete the ID buffer of a view if it exists."""
        self._files.remove(view)

    @property
    def _files(self) -> ViewFiles:
        return ViewFiles(self.folder, "face-ids")
