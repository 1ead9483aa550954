"""Bidirectional texture functions as `.btf` files: the full-matrix-factorization format of the Bonn database (UBO2014), with one matrix per
channel ("DFMF").

The file stores the matrix of each channel, with a row per view and light and a column per pixel, as a decomposition U S V': left singular
vectors, singular values, and S V'. Weights and basis of relightable textures are such a product, so only rounding is lost. Lobes are not:
their highlights need further components, computed with a randomized range finder (Halko, Martinsson, Tropp 2011).
"""

import struct
from collections.abc import Iterator
from typing import BinaryIO

import numpy as np

from ...errors import FileError, SettingsError
from ...geometry.directions import to_spherical
from ...jobs.progress import Progress, Steps, subprogress
from ..decoding import RelightableTexture

SIGNATURE = b"!DFMF08FC"
VERSION = 4  # The first version of the header with named channels.
CHANNELS = ("R", "G", "B")
NOTE = b"<farfield>radiance under a sun of unit irradiance, scene-linear Rec.709, angles in object space</farfield>"
MAX_PART_BYTES = 2**32 - 1  # Readers count the parts of the file with 32 bits.
SCALAR = np.dtype("<f4")
MAX_CHUNK_VALUES = 30_000_000  # Matrix entries in memory at once.
LOBE_COMPONENTS = 52  # Additional components for lobes.
OVERSAMPLING, POWER_ITERATIONS = 8, 1  # Parameters of the range finder.
DECODING_LABEL = "Decoding the textures for all views"


def write_fmf(
    stream: BinaryIO, texture: RelightableTexture, views: np.ndarray, lights: np.ndarray, pixels_per_millimeter: float
) -> Steps[None]:
    """Write a level's colors for the unit directions `views` (N, 3) and `lights` (N, 3), both in object space.

    The format has no clamping: negative values, which the shader clamps to 0, are written as they are.

    Raises:
        SettingsError: see `check_direction_counts`.
        FileError: a part of the file would exceed the format's size limit.
    """
    check_direction_counts(len(views), len(lights))
    width, height = texture.size
    row_count = len(views) * len(lights)
    lobe_components = 0 if texture.lobes is None else LOBE_COMPONENTS
    components = min(row_count, width * height, texture.color.clusters * texture.color.components + lobe_components)
    if len(CHANNELS) * max(row_count, width * height) * components * SCALAR.itemsize > MAX_PART_BYTES:
        raise FileError(f"{width} x {height} pixels with {components} components exceed the limit of a .btf file; bake a coarser level.")
    matrix = _Matrix(texture, views, lights)
    bases = yield from subprogress(_find_range(matrix, components), 0.0, 0.6)
    stream.write(_header(pixels_per_millimeter))
    stream.write(_encode_directions(views, lights))
    stream.write(struct.pack("<II", width, height))
    stream.write(struct.pack("<II12f", components, 0, 0.0, 0.0, 0.0, *np.eye(3).ravel()))  # No mean, no color transform.
    projected = np.empty((len(CHANNELS), bases.shape[2], width * height), np.float32)
    for index, (pixels, columns) in enumerate(matrix.chunks()):
        yield Progress(0.6 + 0.3 * index / matrix.chunk_count, DECODING_LABEL)
        projected[:, :, pixels] = bases.transpose(0, 2, 1) @ columns
    for channel in range(len(CHANNELS)):
        yield Progress(0.9 + 0.1 * channel / len(CHANNELS), f"Writing channel {channel + 1} of {len(CHANNELS)}")
        values, vectors = np.linalg.eigh(projected[channel].astype(np.float64) @ projected[channel].T)
        singular_values, vectors = np.sqrt(np.maximum(values[::-1], 0.0))[:components], vectors[:, ::-1][:, :components]
        stream.write(struct.pack("<BIII", SCALAR.itemsize, components, row_count, width * height))
        stream.write(singular_values.astype(SCALAR).tobytes())
        stream.write((bases[channel] @ vectors).astype(SCALAR).tobytes())
        stream.write((projected[channel].T @ vectors).astype(SCALAR).tobytes())


