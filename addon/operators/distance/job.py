"""The job of the operator and the script: make the levels of all assets of a scene, and show them by distance."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import bpy
import numpy as np

from ...bridge.cameras import read_scene_camera
from ...bridge.distance.assets import Asset, AssetSearch
from ...bridge.distance.chains import Chain, read_chains
from ...bridge.distance.fingerprints import fingerprint
from ...bridge.distance.particles import replace_particles, restore_particles
from ...bridge.distance.placing import (
    attach_chain,
    clean_up,
    describe_bounces,
    detach,
    has_levels,
    originals_shown,
    scale_errors,
    with_placements,
)
from ...bridge.distance.views import read_views
from ...bridge.objects import find_by_uid
from ...core.distance.settings import AssetOptions, DistanceSettings
from ...core.errors import Cancelled, FarfieldError, GeometryError
from ...core.jobs.progress import Progress, Steps, subprogress
from ...core.json_values import parse_json
from ...core.messages import format_count, join_sentences, list_first, quote_names
from .analysis import read_options
from .budgets import Budget
from .build import build_chain, in_thread
from .measuring import prepare_search

ATTACH_FRACTION = 0.98
SEARCH_FRACTION = 0.5  # Of the work where trial renders follow the build.


@dataclass
class DistanceJob:
    """Makes levels and shows them by distance.

    Attributes:
        scene_uid: the scene.
        object_uids: the objects that are made ready.
        settings: of the levels.
        options: what differs for an object or collection, by session UID.
        skipped: names of the objects that are left out, with the reason.
        chains: the levels of each asset, the number of its places, and whether they were found rather than made.
        remarks: sentences about what could not be made.
        other_triangles: of the assets that stay as they are, at all places.
    """

    core_fraction = 0.0

    scene_uid: int
    object_uids: list[int]
    settings: DistanceSettings
    options: dict[int, AssetOptions] = field(default_factory=dict)
    skipped: list[str] = field(default_factory=list)
    chains: list[tuple[Chain, int, bool]] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)
    other_triangles: int = 0

    def core_steps(self) -> Steps[None]:
        """Do nothing: levels are made one asset after the other, each with renders of its own."""
        yield Progress(0.0, "Reading the scene")

    def scene_steps(self, _core_result: None) -> Steps[str]:
        """Make the levels that are not there yet, then add all modifiers at once. Levels that are finished when the job is cancelled stay
        in the file, and the next run uses them.

        Raises:
            GeometryError: nothing can be made ready, or an object or the scene was removed meanwhile.
        """
        scene = find_by_uid(bpy.data.scenes, self.scene_uid)
        uids = set(self.object_uids)
        objects = [item for item in bpy.data.objects if item.session_uid in uids]
        if scene is None or len(objects) < len(uids):
            raise GeometryError("The scene or an object was removed; start again.")
        view_layer = bpy.context.view_layer if bpy.context.scene == scene else scene.view_layers[0]
        objects += [host for host in replace_particles(scene, view_layer, objects) if host not in objects]
        try:
            return (yield from self._build(scene, view_layer, objects))
        finally:
            restore_particles(scene)

    def _build(self, scene: bpy.types.Scene, view_layer: bpy.types.ViewLayer, objects: Sequence[bpy.types.Object]) -> Steps[str]:
        views = read_views(scene)
        with originals_shown(scene, view_layer) as depsgraph:
            assets = self._find_assets(scene, objects, depsgraph)
            keys = [fingerprint(asset, depsgraph, self._settings_of(asset)) for asset in assets]
        known = {chain.fingerprint: chain for chain in read_chains()}
        reused = set(known)
        work = np.cumsum([0.0, *(float(asset.triangles) ** 0.5 * (key not in known) for asset, key in zip(assets, keys, strict=True))])
        attach_fraction = SEARCH_FRACTION if self.settings.seconds_budget else ATTACH_FRACTION
        fractions = (attach_fraction * work / max(work[-1], 1e-9)).tolist()
        for index, (asset, key) in enumerate(zip(assets, keys, strict=True)):
            if key not in known:
                prefix = f"{asset.name} ({index + 1} of {len(assets)}): "
                steps = build_chain(asset, key, self._settings_of(asset), self.remarks)
                known[key] = yield from subprogress(steps, *fractions[index : index + 2], prefix)
        yield Progress(attach_fraction, "Adding modifiers")
        chains = [(asset, known[key]) for asset, key in zip(assets, keys, strict=True)]
        budget = Budget(self.settings, [(asset, chain, self._options_of(asset).error_factor) for asset, chain in chains], views)
        max_error = budget.find_error(self.other_triangles)
        figures = budget.describe(max_error, self.other_triangles)  # Before levels that nothing shows are removed.
        self._attach(scene, objects, chains, max_error)
        if self.settings.seconds_budget:
            figures += " " + (yield from subprogress(self._fit_time(scene, max_error), attach_fraction, 1.0))
        self.chains = [(known[key], len(asset.matrices), key in reused) for asset, key in zip(assets, keys, strict=True)]
        return self._summary(scene, figures)

    def _options_of(self, asset: Asset) -> AssetOptions:
        return self.options.get(asset.source.session_uid, AssetOptions())

    def _settings_of(self, asset: Asset) -> DistanceSettings:
        return self._options_of(asset).adjust(self.settings)

    def _find_assets(self, scene: bpy.types.Scene, objects: Sequence[bpy.types.Object], depsgraph: bpy.types.Depsgraph) -> list[Asset]:
        search = AssetSearch(scene, depsgraph)
        found = search.find(objects)
        self.skipped += search.skipped
        small = [asset for asset in found if asset.triangles < self.settings.min_triangles]
        kept = [asset for asset in found if asset not in small and self._options_of(asset).method == "original"]
        self.skipped += [f"{asset.name} (its method is Original)" for asset in kept]
        self.other_triangles = sum(asset.triangles * len(asset.matrices) for asset in [*small, *kept])
        if len(small) + len(kept) == len(found):
            too_small = f"{format_count(len(small), 'object')} with too few triangles" if small else ""
            reasons = "; ".join(filter(None, [too_small, list_first(self.skipped)])) or "there is no object with a surface"
            raise GeometryError(f"Nothing to make ready: {reasons}. Select other objects, or lower Min Triangles.")
        return [asset for asset in found if asset not in small and asset not in kept]

    def _attach(
        self, scene: bpy.types.Scene, objects: Sequence[bpy.types.Object], found: Sequence[tuple[Asset, Chain]], max_error: float
    ) -> None:
        detach(with_placements(scene, objects))
        for asset, chain in found:
            if len(chain.collections) > 1:
                attach_chain(asset, chain, scene, self.settings.fade_range, max_error * self._options_of(asset).error_factor)
        clean_up(scene)
        if hasattr(scene, "farfield_distance"):  # Scripts may run without the panels.
            scene.farfield_distance.figures = ""

    def _fit_time(self, scene: bpy.types.Scene, max_error: float) -> Steps[str]:
        """Raise the error of the levels, now `max_error`, until a frame takes no longer than the budget; return a sentence about it."""
        if scene.render.engine != "CYCLES" or read_scene_camera(scene) is None or not has_levels(scene):
            return "A budget of seconds needs a camera, levels, and Cycles as the render engine."
        try:
            found = parse_json((yield from in_thread(prepare_search(scene, self.settings.seconds_budget, max_error).core_steps())))
        except Cancelled:
            raise
        except FarfieldError as error:
            return f"The budget of seconds was not applied: {error}"
        trials = {error: (seconds, flip) for error, seconds, flip in found["trials"]}
        error = found["error"]
        if error is None:
            fastest = min(trials, key=lambda tried: trials[tried][0])
            return (
                f"The budget is too small: a frame takes about {trials[max_error][0]:,.1f} s, and still {trials[fastest][0]:,.1f} s with a "
                f"Max Error of {fastest:.3g} pixels."
            )
        scale_errors(scene, error / max_error)
        raised = f"Max Error was raised to {error:.3g} pixels for the budget: a" if error > max_error else "A"
        return f"{raised} frame takes about {trials[error][0]:,.1f} s, with a FLIP of {trials[error][1]:.3f} to the originals."

    def _summary(self, scene: bpy.types.Scene, figures: str) -> str:
        ready = [chain for chain, _, _ in self.chains if len(chain.collections) > 1]
        places = sum(count for chain, count, _ in self.chains if len(chain.collections) > 1)
        alone = [chain.name for chain, _, _ in self.chains if len(chain.collections) == 1]
        sentences = [
            f"Distance-ready: {format_count(len(ready), 'object')} at {format_count(places, 'place')}; {figures}",
            "" if read_scene_camera(scene) is not None else "Add a camera: without one, all places show the original.",
            f"No lighter levels were found for {quote_names(alone[:3])}." if alone else "",
            describe_bounces(scene, ready),
            *self.remarks,
            f"Skipped: {list_first(self.skipped)}." if self.skipped else "",
        ]
        return join_sentences(sentences)


def prepare(scene: bpy.types.Scene, objects: Sequence[bpy.types.Object], settings: DistanceSettings) -> DistanceJob:
    """Return the job that makes `objects` of a scene ready.

    Raises:
        GeometryError: neither levels nor clouds are wanted, or there is no object.
    """
    if not settings.perceptual_levels and not settings.billboard_cloud:
        raise GeometryError("Neither Perceptual Levels nor Billboard Cloud is on; switch one on.")
    if not objects:
        raise GeometryError("There is no visible object with a surface; add one.")
    objects = with_placements(scene, objects)
    return DistanceJob(scene.session_uid, [item.session_uid for item in objects], settings, read_options(scene))


def describe_chain(chain: Chain, places: int, is_reused: bool) -> dict[str, Any]:
    """Return the figures of the levels of an asset for a report."""
    levels = [{"triangles": count, "pixel_size": size} for count, size in zip(chain.triangles, chain.pixel_sizes, strict=True)]
    return {"name": chain.name, "places": places, "reused": is_reused, "levels": levels}
