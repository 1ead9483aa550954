"""Estimates for the panel: worked out once for each state of the selection and the settings, never while the panel is being drawn."""

from dataclasses import dataclass

import bpy

from ..core.billboards.estimate import LevelEstimate, Sample, estimate, take_sample
from ..core.billboards.settings import BillboardSettings
from ..core.errors import FarfieldError
from . import long_work
from .billboards_job import take_sources

UNASKED_FACES = 200_000  # larger selections are estimated only when asked: reading them takes longer than a window should stand still
DELAY = 0.3  # seconds that a slider must rest before the estimate follows


@dataclass(frozen=True)
class Question:
    """What the figures depend on. objects: name, vertices, faces and place of each selected object."""

    objects: tuple[tuple, ...]
    together: bool
    settings: BillboardSettings


@dataclass(frozen=True)
class Answer:
    """Figures of each level, summed over the clouds, or the reason why there are none."""

    levels: list[LevelEstimate]
    reason: str = ""


_latest: tuple[Question, Answer] | None = None
_samples: tuple[tuple, list[Sample]] | None = None
_waiting: Question | None = None


def question(context: bpy.types.Context, settings: BillboardSettings) -> Question:
    """What is asked by the selection and the panel as they are now. Cheap enough for every redraw."""
    objects = tuple(
        (item.name, *_counts(item), *(round(value, 6) for row in item.matrix_world for value in row)) for item in context.selected_objects
    )
    return Question(objects, context.scene.farfield_billboards.together, settings)


def known(asked: Question) -> Answer | None:
    """The answer if it has been worked out."""
    return _latest[1] if _latest is not None and _latest[0] == asked else None


def ask_later(asked: Question) -> bool:
    """Have the answer worked out once the window rests, unless that would make it stand still; whether it will be."""
    global _waiting
    if sum(item[2] for item in asked.objects) > UNASKED_FACES or long_work.current() is not None:
        return False
    if asked == _waiting:
        return True
    _waiting = asked
    if bpy.app.timers.is_registered(_work):
        bpy.app.timers.unregister(_work)
    bpy.app.timers.register(_work, first_interval=DELAY)
    return True


def answer(context: bpy.types.Context, asked: Question) -> Answer:
    """Work out the answer now and keep it.

    Raises:
        FarfieldError: when nothing can be built from the objects.
    """
    global _latest, _samples
    shape = (asked.objects, asked.together)
    if _samples is None or _samples[0] != shape:
        objects = [bpy.data.objects[item[0]] for item in asked.objects]
        sources, _ = take_sources(objects, context.evaluated_depsgraph_get(), asked.together)
        _samples = shape, [take_sample(source.geometry, source.name) for source in sources]
    clouds = [estimate(sample, asked.settings) for sample in _samples[1]]
    _latest = asked, Answer([_sum(levels) for levels in zip(*clouds, strict=True)])
    return _latest[1]


def forget() -> None:
    """Drop all that was worked out or waits to be."""
    global _latest, _samples, _waiting
    _latest = _samples = _waiting = None
    if bpy.app.timers.is_registered(_work):
        bpy.app.timers.unregister(_work)


def _work() -> None:
    global _latest, _waiting
    asked, _waiting = _waiting, None
    if long_work.current() is not None or any(item[0] not in bpy.data.objects for item in asked.objects):
        return
    try:
        answer(bpy.context, asked)
    except FarfieldError as error:
        _latest = asked, Answer([], str(error))
    long_work.redraw_sidebars(bpy.context.window_manager)


def _counts(item: bpy.types.Object) -> tuple[int, int]:
    return (len(item.data.vertices), len(item.data.polygons)) if item.type == "MESH" else (0, 0)


def _sum(levels: tuple[LevelEstimate, ...]) -> LevelEstimate:
    return LevelEstimate(
        error=max(level.error for level in levels),
        quads=sum(level.quads for level in levels),
        texels=sum(level.texels for level in levels),
        bytes=sum(level.bytes for level in levels),
    )
