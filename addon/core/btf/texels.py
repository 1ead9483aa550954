"""The texels of a level in space, and what each of them sees from a view."""

import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

FINER = 3  # pixels of the picture of faces along one of the others
PARTS = 3  # along each side of a texel, looked up one by one
LARGEST_TABLE = 10**8  # bytes of a table of quads and faces
LEAST_COVERAGE = 0.1  # of the parts, summed: below it a colour is noise
ROOM = 1e-6  # of a texel: corners that lie on the border between two texels


@dataclass(frozen=True)
class Texels:
    """N texels that lie on quads.

    size: (width, height) of the texture. pixels (N, 2) int32: x, y in it, row 0 at the bottom. quads (N,) int32. positions (N, 3) float64:
    the middle of each in the space of the quads' corners. steps (Q, 2, 3): from a texel of a quad to the next along x, and along y.
    """

    size: tuple[int, int]
    pixels: np.ndarray
    quads: np.ndarray
    positions: np.ndarray
    steps: np.ndarray

    def __len__(self) -> int:
        return len(self.quads)

    @property
    def side(self) -> float:
        """Length of a texel: the median over the quads."""
        return float(np.median(np.linalg.norm(self.steps, axis=2)))

    def facing(self, directions: np.ndarray) -> np.ndarray:
        """The cosine (V, N) float32, 0..1, between the quad of each texel and unit `directions` (V, 3): how much of it is seen."""
        normals = np.cross(self.steps[:, 0], self.steps[:, 1])
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
        return np.abs(directions @ normals.T).astype(np.float32)[:, self.quads]

    @cached_property
    def numbers(self) -> np.ndarray:
        """Which texel lies at each place of the texture, (height, width) int32; -1 for none."""
        picture = np.full((self.size[1], self.size[0]), -1, np.int32)
        picture[self.pixels[:, 1], self.pixels[:, 0]] = np.arange(len(self))
        return picture

    @staticmethod
    def places(count: int) -> Iterator[np.ndarray]:
        """The middles (2,) of count x count parts of a texel, as shares of its steps from its own middle."""
        along = (2.0 * np.arange(count) + 1.0) / (2.0 * count) - 0.5
        for x, y in itertools.product(along, along):
            yield np.array([x, y])

    def image(self, values: np.ndarray) -> np.ndarray:
        """`values` (N, C) in their places of an image (H, W, C); 0 elsewhere."""
        picture = np.zeros((self.size[1], self.size[0], values.shape[1]), values.dtype)
        picture[self.pixels[:, 1], self.pixels[:, 0]] = values
        return picture


@dataclass(frozen=True)
class Quads:
    """The convex polygons of a level: of each, `corners` (C, 3) in space and `coordinates` (C, 2) in texels of the texture, C >= 3."""

    corners: list[np.ndarray]
    coordinates: list[np.ndarray]


def texels_of(polygons: Quads, size: tuple[int, int]) -> Texels:
    """The texels under quads in a texture of `size`.

    A texel counts when its middle is within half a texel of the bounding box of the polygon in the texture.
    """
    pixels, quads, positions, steps = [], [], [], []
    for quad, (places, at) in enumerate(zip(polygons.corners, polygons.coordinates, strict=True)):
        low = np.maximum(np.floor(at.min(axis=0) - 0.5 + ROOM) + 0.0, 0).astype(np.int64)
        high = np.minimum(np.ceil(at.max(axis=0) + 0.5 - ROOM), size).astype(np.int64)
        x, y = np.meshgrid(np.arange(low[0], high[0]), np.arange(low[1], high[1]))
        own = np.stack([x.ravel(), y.ravel()], axis=1)
        affine, *_ = np.linalg.lstsq(np.column_stack([at, np.ones(len(at))]), places, rcond=None)
        pixels.append(own)
        quads.append(np.full(len(own), quad))
        positions.append(np.column_stack([own + 0.5, np.ones(len(own))]) @ affine)
        steps.append(affine[:2])
    joined = np.concatenate(pixels)
    # Two boxes may share a column between them; its texels belong to the first.
    _, first = np.unique(joined[:, 1] * size[0] + joined[:, 0], return_index=True)
    joined, quad, position = joined[first], np.concatenate(quads)[first], np.concatenate(positions)[first]
    return Texels(size, joined.astype(np.int32), quad.astype(np.int32), position, np.array(steps))


