"""What the capture of a level needs to know of it, and the file that tells a worker."""

import zipfile
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from ..errors import FileError
from .texels import Belonging, Texels


@dataclass(frozen=True)
class LevelOrder:
    """One level of a cloud, to be captured.

    texels: in world space. drawn_offsets (Q + 1,), drawn (D,) int64: the faces of the source that its quads show, see `Quads`. error: a
    length.
    """

    texels: Texels
    drawn_offsets: np.ndarray
    drawn: np.ndarray
    error: float

    @cached_property
    def belongs(self) -> Belonging:
        """Which faces each quad shows."""
        return Belonging(self.drawn_offsets, self.drawn, int(self.drawn.max()) + 1)

    def save(self, path: Path) -> None:
        """Write all of it to `path`, a .npz file.

        Raises:
            FileError: when the disk does not take it.
        """
        texels = self.texels
        arrays = {
            "size": np.array(texels.size),
            "pixels": texels.pixels,
            "quads": texels.quads,
            "positions": texels.positions,
            "steps": texels.steps,
            "drawn_offsets": self.drawn_offsets,
            "drawn": self.drawn,
            "error": np.array(self.error),
        }
        try:
            np.savez(path, **arrays)
        except OSError as error:
            raise FileError(f'The snapshot "{path}" cannot be written: {error}. Free some space there and bake again.') from error


def load_order(path: Path) -> LevelOrder:
    """What `LevelOrder.save` has written.

    Raises:
        FileError: when it is gone or damaged.
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            width, height = file["size"].tolist()
            texels = Texels((width, height), *(file[name] for name in ("pixels", "quads", "positions", "steps")))
            return LevelOrder(texels, file["drawn_offsets"], file["drawn"], float(file["error"]))
    except (OSError, KeyError, ValueError, zipfile.BadZipFile) as error:
        raise FileError(f'The snapshot "{path}" cannot be read: {error}. Bake again; views that stand are kept.') from error
