"""The frames of an octahedral impostor, captured from the real materials with Cycles: colour and alpha, normal, height, roughness.

The faces stand as they do in the scene, moved so that the centre of the object is the origin, and shine with one channel at a time; see
`channels`. An orthographic camera takes one picture a frame and channel.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

import bpy
import numpy as np

from ..core.btf.octahedral import FEWEST_PIXELS, Atlas, FrameGrid, uniform_surface
from ..core.btf.texels import View
from ..core.errors import SettingsError
from ..core.images import EMPTY, dilate
from ..core.progress import Progress, Steps
from .cameras import look
from .channels import CHANNELS, CaptureMaterial, capture_material
from .images import check_images
from .meshes import Source
from .plain_renders import prepare_plain_render
from .stand_ins import moved_as_a_whole, stand_ins
from .temporary import TemporaryScene, temporary_scene
from .wiring import Wiring

ORDINARY_LENGTHS = (1e-3, 1e3)  # half sides that single precision and the camera's clipping take as they are
PLACE = "place"  # the channel of positions, beside those of CHANNELS
FEW_SAMPLES = 4  # what a surface is made of varies less within a pixel than its edge does
PROBE = (4, 32)  # frames and pixels that tell whether roughness and metallic need a map
EDGE = 1.0  # pixels between the object and the border of a frame


@dataclass(frozen=True)
class _Booth:
    """A scene with the stand-ins, in which the frames `views` are taken."""

    work: TemporaryScene
    shapes: list["_Shape"]
    views: list[View]

    def show(self, channel: str, samples: int) -> None:
        """Shine with `channel` from now on."""
        self.work.scene.cycles.samples = samples
        for shape in self.shapes:
            shape.show(channel)

    def picture(self, number: int) -> np.ndarray:
        """The render (P, P, 4) of frame `number`."""
        look(self.work.scene, self.views[number])
        return self.work.render()


@dataclass(frozen=True)
class _Shape:
    """A material of the stand-ins; `place` is its premultiplied position moved to 0..1."""

    made: CaptureMaterial
    place: bpy.types.NodeSocket

    def show(self, channel: str) -> None:
        if channel == PLACE:
            Wiring(self.made.material.node_tree).connect(self.place, self.made.emission.inputs["Color"])
        else:
            self.made.show(channel)


def capture_atlas(source: Source, grid: FrameGrid, pixels: int, samples: int, seed: int = 0) -> Steps[Atlas]:
    """The frames of `source`, `pixels` a side each. Runs in Blender's main thread; each step is one render.

    The user's scene stays untouched, and nothing that was made for the renders is left, also when the generator is closed between two
    steps. `samples` are Cycles samples a pixel for colour and alpha; what else there is takes fewer.

    Raises:
        FileError: when an image file of a material is missing, or the temporary folder cannot take a picture.
        SettingsError: when a frame has too few pixels.
        FarfieldError: when Cycles is switched off.
    """
    if pixels < FEWEST_PIXELS:
        raise SettingsError(f"A frame of an octahedral atlas has {FEWEST_PIXELS} pixels a side or more, not {pixels}.")
    center, half_side = frame_bounds(source, pixels)
    side = grid.frames * pixels
    size = (side, side)
    empty = (
        np.zeros((*size, 4), np.float32),
        np.zeros((*size, 3), np.float32),
        np.zeros(size, np.float32),
        np.zeros((*size, 2), np.float32),
    )
    atlas = Atlas(grid, center, half_side, pixels, *empty)
    channels = (*CHANNELS, PLACE)
    with _booth(source, atlas, seed) as booth:
        for position, channel in enumerate(channels):
            booth.show(channel, samples if channel == "colour" else min(samples, FEW_SAMPLES))
            for number in range(len(grid)):
                yield Progress((position + number / len(grid)) / len(channels), f"Capturing {channel}, frame {number + 1} of {len(grid)}")
                _WRITERS[channel](atlas, number, booth.picture(number))
    return atlas


def surface_varies(source: Source, seed: int = 0) -> bool:
    """Whether roughness or metallic of `source` differ from place to place, by a few small renders; raises what `capture_atlas` does."""
    frames, pixels = PROBE
    center, half_side = frame_bounds(source, pixels)
    grid, nothing = FrameGrid(frames), np.zeros((0, 0))
    with _booth(source, Atlas(grid, center, half_side, pixels, nothing, nothing, nothing, nothing), seed) as booth:
        booth.show("surface", FEW_SAMPLES)
        pictures = np.concatenate([booth.picture(number) for number in range(len(grid))])
    return uniform_surface(pictures[..., :2] / np.maximum(pictures[..., 3:], EMPTY), pictures[..., 3]) is None


def frame_bounds(source: Source, pixels: int) -> tuple[np.ndarray, float]:
    """The centre (3,) of all frames of `source`, and half the side of a frame with so many pixels: from every side all of it is inside."""
    points = source.mesh.vertices if source.mesh is not None else source.points.points
    center = 0.5 * (points.min(axis=0) + points.max(axis=0))
    reach = float(np.linalg.norm(points - center, axis=1).max())
    if source.points is not None:
        reach += float(source.points.radii.max())
    return center, reach * pixels / (pixels - 2.0 * EDGE)


@contextmanager
def _booth(source: Source, atlas: Atlas, seed: int) -> Iterator[_Booth]:
    """A booth for the frames of `atlas`, whose maps need not be there yet. Leaves nothing behind."""
    check_images(source)
    unit = 1.0 if ORDINARY_LENGTHS[0] <= atlas.half_side <= ORDINARY_LENGTHS[1] else atlas.half_side
    half_side = atlas.half_side / unit
    views = [replace(atlas.view(number), center=np.zeros(3), pixel=2.0 * half_side / atlas.pixels) for number in range(len(atlas.grid))]
    shapes: list[_Shape] = []
    with temporary_scene("Farfield Octahedral") as work:
        prepare_plain_render(work.scene, atlas.pixels, atlas.pixels, seed)

        def copy_of(original: bpy.types.Material | None, color_layer: str) -> bpy.types.Material:
            shapes.append(_shape(capture_material(original, color_layer, half_side, False, work), half_side))
            return shapes[-1].made.material

        for _ in stand_ins(work, source, moved_as_a_whole(atlas.center, 1.0 / unit), copy_of):
            pass
        yield _Booth(work, shapes, views)


def _shape(made: CaptureMaterial, half_side: float) -> _Shape:
    wiring = Wiring(made.material.node_tree)
    position = wiring.node("ShaderNodeNewGeometry").outputs["Position"]
    moved = wiring.vector("ADD", wiring.vector("SCALE", position, 0.5 / half_side), (0.5, 0.5, 0.5))
    return _Shape(made, wiring.vector("SCALE", moved, made.channels.alpha))


def _write_colour(atlas: Atlas, number: int, picture: np.ndarray) -> None:
    alpha = np.clip(picture[..., 3:], 0.0, 1.0)
    atlas.colour[atlas.tile(number)] = np.concatenate([_straight(picture, np.inf), alpha], axis=2)


def _write_normal(atlas: Atlas, number: int, picture: np.ndarray) -> None:
    atlas.normal[atlas.tile(number)] = _straight(picture) * 2.0 - 1.0


def _write_surface(atlas: Atlas, number: int, picture: np.ndarray) -> None:
    atlas.surface[atlas.tile(number)] = _straight(picture)[..., :2]


def _write_height(atlas: Atlas, number: int, picture: np.ndarray) -> None:
    # A frame without anything in it, an edge-on card's, has the height of the centre.
    places = _straight(picture) * 2.0 - 1.0 if (picture[..., 3] > EMPTY).any() else np.zeros_like(picture[..., :3])
    atlas.height[atlas.tile(number)] = np.clip(places @ atlas.grid.directions[number], -1.0, 1.0)


_WRITERS: dict[str, Callable[[Atlas, int, np.ndarray], None]] = {
    "colour": _write_colour,
    "normal": _write_normal,
    "surface": _write_surface,
    PLACE: _write_height,
}


def _straight(picture: np.ndarray, most: float = 1.0) -> np.ndarray:
    """The mean over what covers each pixel of a premultiplied render (P, P, 4), and of its neighbours where nothing does; (P, P, 3)."""
    coverage = picture[..., 3]
    mean = picture[..., :3] / np.maximum(coverage, EMPTY)[..., None]
    return dilate(np.clip(mean, 0.0, most), coverage)