def check_direction_counts(views: int, lights: int) -> None:
    """Raise SettingsError if the numbers of view and light directions differ; readers of the format rely on equal numbers."""
    if views != lights:
        raise SettingsError(
            f"A .btf file needs equal numbers of view and light directions, not {views} and {lights}; set Directions to Bonn.",
            ("directions",),
        )


class _Matrix:
    """The colors of all pixels from all views under all lights, decoded in chunks of pixels."""

    def __init__(self, texture: RelightableTexture, views: np.ndarray, lights: np.ndarray) -> None:
        self._texture, self._views, self._lights = texture, views, lights
        self._basis = texture.interpolate_basis(views, lights)
        self.row_count, self.pixel_count = len(views) * len(lights), len(texture.chromaticity)
        self._chunk_pixels = max(1, MAX_CHUNK_VALUES // (self.row_count * len(CHANNELS)))
        self.chunk_count = -(-self.pixel_count // self._chunk_pixels)

    def spanning_columns(self) -> np.ndarray | None:
        """Return columns (3, rows, C) float64 that span the column space of each channel; None with lobes, where none are known."""
        if self._texture.lobes is not None:
            return None
        return self._basis.transpose(3, 0, 2, 1).reshape(len(CHANNELS), self.row_count, -1).astype(np.float64)

    def chunks(self) -> Iterator[tuple[slice, np.ndarray]]:
        """Yield pixels, and their values (3, rows, M) float32 with a row per view and light."""
        lobes = self._texture.lobes
        for start in range(0, self.pixel_count, self._chunk_pixels):
            pixels = slice(start, min(start + self._chunk_pixels, self.pixel_count))
            weights = self._texture.color.dense_weights(pixels)
            values = np.empty((len(CHANNELS), len(self._views), len(self._lights), len(weights)), np.float32)
            for index, view in enumerate(self._views):
                values[:, index] = np.einsum("klc,pk->clp", self._basis[index], weights, optimize=True)
                values[:, index] *= self._texture.chromaticity[pixels].T[:, None]
                if lobes is not None:
                    values[:, index] += lobes.radiance_under_suns(view, self._lights, pixels).transpose(2, 1, 0)
            yield pixels, values.reshape(len(CHANNELS), self.row_count, -1)


def _find_range(matrix: _Matrix, components: int) -> Steps[np.ndarray]:
    """Return orthonormal columns (3, rows, at least `components`) float32 that approximately span the matrix of each channel."""
    columns = matrix.spanning_columns()
    if columns is not None:
        return np.linalg.qr(columns)[0].astype(np.float32)
    random = np.random.default_rng(0)
    column_count = min(components + OVERSAMPLING, matrix.row_count)
    bases = None
    for iteration in range(POWER_ITERATIONS + 1):
        products = np.zeros((len(CHANNELS), matrix.row_count, column_count), np.float32)
        for index, (_, columns) in enumerate(matrix.chunks()):
            yield Progress((iteration + index / matrix.chunk_count) / (POWER_ITERATIONS + 1), DECODING_LABEL)
            if bases is None:
                products += columns @ random.standard_normal((columns.shape[2], column_count)).astype(np.float32)
            else:
                products += columns @ (columns.transpose(0, 2, 1) @ bases)
        bases = np.linalg.qr(products.astype(np.float64))[0].astype(np.float32)
    return bases


def _header(pixels_per_millimeter: float) -> bytes:
    channels = b"".join(struct.pack("<I", len(name)) + name.encode() for name in CHANNELS)
    fixed = struct.pack("<80s80s80s4f", b"Farfield", b"Cycles", b"sun", pixels_per_millimeter, 1.0, 1.0, 1.0)
    # Cosine flag 0: the values include the cosine of the light, readers must not apply it again.
    content = fixed + struct.pack("<II", 0, len(NOTE)) + NOTE + struct.pack("<I", len(CHANNELS)) + channels
    return SIGNATURE + struct.pack("<II", 8 + len(content), VERSION) + content


def _encode_directions(views: np.ndarray, lights: np.ndarray) -> bytes:
    """Encode every view as polar angle and azimuth, each followed by all lights."""
    encoded_lights = struct.pack("<I", len(lights)) + to_spherical(lights).astype("<f4").tobytes()
    return struct.pack("<I", len(views)) + b"".join(angles.tobytes() + encoded_lights for angles in to_spherical(views).astype("<f4"))
