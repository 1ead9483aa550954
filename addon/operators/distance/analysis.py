"""What is heavy in a scene, and how each object shall be treated: the list in the panel."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import bpy
import numpy as np

from ...bridge.cameras import render_size
from ...bridge.distance.assets import Asset, AssetSearch
from ...bridge.distance.chains import read_chains
from ...bridge.distance.fingerprints import fingerprint
from ...bridge.distance.placing import originals_shown, with_placements
from ...bridge.distance.views import count_image_bytes, read_views
from ...core.distance.forecasts import View
from ...core.distance.settings import METHODS, AssetOptions, DistanceSettings

# Triangles of a scene that is light: at all places together for viewports and EEVEE, and of each mesh once for Cycles.
LIGHT_TRIANGLES, LIGHT_UNIQUE_TRIANGLES = 2_000_000, 500_000
OUTCOMES = {
    "build": "Gets levels",
    "ready": "Has levels",
    "stays": "Stays as it is: fewer triangles than Min Triangles",
    "original": "Stays as it is: its method is Original",
}


@dataclass(frozen=True)
class Plan:
    """What an asset costs, and the work on it.

    Attributes:
        source: the object or collection.
        name: of the asset.
        places: their number.
        triangles: at one place.
        image_bytes: memory of the images of its materials.
        nearest: smallest distance of a place from the active camera in any frame that was looked at; 0 without a camera.
        pixels: largest extent in an image, in pixels; 0 where no frame shows it.
        outcome: one of `OUTCOMES` but "original", which the method of a row decides.
    """

    source: bpy.types.ID
    name: str
    places: int
    triangles: int
    image_bytes: int
    nearest: float
    pixels: float
    outcome: str

    @property
    def total(self) -> int:
        """The triangles at all places together."""
        return self.places * self.triangles


class FARFIELD_PG_distance_plan(bpy.types.PropertyGroup):
    """A row of the list: a `Plan`, which an analysis makes, and the choices of the user, which stay."""

    __annotations__ = {
        "source": bpy.props.PointerProperty(type=bpy.types.ID),
        "places": bpy.props.IntProperty(),
        "triangles": bpy.props.IntProperty(),
        "image_megabytes": bpy.props.FloatProperty(),
        "nearest": bpy.props.FloatProperty(name="Nearest", subtype="DISTANCE", unit="LENGTH"),
        "pixels": bpy.props.FloatProperty(),
        "outcome": bpy.props.StringProperty(),
        "method": bpy.props.EnumProperty(
            items=[(key, choice.label, choice.help) for key, choice in METHODS.items()],
            name="Method",
            description="What stands for the object far away. The next Make Distance-Ready uses it",
        ),
        "error_factor": bpy.props.FloatProperty(
            name="Error Factor",
            description="Factor of Max Error for this object: larger values show lighter levels nearer, smaller ones farther away",
            default=1.0,
            min=0.1,
            max=10.0,
        ),
    }

    @property
    def current_outcome(self) -> str:
        """One of `OUTCOMES`, by the analysis and the choice of the user since then."""
        return "original" if self.method == "original" and self.outcome != "stays" else self.outcome


def analyze(
    scene: bpy.types.Scene, view_layer: bpy.types.ViewLayer, objects: Sequence[bpy.types.Object], settings: DistanceSettings
) -> tuple[list[Plan], list[str]]:
    """Return what each asset of `objects` costs and what would be done with it, heaviest first, and the names of those that are left out,
    with the reason. The scene is evaluated at some frames, see `read_views`."""
    views = read_views(scene)
    options = read_options(scene)
    with originals_shown(scene, view_layer) as depsgraph:
        search = AssetSearch(scene, depsgraph)
        assets = search.find(with_placements(scene, objects))
        known = {chain.fingerprint for chain in read_chains()}
        outcomes = [_outcome(asset, depsgraph, settings, options, known) for asset in assets]
        size = render_size(scene.render)
        plans = [_describe(asset, views, outcome, size) for asset, outcome in zip(assets, outcomes, strict=True)]
    return sorted(plans, key=lambda plan: -plan.total), search.skipped


def _outcome(
    asset: Asset, depsgraph: bpy.types.Depsgraph, settings: DistanceSettings, options: dict[int, AssetOptions], known: set[str]
) -> str:
    chosen = options.get(asset.source.session_uid, AssetOptions())
    if asset.triangles < settings.min_triangles:
        return "stays"
    return "ready" if fingerprint(asset, depsgraph, chosen.adjust(settings)) in known else "build"


def _describe(asset: Asset, views: Sequence[View], outcome: str, image_size: tuple[int, int]) -> Plan:
    places = asset.places
    nearest, pixels = [0.0], [0.0]
    for view in views:
        nearest.append(float(places.distances_to(view.camera.position).min()))
        _, _, is_seen = view.measure(places)
        pixels.append(min(float(np.where(is_seen, view.extents(places), 0.0).max()), float(max(image_size))))
    images = sum(count_image_bytes(asset.objects).values())
    return Plan(
        source=asset.source,
        name=asset.name,
        places=len(asset.matrices),
        triangles=asset.triangles,
        image_bytes=images,
        nearest=min(nearest[1:], default=0.0),
        pixels=max(pixels),
        outcome=outcome,
    )


def describe_weight(plans: Sequence[Plan]) -> str:
    """Return a sentence about what levels can save, empty if that is much."""
    if sum(plan.total for plan in plans) < LIGHT_TRIANGLES:
        return "This is light: levels would save little."
    if sum(plan.triangles for plan in plans) < LIGHT_UNIQUE_TRIANGLES:
        return "Cycles keeps repeated meshes once, so that levels save little memory there; viewports and EEVEE draw all of them."
    return ""


def store_plans(rows: Any, plans: Iterable[Plan]) -> None:
    """Replace the rows of the list by `plans`; those of the same source keep the choices of the user."""
    kept = {row.source: (row.method, row.error_factor) for row in rows if row.source is not None}
    rows.clear()
    for plan in plans:
        row = rows.add()
        row.name, row.source, row.places, row.triangles = plan.name, plan.source, plan.places, plan.triangles
        row.image_megabytes, row.nearest, row.pixels, row.outcome = plan.image_bytes * 1e-6, plan.nearest, plan.pixels, plan.outcome
        row.method, row.error_factor = kept.get(plan.source, ("automatic", 1.0))


def read_options(scene: bpy.types.Scene) -> dict[int, AssetOptions]:
    """Return the choices of the user for the sources in the list of a scene, by session UID."""
    group = getattr(scene, "farfield_distance", None)  # Scripts may run without the panels.
    rows = group.plans if group is not None else ()
    return {row.source.session_uid: AssetOptions(row.method, row.error_factor) for row in rows if row.source is not None}
