"""Bidirectional texture functions as `.btf` files in the full-matrix-factorisation layout of the Bonn database (UBO2014), one matrix a
channel ("DFMF").

Such a file holds, for every channel, a matrix with a row for each view and light and a column for each pixel as U S V': the left singular
vectors, the singular values, and S V'. Our weights and basis are a product of that kind already, so nothing of them is lost but
rounding. Lobes are none: their highlights take further components, found by a randomised range finder (Halko, Martinsson, Tropp 2011).
"""

import struct
from collections.abc import Iterator
from typing import BinaryIO

import numpy as np

from ..directions import to_spherical
from ..errors import FileError, SettingsError
from ..progress import Progress, Steps, scaled
from .decoding import BakedAtlas

SIGNATURE = b"!DFMF08FC"
VERSION = 4  # of the header: the first with named channels
CHANNELS = ("R", "G", "B")
NOTE = b"<farfield>radiance under a sun of unit irradiance, scene-linear Rec.709, angles in the object's frame</farfield>"
LARGEST = 2**32 - 1  # bytes: readers count the parts of the file with 32 bits
SCALAR = np.dtype("<f4")
PIECE = 30_000_000  # numbers of the matrix in memory at once
FOR_LOBES = 52  # components more where there are lobes
OVERSAMPLED, POWER = 8, 1  # columns, and iterations, of the range finder
LOOKING = "Looking at the textures from all sides"


def write_fmf(stream: BinaryIO, atlas: BakedAtlas, views: np.ndarray, lights: np.ndarray, pixels_per_millimetre: float) -> Steps[None]:
    """Write a level's colours from unit directions `views` (N, 3) under `lights` (N, 3), both in the object's frame.

    The layout has no negative guard: what the shader cuts at 0 stays as it is.

    Raises:
        SettingsError: when there are not as many views as lights, which readers of the layout count on.
        FileError: when a part of the file would be larger than the layout can say.
    """
    if len(views) != len(lights):
        raise SettingsError(f"A .btf file needs as many lights as views, not {len(views)} and {len(lights)}; take the directions of Bonn.")
    width, height = atlas.size
    rows = len(views) * len(lights)
    components = min(rows, width * height, atlas.colour.clusters * atlas.colour.components + (0 if atlas.lobes is None else FOR_LOBES))
    if len(CHANNELS) * max(rows, width * height) * components * SCALAR.itemsize > LARGEST:
        raise FileError(f"{width} x {height} pixels with {components} components are more than a .btf file can hold; bake a coarser level.")
    matrix = _Matrix(atlas, views, lights)
    bases = yield from scaled(_range(matrix, components), 0.0, 0.6)
    stream.write(_header(pixels_per_millimetre))
    stream.write(_directions(views, lights))
    stream.write(struct.pack("<II", width, height))
    stream.write(struct.pack("<II12f", components, 0, 0.0, 0.0, 0.0, *np.eye(3).ravel()))  # colours as they are: no mean, no transform
    projected = np.empty((len(CHANNELS), bases.shape[2], width * height), np.float32)
    for done, (pixels, columns) in enumerate(matrix.pieces()):
        yield Progress(0.6 + 0.3 * done / matrix.count, LOOKING)
        projected[:, :, pixels] = bases.transpose(0, 2, 1) @ columns
    for channel in range(len(CHANNELS)):
        yield Progress(0.9 + 0.1 * channel / len(CHANNELS), f"Writing channel {channel + 1} of {len(CHANNELS)}")
        values, turn = np.linalg.eigh(projected[channel].astype(np.float64) @ projected[channel].T)
        strengths, turn = np.sqrt(np.maximum(values[::-1], 0.0))[:components], turn[:, ::-1][:, :components]
        stream.write(struct.pack("<BIII", SCALAR.itemsize, components, rows, width * height))
        stream.write(strengths.astype(SCALAR).tobytes())
        stream.write((bases[channel] @ turn).astype(SCALAR).tobytes())
        stream.write((projected[channel].T @ turn).astype(SCALAR).tobytes())


