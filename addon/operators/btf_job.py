"""The job behind the button and the script: a standing billboard cloud in, relightable textures on it out."""

import shutil
import tempfile
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from ..bridge import btf_capture, btf_clouds, btf_snapshot, btf_worker, clouds, images, meshes
from ..bridge.originals import read_original
from ..core.btf.broad_suns import BroadSuns
from ..core.btf.codecs import compressed_colours
from ..core.btf.factors import Factors, factorise
from ..core.btf.lobes import Lobes, Surface, fit_lobes
from ..core.btf.orders import LevelOrder
from ..core.btf.photographs import broad_lights
from ..core.btf.quality import quality
from ..core.btf.refine import refined
from ..core.btf.rests import write_rests
from ..core.btf.settings import BtfSettings
from ..core.btf.shards import Colours, ShardStore, Silhouettes
from ..core.btf.spreading import render_missing
from ..core.btf.texels import Quads, Texels, View
from ..core.btf.tints import tints
from ..core.btf.training import training_views
from ..core.direction_grids import DirectionGrid
from ..core.errors import FileError, GeometryError
from ..core.parallel import read_word
from ..core.progress import StageClock, Steps, scaled
from . import btf_estimates
from .billboards_clouds import StandingCloud, cloud_of

DOME_WEIGHT = np.pi  # as much as a quarter of all suns: a sky is dimmer than a sun, but alone where that does not reach
CAPTURED = 0.8  # of the bar
TINTED, FITTED, TAKEN, COLOURED, SHAPED, REFINED = 0.05, 0.25, 0.3, 0.5, 0.55, 0.9  # of the compression's part of it
LEAST_FACING = 0.03  # cosine: what a texel counts at least from a view that sees its quad from the edge


@dataclass(frozen=True)
class Level:
    """One level to be baked.

    order: what its capture needs. quads, views: its polygons, and where it is captured from. plain: the coverage (N,) of its texels in the
    plain maps, and surface: their normals and roughness. store: where finished views lie.
    """

    order: LevelOrder
    quads: Quads
    views: list[View]
    plain: np.ndarray
    surface: Surface | None
    store: ShardStore


@dataclass(frozen=True)
class Baked:
    """One level that was baked: lobes, tints (N, 3) and factors of its texels; deepest: the most of its quads that stand behind each
    other."""

    texels: Texels
    lobes: Lobes | None
    hues: np.ndarray
    colour: Factors
    alpha: Factors
    deepest: int


