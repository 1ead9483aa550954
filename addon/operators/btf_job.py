"""The job behind the button and the script: a standing billboard cloud in, relightable textures on it out."""

import shutil
import tempfile
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from ..bridge import btf_capture, btf_clouds, clouds, images, meshes
from ..core.btf.codecs import compressed_colours
from ..core.btf.factors import Factors, factorise
from ..core.btf.quality import quality
from ..core.btf.settings import BtfSettings
from ..core.btf.shards import Colours, ShardStore, Silhouettes
from ..core.btf.texels import Belonging, Texels, sight
from ..core.btf.tints import tints
from ..core.errors import FarfieldError, GeometryError
from ..core.progress import Progress, StageClock, Steps, scaled
from .billboards_clouds import StandingCloud, cloud_of

DOME_WEIGHT = 4.0 * np.pi  # as much as all suns together
CAPTURED = 0.8  # of the bar
TINTED = 0.82
NUMBERED = 0.05  # of that


@dataclass
class BtfJob:
    """Bakes every level of one cloud; `figures` tells about each once the job is done.

    work: the folder for finished views; without one they go when the job ends, however it ends. keeps_work: whether they stay when it is
    done; when it is stopped they do.
    """

    collection: str
    sources: list[str]
    source: meshes.Source
    settings: BtfSettings
    work: Path | None
    keeps_work: bool
    figures: list[dict[str, Any]] = field(default_factory=list)
    clock: StageClock = field(default_factory=StageClock)

    def core_steps(self) -> Steps[None]:
        """Nothing can be done before the renders."""
        yield Progress(0.0, "Preparing")

    def scene_steps(self, _core_result: None) -> Steps[str]:
        """Capture, compress, and dress all levels at once.

        Raises:
            FileError: when the work folder is another bake's or cannot be written.
        """
        folder = self.work or Path(tempfile.mkdtemp(prefix="farfield-btf-"))
        done = False
        try:
            baked = []
            levels = len(self._cloud().levels)
            for number in range(levels):
                steps = self._bake(number, folder / f"level-{number}")
                baked.append((yield from scaled(steps, number / levels, (number + 1) / levels)))
            for level_object, (texels, hues, colour, alpha) in zip(self._cloud().levels, baked, strict=True):
                btf_clouds.wear(level_object, texels, hues, colour, alpha, self.settings)
            done = True
        finally:
            if self.work is None or (done and not self.keeps_work):
                shutil.rmtree(folder, ignore_errors=True)
        return f'Baked "{self.collection}": {sum(figure["renders"] for figure in self.figures):,} renders.'

    def _cloud(self) -> StandingCloud:
        collection = bpy.data.collections.get(self.collection)
        cloud = cloud_of(collection) if collection is not None else None
        if cloud is None:
            raise GeometryError(f'The cloud "{self.collection}" was removed while it was being baked; build and bake it again.')
        return cloud

    def _bake(self, number: int, folder: Path) -> Steps[tuple[Texels, np.ndarray, Factors, Factors]]:
        """Texels, their tints, colours and silhouettes of one level."""
        level_object = self._cloud().levels[number]
        texels = btf_clouds.texels_of_level(level_object)
        store = ShardStore(folder)
        store.open(f"{self.source.fingerprint} {self.settings.of_capture} {len(texels)} {float(level_object['farfield_error']):.9g}")
        bare = yield from scaled(self._capture(level_object, texels, store), 0.0, CAPTURED)
        views, lights = self.settings.view_grid, self.settings.light_grid
        light_weights = np.append(lights.solid_angles, DOME_WEIGHT)
        columns = np.repeat(light_weights, 3)
        plain = btf_clouds.plain_alpha(level_object, texels)
        silhouettes = [Silhouettes(store, view, plain) for view in range(len(views))]
        with self.clock.stage("compress"):
            captured = [Colours(store, view) for view in range(len(views))]
            hues = yield from scaled(tints(captured, len(texels), views.solid_angles, light_weights), CAPTURED, TINTED)
            colours = [Colours(store, view, hues) for view in range(len(views))]
            steps = compressed_colours(colours, len(texels), views.solid_angles, columns, self.settings)
            colour = yield from scaled(steps, TINTED, 0.92)
            steps = factorise(silhouettes, len(texels), self.settings.alpha_components, views.solid_angles, np.ones(1), self.settings.seed)
            alpha = yield from scaled(steps, 0.92, 0.97)
        with self.clock.stage("measure"):
            fits = yield from scaled(quality(colours, colour, hues, views.solid_angles, columns), 0.97, 1.0)
        self.figures.append(
            {
                "level": number,
                "renders": len(views) * (len(lights) + 1),
                "shards": len(views),
                "texels": len(texels),
                "bare_render_seconds": round(bare, 3),
                "raw_bytes": 2 * 3 * len(texels) * len(views) * (len(lights) + 1),
                "captured_bytes": store.bytes(len(views)),
                "compressed_bytes": 2 * hues.size + colour.bytes + alpha.bytes,
                "fits": [asdict(fit) for fit in fits],
            }
        )
        return texels, hues, colour, alpha

    def _capture(self, level_object: bpy.types.Object, texels: Texels, store: ShardStore) -> Steps[float]:
        """Render and keep all views that do not stand yet; returns the seconds that Cycles took."""
        error = float(level_object["farfield_error"])
        offsets, drawn = clouds.drawn_on(level_object.data)
        belongs = Belonging(offsets, drawn, int(drawn.max()) + 1)
        views = btf_capture.views_of(self.source, self.settings, texels.side)
        missing = [number for number in range(len(views)) if not store.stands(number)]
        objects = [bpy.data.objects[name] for name in self.sources if name in bpy.data.objects]
        if not missing:
            return 0.0
        with self.clock.stage("numbers"), btf_capture.number_booth(self.source, self.settings) as numbers:
            for done, number in enumerate(missing):
                yield Progress(NUMBERED * done / len(missing), f"Faces of view {done + 1} of {len(missing)}")
                store.write_faces(number, numbers.faces(views[number]))
            seconds = numbers.render_seconds
        with self.clock.stage("capture"), btf_capture.lit_booth(objects, self.source, self.settings) as booth:
            for done, number in enumerate(missing):
                part = (NUMBERED + (1.0 - NUMBERED) * place / len(missing) for place in (done, done + 1))
                picture = yield from scaled(booth.pictures(views[number], store.read_faces(number)), *part)
                store.write(number, sight(texels, views[number], picture, belongs, error))
            return seconds + booth.render_seconds