class _Matrix:
    """Colours of all pixels from all views under all lights, some pixels at a time."""

    def __init__(self, atlas: BakedAtlas, views: np.ndarray, lights: np.ndarray) -> None:
        self._atlas, self._views, self._lights = atlas, views, lights
        self._basis = atlas.seen_from(views, lights)
        self.rows, self.pixels = len(views) * len(lights), len(atlas.tints)
        self._size = max(1, PIECE // (self.rows * len(CHANNELS)))
        self.count = -(-self.pixels // self._size)

    def factor(self) -> np.ndarray | None:
        """Columns (3, rows, C) float64 that span the matrix of each channel, where it is a product with so many; None where it is not."""
        if self._atlas.lobes is not None:
            return None
        return self._basis.transpose(3, 0, 2, 1).reshape(len(CHANNELS), self.rows, -1).astype(np.float64)

    def pieces(self) -> Iterator[tuple[slice, np.ndarray]]:
        """Pixels, and their numbers (3, rows, M) float32: row by row a view and a light."""
        lobes = self._atlas.lobes
        for start in range(0, self.pixels, self._size):
            pixels = slice(start, min(start + self._size, self.pixels))
            weights = self._atlas.colour.spread(pixels)
            made = np.empty((len(CHANNELS), len(self._views), len(self._lights), len(weights)), np.float32)
            for place, view in enumerate(self._views):
                made[:, place] = np.einsum("klc,pk->clp", self._basis[place], weights, optimize=True)
                made[:, place] *= self._atlas.tints[pixels].T[:, None]
                if lobes is not None:
                    made[:, place] += lobes.of_suns(view, self._lights, pixels).transpose(2, 1, 0)
            yield pixels, made.reshape(len(CHANNELS), self.rows, -1)


def _range(matrix: _Matrix, components: int) -> Steps[np.ndarray]:
    """Orthonormal columns (3, rows, at least `components`) float32 that hold nearly all of the matrix of each channel."""
    factor = matrix.factor()
    if factor is not None:
        return np.linalg.qr(factor)[0].astype(np.float32)
    random = np.random.default_rng(0)
    wide = min(components + OVERSAMPLED, matrix.rows)
    bases = None
    for iteration in range(POWER + 1):
        sums = np.zeros((len(CHANNELS), matrix.rows, wide), np.float32)
        for done, (_, columns) in enumerate(matrix.pieces()):
            yield Progress((iteration + done / matrix.count) / (POWER + 1), LOOKING)
            sums += columns @ (_noise(random, columns, wide) if bases is None else columns.transpose(0, 2, 1) @ bases)
        bases = np.linalg.qr(sums.astype(np.float64))[0].astype(np.float32)
    return bases


def _noise(random: np.random.Generator, columns: np.ndarray, wide: int) -> np.ndarray:
    return random.standard_normal((columns.shape[2], wide)).astype(np.float32)


def _header(pixels_per_millimetre: float) -> bytes:
    channels = b"".join(struct.pack("<I", len(name)) + name.encode() for name in CHANNELS)
    fixed = struct.pack("<80s80s80s4f", b"Farfield", b"Cycles", b"sun", pixels_per_millimetre, 1.0, 1.0, 1.0)
    # The cosine flag is 0: the cosine of the light is in the values, readers must not put it in again.
    rest = fixed + struct.pack("<II", 0, len(NOTE)) + NOTE + struct.pack("<I", len(CHANNELS)) + channels
    return SIGNATURE + struct.pack("<II", 8 + len(rest), VERSION) + rest


def _directions(views: np.ndarray, lights: np.ndarray) -> bytes:
    """Every view as polar angle and turn, each followed by all lights."""
    under = struct.pack("<I", len(lights)) + to_spherical(lights).astype("<f4").tobytes()
    return struct.pack("<I", len(views)) + b"".join(angles.tobytes() + under for angles in to_spherical(views).astype("<f4"))