@dataclass
class BtfJob:
    """Bakes every level of one cloud; `figures` tells about each once the job is done.

    folder: for finished views. keeps_work: whether they stay when the job is done; when it is stopped they do. temporary: what removes the
    folder with the job, however it ends.
    """

    core_share = 0.98

    collection: str
    fingerprint: str
    settings: BtfSettings
    levels: list[Level]
    folder: Path
    keeps_work: bool
    temporary: tempfile.TemporaryDirectory | None
    figures: list[dict[str, Any]] = field(default_factory=list)
    clock: StageClock = field(default_factory=StageClock)
    _rendered: int = 0

    def core_steps(self) -> Steps[list[Baked]]:
        """Let worker processes capture what is missing, then compress.

        Raises:
            FarfieldError: when there is no executor of that name, or workers cannot do their part; see `render_missing`.
        """
        views = len(self.settings.view_grid)
        stores = [level.store for level in self.levels]
        with self.clock.stage("capture"):
            steps = render_missing(self.folder, stores, views, self.settings.executor, lambda shard: btf_worker.command(self.folder, shard))
            self._rendered = yield from scaled(steps, 0.0, CAPTURED)
        baked = []
        for number in range(len(self.levels)):
            part = (CAPTURED + (1.0 - CAPTURED) * place / len(self.levels) for place in (number, number + 1))
            baked.append((yield from scaled(self._compress(number), *part)))
        return baked

    def scene_steps(self, core_result: list[Baked]) -> Steps[str]:
        """Dress all levels at once.

        Raises:
            GeometryError: when the cloud was removed or built anew in the meantime.
        """
        yield from ()
        cloud = self._cloud()
        if self._rendered == self.settings.views * len(self.levels):
            btf_estimates.remember_pace(cloud, self.settings, sum(self.clock.seconds.values()))
        with self.clock.stage("dress"):
            for level_object, baked in zip(cloud.levels, core_result, strict=True):
                btf_clouds.wear(level_object, baked.texels, baked.hues, baked.colour, baked.alpha, self.settings, baked.lobes)
            btf_clouds.let_through(cloud.collection, max(baked.deepest for baked in core_result))
        if self.temporary is not None:
            self.temporary.cleanup()
        elif not self.keeps_work:
            shutil.rmtree(self.folder, ignore_errors=True)
        return f'Baked "{self.collection}": {sum(figure["renders"] for figure in self.figures):,} renders.'

    def _cloud(self) -> StandingCloud:
        """The cloud, which a user may have touched while workers rendered."""
        collection = bpy.data.collections.get(self.collection)
        cloud = cloud_of(collection) if collection is not None else None
        if cloud is None:
            raise GeometryError(f'The cloud "{self.collection}" was removed while it was being baked; build and bake it again.')
        sizes = [len(btf_clouds.texels_of_level(level_object)) for level_object in cloud.levels]
        if cloud.collection.get(clouds.FINGERPRINT) != self.fingerprint or sizes != [len(level.order.texels) for level in self.levels]:
            raise GeometryError(f'The cloud "{self.collection}" was built anew while it was being baked; bake it again.')
        return cloud

    def _compress(self, number: int) -> Steps[Baked]:
        """Tints and factors of one level, all of whose views stand."""
        level = self.levels[number]
        texels, store, settings = level.order.texels, level.store, self.settings
        views, lights = settings.view_grid, settings.light_grid
        light_weights = np.append(lights.solid_angles, DOME_WEIGHT)
        columns = np.repeat(light_weights, 3)
        suns = BroadSuns(lights.directions, btf_capture.sun_size(settings))
        weights = views.solid_angles[:, None] * np.maximum(texels.facing(views.directions), LEAST_FACING) ** 2
        silhouettes = [Silhouettes(store, view, level.plain) for view in range(len(views))]
        captured = [Colours(store, view) for view in range(len(views))]
        with self.clock.stage("compress"):
            hues = yield from scaled(tints(captured, len(texels), views.solid_angles, light_weights), 0.0, TINTED)
            lobes = None
            if level.surface is not None:
                steps = fit_lobes(captured, level.surface, texels.quads, views, suns, weights, light_weights)
                lobes = yield from scaled(steps, TINTED, FITTED)
            rests = yield from scaled(write_rests(store, hues, lobes, views, suns), FITTED, TAKEN)
            steps = compressed_colours(rests, len(texels), weights, columns, settings)
            colour = yield from scaled(steps, TAKEN, COLOURED)
            steps = factorise(silhouettes, len(texels), settings.alpha_components, views.solid_angles, np.ones(1), settings.seed)
            alpha = yield from scaled(steps, COLOURED, SHAPED)
        with self.clock.stage("refine"):
            photographed = training_views(level.quads, texels, level.views, store)
            if settings.refine:
                broad = broad_lights(lights)
                lit = None if lobes is None else [lobes.under(broad, view, suns) for view in views.directions]
                steps = refined(photographed, colour, hues, alpha, level.plain, broad, views.solid_angles, lit)
                alpha = yield from scaled(steps, SHAPED, REFINED)
            deepest = max(view.fragments().deepest for view in photographed)
        with self.clock.stage("measure"):
            more = None if lobes is None else partial(_shown, lobes, views, suns)
            fits = yield from scaled(quality(captured, colour, hues, weights, columns, more), REFINED, 1.0)
        store.remove_rests()
        self.figures.append(
            {
                "level": number,
                "renders": len(views) * (len(lights) + 1),
                "shards": len(views),
                "texels": len(texels),
                "stacked_quads": deepest,
                "bare_render_seconds": round(store.render_seconds(len(views)), 3),
                "raw_bytes": 2 * 3 * len(texels) * len(views) * (len(lights) + 1),
                "captured_bytes": store.bytes(len(views)),
                "compressed_bytes": 2 * hues.size + colour.bytes + alpha.bytes + (lobes.bytes if lobes is not None else 0),
                "fits": [asdict(fit) for fit in fits],
            }
        )
        return Baked(texels, lobes, hues, colour, alpha, deepest)


