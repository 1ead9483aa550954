"""The job behind the button and the script: a standing billboard cloud in, relightable textures on it out."""

import shutil
import tempfile
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from ..bridge import btf_capture, btf_clouds, btf_snapshot, btf_worker, clouds, images, meshes
from ..bridge.originals import read_original
from ..core.btf.compression import Compressed, Compression
from ..core.btf.lobes import Surface
from ..core.btf.orders import LevelOrder
from ..core.btf.settings import BtfSettings
from ..core.btf.shards import ShardStore
from ..core.btf.spreading import render_missing
from ..core.btf.texels import Quads, Texels, View
from ..core.btf.training import training_views
from ..core.errors import FileError, GeometryError
from ..core.parallel import read_word
from ..core.progress import StageClock, Steps, scaled
from . import btf_estimates
from .billboards_clouds import StandingCloud, cloud_of

CAPTURED = 0.8  # of the bar
COMPRESSED, REFINED = 0.5, 0.9  # of the compression's part of it


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
    """One level that was baked. deepest: the most of its quads that stand behind each other."""

    texels: Texels
    textures: Compressed
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
                made = baked.textures
                btf_clouds.wear(level_object, baked.texels, made, self.settings)
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
        """The textures of one level, all of whose views stand."""
        level = self.levels[number]
        texels, store, settings = level.order.texels, level.store, self.settings
        compression = Compression(store, texels, level.plain, level.surface, settings)
        with self.clock.stage("compress"):
            made = yield from scaled(compression.compress(), 0.0, COMPRESSED)
        with self.clock.stage("refine"):
            photographed = training_views(level.quads, texels, level.views, store)
            if settings.refine:
                made = yield from scaled(compression.refine(made, photographed), COMPRESSED, REFINED)
            deepest = max(view.deepest() for view in photographed)
        with self.clock.stage("measure"):
            fits = yield from scaled(compression.measure(made), REFINED, 1.0)
        views, images = settings.views, settings.lights + 1
        self.figures.append(
            {
                "level": number,
                "renders": views * images,
                "shards": views,
                "texels": len(texels),
                "stacked_quads": deepest,
                "bare_render_seconds": round(store.render_seconds(views), 3),
                "raw_bytes": 2 * 3 * len(texels) * views * images,
                "captured_bytes": store.bytes(views),
                "compressed_bytes": made.bytes,
                "fits": [asdict(fit) for fit in fits],
            }
        )
        return Baked(texels, made, deepest)


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
    quads, views = btf_clouds.quads_of_level(level_object), btf_capture.views_of(source, settings.view_grid, texels.side)
    order = LevelOrder(texels, *clouds.drawn_on(level_object.data), float(level_object["farfield_error"]))
    store = ShardStore(btf_snapshot.store_folder(folder, number))
    plain, surface = btf_clouds.plain_alpha(level_object, texels), btf_clouds.plain_surface(level_object, texels)
    return Level(order, quads, views, plain, surface, store)


def _temporary_folder() -> tempfile.TemporaryDirectory:
    try:
        return tempfile.TemporaryDirectory(prefix="farfield-btf-", ignore_cleanup_errors=True)
    except OSError as error:
        raise FileError(f"No temporary folder can be made ({error.strerror}); free some space on that disk.") from error