@dataclass(frozen=True)
class View:
    """An orthographic picture from `direction` (3,), a unit vector towards the viewer, with `center` (3,) in its middle.

    side: pixels along each side. pixel: length of one.
    """

    direction: np.ndarray
    center: np.ndarray
    side: int
    pixel: float

    @cached_property
    def right(self) -> np.ndarray:
        """The picture's x axis; for a view from straight above or below the world's x."""
        across = np.cross([0.0, 0.0, 1.0], self.direction)
        length = np.linalg.norm(across)
        return across / length if length > 1e-6 else np.array([1.0, 0.0, 0.0])

    @cached_property
    def up(self) -> np.ndarray:
        """The picture's y axis."""
        return np.cross(self.direction, self.right)

    def finer(self, times: int) -> "View":
        """The same picture with so many times the pixels along each side."""
        return View(self.direction, self.center, self.side * times, self.pixel / times)

    def cells(self, positions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Row and column (N,) of the pixel that shows each place, the nearest one for places outside."""
        column, row = np.clip(np.floor(self.project(positions)[0]), 0, self.side - 1).astype(np.int64).T
        return row, column

    def project(self, positions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Places (N, 2) in pixels from the lower left corner of the picture, and heights (N,) above the centre towards the viewer."""
        from_center = positions - self.center
        axes = np.stack([self.right, self.up], axis=1)
        return from_center @ axes / self.pixel + 0.5 * self.side, from_center @ self.direction


@dataclass(frozen=True)
class Picture:
    """What Cycles saw from one view.

    radiance (L, H, W, 3) float32: premultiplied, one a light. coverage (H, W): alpha. faces (F H, F W) int32: the face seen in the middle
    of each pixel of a picture FINER times as fine, -1 for none. heights (F H, F W): of that place above the centre, towards the viewer.
    glow (H, W, 3): what shines by itself, which `radiance` is without; None where nothing does.
    """

    radiance: np.ndarray
    coverage: np.ndarray
    faces: np.ndarray
    heights: np.ndarray
    glow: np.ndarray | None = None


@dataclass(frozen=True)
class Sighting:
    """What texels know from one view.

    known (N,) bool: nothing hid them. coverage (N,) float32: alpha of the known ones. visible (M,) int32: texels with a colour; parts (M,)
    uint8: how many of their PARTS x PARTS parts were seen; radiance (L, M, 3) float32: their straight colours. glow (M, 3): see `Picture`.
    """

    known: np.ndarray
    coverage: np.ndarray
    visible: np.ndarray
    parts: np.ndarray
    radiance: np.ndarray
    glow: np.ndarray | None = None


class Belonging:
    """Which faces each quad shows."""

    def __init__(self, drawn_offsets: np.ndarray, drawn: np.ndarray, faces: int) -> None:
        quads = np.repeat(np.arange(len(drawn_offsets) - 1), np.diff(drawn_offsets))
        self._faces = faces
        self._table = None
        if (len(drawn_offsets) - 1) * faces <= LARGEST_TABLE:
            self._table = np.zeros((len(drawn_offsets) - 1, faces), bool)
            self._table[quads, drawn] = True
        self._keys = np.sort(quads.astype(np.int64) * faces + drawn)

    def __call__(self, quads: np.ndarray, faces: np.ndarray) -> np.ndarray:
        """Whether quads[i] shows faces[i], as bool; a face of -1 is shown by none."""
        there = (faces >= 0) & (faces < self._faces)
        if self._table is not None:
            return self._table[quads, np.where(there, faces, 0)] & there
        keys = quads.astype(np.int64) * self._faces + faces
        place = np.minimum(np.searchsorted(self._keys, keys), len(self._keys) - 1)
        return (self._keys[place] == keys) & there


def sight(texels: Texels, view: View, picture: Picture, belongs: Belonging, error: float) -> Sighting:
    """Project parts of every texel along `view` into `picture` and take what is seen there, if it is the texel's own surface.

    A surface of another quad more than `error` (a length) before the texel hides the part: nothing is known of it. What lies behind, or
    nothing, tells that the texel is empty there. A texel is known when half of it is.
    """
    own, empty, coverage = np.zeros((3, len(texels)), np.float32)
    covered = picture.coverage.ravel()
    taken = []
    for row, column, is_own, hidden in _parts_in(texels, view.finer(FINER), picture.faces, picture.heights, belongs, error):
        own += is_own
        empty += ~is_own & ~hidden
        cell = row // FINER * view.side + column // FINER
        coverage += np.where(is_own, covered[cell], np.float32(0.0))
        taken.append((cell, is_own))
    known = own + empty >= 0.5 * PARTS**2
    visible = np.flatnonzero(coverage > LEAST_COVERAGE).astype(np.int32)
    by_pixel = np.moveaxis(picture.radiance if picture.glow is None else [*picture.radiance, picture.glow], 0, 2)
    by_pixel = np.ascontiguousarray(by_pixel, np.float32).reshape(len(covered), -1)
    seen = np.zeros((len(visible), by_pixel.shape[1]), np.float32)
    for cell, is_own in taken:
        shown = np.flatnonzero(is_own[visible])
        seen[shown] += by_pixel[cell[visible[shown]]]
    seen /= coverage[visible, None]
    radiance = seen.reshape(len(visible), by_pixel.shape[1] // 3, 3).swapaxes(0, 1)
    alpha = own / np.maximum(own + empty, 1.0)
    glow = None if picture.glow is None else radiance[-1]
    known_alpha, parts = np.where(known, alpha, np.float32(0.0)), own[visible].astype(np.uint8)
    return Sighting(known, known_alpha, visible, parts, radiance[: len(picture.radiance)], glow)


def reached_parts(
    texels: Texels, sun: View, faces: np.ndarray, heights: np.ndarray, belongs: Belonging, error: float
) -> tuple[np.ndarray, np.ndarray]:
    """How many parts of every texel a sun sees, and from how many another surface hides it, (N,) float32 each.

    sun: what it sees, with the `faces` (H, W) in the middle of every pixel and their `heights`; see `Picture`. Hidden as in `sight`.
    """
    own, hidden = np.zeros((2, len(texels)), np.float32)
    for _, _, is_own, is_hidden in _parts_in(texels, sun, faces, heights, belongs, error):
        own += is_own
        hidden += is_hidden
    return own, hidden


def _parts_in(
    texels: Texels, view: View, faces: np.ndarray, heights: np.ndarray, belongs: Belonging, error: float
) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]]:
    """Of PARTS x PARTS parts of every texel, one part of all texels at a time: row and column (N,) in the picture of `faces` from `view`,
    whether the texel's own surface is seen there, and whether one of another quad, more than `error` before it, hides it."""
    middles, height = view.project(texels.positions)
    ends, above = view.project(view.center + texels.steps.reshape(-1, 3))
    steps, rises = (ends - 0.5 * view.side).reshape(-1, 2, 2), above.reshape(-1, 2)
    seen, top = faces.ravel(), heights.ravel()
    for part in texels.places(PARTS):
        places = np.floor(middles + np.einsum("a,qac->qc", part, steps)[texels.quads])
        column, row = np.clip(places, 0, view.side - 1).astype(np.int64).T
        cell = row * view.side + column
        face = seen[cell]
        is_own = belongs(texels.quads, face)
        yield row, column, is_own, ~is_own & (face >= 0) & (top[cell] > height + (rises @ part)[texels.quads] + error)