def _shown(lobes: Lobes, views: DirectionGrid, suns: BroadSuns, view: int, rows: np.ndarray) -> np.ndarray:
    """What lobes show of `rows` (M,) from a view, (M, (L + 1) * 3)."""
    return lobes.of_grid(views.directions[view], suns, rows).reshape(len(rows), -1)


def prepare(context: bpy.types.Context, cloud: StandingCloud, settings: BtfSettings, work: Path | None, keeps_work: bool) -> BtfJob:
    """The job that bakes `cloud`, whose original must stand in the scene as it was when the cloud was built; see `BtfJob`.

    work: the folder for finished views; without one they go when the job does. All that workers need is written there now.

    Raises:
        GeometryError: when the original was removed or edited, or the cloud was built by a version that kept too little.
        FileError: when an image file of a material is missing, or the work folder is another bake's or cannot be written.
        SettingsError: see `BtfSettings.check`; or when there is no such executor.
    """
    settings.check()
    read_word(settings.executor)
    name = cloud.collection.name
    sources = cloud.sources
    if not sources or len(sources) < len(cloud.source_names):
        missing = sorted(set(cloud.source_names) - {item.name for item in sources})
        raise GeometryError(f'The original of "{name}" is gone ({", ".join(missing)}); bring it back, or build the cloud anew.')
    if clouds.DRAWN not in cloud.levels[0].data or clouds.FINGERPRINT not in cloud.collection:
        raise GeometryError(f'"{name}" was built by an older Farfield; build the cloud anew.')
    source = read_original(context, sources)
    if source.fingerprint != cloud.collection[clouds.FINGERPRINT]:
        raise GeometryError(f'The original of "{name}" was edited or moved since the cloud was built; build the cloud anew.')
    images.check_images(source)
    temporary = _temporary_folder() if work is None else None
    folder = work if temporary is None else Path(temporary.name)
    levels = [_level(level_object, source, settings, folder, number) for number, level_object in enumerate(cloud.levels)]
    for level in levels:
        level.store.open(f"{source.fingerprint} {settings.of_capture} {len(level.order.texels)} {level.order.error:.9g}")
    btf_snapshot.write_snapshot(folder, context.scene, sources, source, [level.order for level in levels], settings)
    return BtfJob(name, source.fingerprint, settings, levels, folder, keeps_work, temporary)


def _level(level_object: bpy.types.Object, source: meshes.Source, settings: BtfSettings, folder: Path, number: int) -> Level:
    texels = btf_clouds.texels_of_level(level_object)
    quads, views = btf_clouds.quads_of_level(level_object), btf_capture.views_of(source, settings, texels.side)
    order = LevelOrder(texels, *clouds.drawn_on(level_object.data), float(level_object["farfield_error"]))
    store = ShardStore(btf_snapshot.store_folder(folder, number))
    plain, surface = btf_clouds.plain_alpha(level_object, texels), btf_clouds.plain_surface(level_object, texels)
    return Level(order, quads, views, plain, surface, store)


def _temporary_folder() -> tempfile.TemporaryDirectory:
    try:
        return tempfile.TemporaryDirectory(prefix="farfield-btf-", ignore_cleanup_errors=True)
    except OSError as error:
        raise FileError(f"No temporary folder can be made ({error.strerror}); free some space on that disk.") from error