def prepare(context: bpy.types.Context, cloud: StandingCloud, settings: BtfSettings, work: Path | None, keeps_work: bool) -> BtfJob:
    """The job that bakes `cloud`, whose original must stand in the scene as it was when the cloud was built; see `BtfJob`.

    Raises:
        GeometryError: when the original was removed or edited, or the cloud was built by a version that kept too little.
        FileError: when an image file of a material is missing.
        SettingsError: see `BtfSettings.check`.
    """
    settings.check()
    name = cloud.collection.name
    sources = cloud.sources
    if not sources or len(sources) < len(cloud.source_names):
        missing = sorted(set(cloud.source_names) - {item.name for item in sources})
        raise GeometryError(f'The original of "{name}" is gone ({", ".join(missing)}); bring it back, or build the cloud anew.')
    if clouds.DRAWN not in cloud.levels[0].data or clouds.FINGERPRINT not in cloud.collection:
        raise GeometryError(f'"{name}" was built by an older Farfield; build the cloud anew.')
    source = _taken(context, sources)
    if source.fingerprint != cloud.collection[clouds.FINGERPRINT]:
        raise GeometryError(f'The original of "{name}" was edited or moved since the cloud was built; build the cloud anew.')
    images.check_images(source)
    return BtfJob(name, [item.name for item in sources], source, settings, work, keeps_work)


def _taken(context: bpy.types.Context, sources: Sequence[bpy.types.Object]) -> meshes.Source:
    """The geometry of the sources, also of those that are hidden because the cloud is shown instead."""
    hidden = [(item, item.hide_viewport, item.hide_get()) for item in sources]
    try:
        for item in sources:
            item.hide_viewport = False
            item.hide_set(False)
        context.view_layer.update()
        depsgraph = context.evaluated_depsgraph_get()
        first = sources[0].evaluated_get(depsgraph).data
        if len(sources) == 1 and isinstance(first, bpy.types.Mesh) and len(first.vertices) and not len(first.polygons):
            return meshes.take_points(sources[0])
        return meshes.take(list(sources), depsgraph)
    except FarfieldError as error:
        raise GeometryError(f"The original cannot be read: {error}") from error
    finally:
        for item, viewport, here in hidden:
            item.hide_viewport = viewport
            item.hide_set(here)
        context.view_layer.update()
