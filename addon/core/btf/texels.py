"""The texels of a level in space, and what each of them sees from a view."""

from dataclasses import dataclass

import numpy as np

ROOM = 1e-6  # of a texel: corners that lie on the border between two texels


@dataclass(frozen=True)
class Texels:
    """N texels that lie on quads.

    size: (width, height) of the texture. pixels (N, 2) int32: x, y in it, row 0 at the bottom. quads (N,) int32. positions (N, 3) float64:
    the middle of each in the space of the quads' corners.
    """

    size: tuple[int, int]
    pixels: np.ndarray
    quads: np.ndarray
    positions: np.ndarray

    def __len__(self) -> int:
        return len(self.quads)

    def image(self, values: np.ndarray) -> np.ndarray:
        """`values` (N, C) in their places of an image (H, W, C); 0 elsewhere."""
        picture = np.zeros((self.size[1], self.size[0], values.shape[1]), values.dtype)
        picture[self.pixels[:, 1], self.pixels[:, 0]] = values
        return picture


def texels_of(corners: list[np.ndarray], uvs: list[np.ndarray], size: tuple[int, int]) -> Texels:
    """The texels under quads, from each one's polygon: `corners` (C, 3) in space, `uvs` (C, 2) in the texture of `size`, C at least 3.

    A texel counts when its middle is within half a texel of the bounding box of the polygon in the texture.
    """
    pixels, quads, positions = [], [], []
    for quad, (places, coordinates) in enumerate(zip(corners, uvs, strict=True)):
        at = coordinates * size
        low = np.maximum(np.floor(at.min(axis=0) - 0.5 + ROOM) + 0.0, 0).astype(np.int64)
        high = np.minimum(np.ceil(at.max(axis=0) + 0.5 - ROOM), size).astype(np.int64)
        x, y = np.meshgrid(np.arange(low[0], high[0]), np.arange(low[1], high[1]))
        own = np.stack([x.ravel(), y.ravel()], axis=1)
        affine, *_ = np.linalg.lstsq(np.column_stack([at, np.ones(len(at))]), places, rcond=None)
        pixels.append(own)
        quads.append(np.full(len(own), quad))
        positions.append(np.column_stack([own + 0.5, np.ones(len(own))]) @ affine)
    joined = np.concatenate(pixels)
    # Two boxes may share a column between them; its texels belong to the first.
    _, first = np.unique(joined[:, 1] * size[0] + joined[:, 0], return_index=True)
    return Texels(size, joined[first].astype(np.int32), np.concatenate(quads)[first].astype(np.int32), np.concatenate(positions)[first])


@dataclass(frozen=True)
class View:
    """An orthographic picture from `direction` (3,), a unit vector towards the viewer, with `center` (3,) in its middle.

    side: pixels along each side. pixel: length of one. right, up (3,): unit axes of the picture.
    """

    direction: np.ndarray
    center: np.ndarray
    side: int
    pixel: float

    @property
    def right(self) -> np.ndarray:
        """The picture's x axis; for a view from straight above or below the world's x."""
        across = np.cross([0.0, 0.0, 1.0], self.direction)
        length = np.linalg.norm(across)
        return across / length if length > 1e-6 else np.array([1.0, 0.0, 0.0])

    @property
    def up(self) -> np.ndarray:
        """The picture's y axis."""
        return np.cross(self.direction, self.right)

    def project(self, positions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Places (N, 2) in pixels from the lower left corner of the picture, and heights (N,) above the centre towards the viewer."""
        from_center = positions - self.center
        axes = np.stack([self.right, self.up], axis=1)
        return from_center @ axes / self.pixel + 0.5 * self.side, from_center @ self.direction


@dataclass(frozen=True)
class Picture:
    """What Cycles saw from one view.

    radiance (L, H, W, 3) float32: premultiplied, one a light. coverage (H, W): alpha. faces (H, W) int32: the face seen in the middle of
    each pixel, -1 for none. heights (H, W): of that place above the centre, towards the viewer.
    """

    radiance: np.ndarray
    coverage: np.ndarray
    faces: np.ndarray
    heights: np.ndarray


@dataclass(frozen=True)
class Sighting:
    """What texels know from one view.

    known (N,) bool: nothing hid them. coverage (N,) float32: alpha of the known ones. visible (M,) int32: texels with a colour; radiance
    (L, M, 3) float32: straight colours of these.
    """

    known: np.ndarray
    coverage: np.ndarray
    visible: np.ndarray
    radiance: np.ndarray


class Belonging:
    """Which faces each quad shows."""

    def __init__(self, drawn_offsets: np.ndarray, drawn: np.ndarray, faces: int) -> None:
        quads = np.repeat(np.arange(len(drawn_offsets) - 1), np.diff(drawn_offsets))
        self._faces = faces
        self._keys = np.sort(quads.astype(np.int64) * faces + drawn)

    def __call__(self, quads: np.ndarray, faces: np.ndarray) -> np.ndarray:
        """Whether quads[i] shows faces[i], as bool; a face of -1 is shown by none."""
        keys = quads.astype(np.int64) * self._faces + faces
        place = np.minimum(np.searchsorted(self._keys, keys), len(self._keys) - 1)
        return (self._keys[place] == keys) & (faces >= 0)


LEAST_COVERAGE = 0.05  # below it a colour is noise


def sight(texels: Texels, view: View, picture: Picture, belongs: Belonging, error: float) -> Sighting:
    """Project every texel along `view` into `picture` and take what is seen there, if it is the texel's own surface.

    A pixel that shows a surface of another quad more than `error` (a length) before the texel hides it: nothing is known. One that shows
    what lies behind, or nothing, knows that the texel is empty there.
    """
    places, heights = view.project(texels.positions)
    low = np.floor(places - 0.5).astype(np.int64)
    share = places - 0.5 - low
    taps = []
    own_weight, free_weight, coverage = np.zeros((3, len(texels)))
    for right, up in ((0, 0), (1, 0), (0, 1), (1, 1)):
        weight = np.abs(1 - right - share[:, 0]) * np.abs(1 - up - share[:, 1])
        column = np.clip(low[:, 0] + right, 0, view.side - 1)
        row = np.clip(low[:, 1] + up, 0, view.side - 1)
        face = picture.faces[row, column]
        own = belongs(texels.quads, face)
        hidden = ~own & (face >= 0) & (picture.heights[row, column] > heights + error)
        taken = np.where(own, weight, 0.0)
        own_weight += taken
        free_weight += np.where(hidden, 0.0, weight)
        coverage += taken * picture.coverage[row, column]
        taps.append((row, column, taken))
    known = free_weight > 0.5
    visible = np.flatnonzero((coverage > LEAST_COVERAGE) & (own_weight > LEAST_COVERAGE)).astype(np.int32)
    radiance = np.zeros((len(picture.radiance), len(visible), 3), np.float32)
    for row, column, taken in taps:
        radiance += taken[visible, None].astype(np.float32) * picture.radiance[:, row[visible], column[visible]]
    radiance /= coverage[visible, None].astype(np.float32)
    alpha = np.clip(coverage / np.where(known, free_weight, 1.0), 0.0, 1.0)
    return Sighting(known, np.where(known, alpha, 0.0).astype(np.float32), visible, radiance)
