# ruff: noqa: ARG001 - functions that are chosen at random have the same arguments
"""Random sequences of Farfield's operators and of what users do between them, on random scenes."""

import functools
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from random import Random
from typing import Any

import bpy
import campaign_actions
import campaign_images
import campaign_projects
import campaign_scenes
from campaign_checks import Problem
from campaign_inputs import Samples
from campaign_values import LIMITS, SMALL, random_properties

import random_inputs
from farfield.addon.core.billboards.settings import BillboardSettings, CrossfadeSettings
from farfield.addon.core.btf.settings import BtfSettings, ExportSettings
from farfield.addon.core.clipbox.settings import ClipboxSettings, ConvertSettings
from farfield.addon.core.restore.settings import MaskSettings, RestoreSettings
from farfield.addon.core.unwrap.settings import UnwrapSettings
from lib import environment

COUNTED = ("cameras", "collections", "images", "materials", "meshes", "node_groups", "objects", "scenes")
Operators = tuple[tuple[str, Callable[[Random, Path], dict[str, Any]]], ...]
DISABLED = "poll() failed"  # an operator that is not available in this context
UNCOUNTED_IMAGES = ("Render Result", "Viewer Node")


@dataclass
class OperatorCase:
    """What was done, and the promises that were broken."""

    tool: str
    record: Callable[[str], None]
    steps: list[str] = field(default_factory=list)
    problems: list[Problem] = field(default_factory=list)
    finished: int = 0
    refused: int = 0

    def add_step(self, step: str) -> None:
        """Remember a step that is about to be taken."""
        self.steps.append(step)
        self.record(step)


def run_case(random: Random, tool: str, folder: Path, samples: Samples, record: Callable[[str], None]) -> OperatorCase:
    """Call operators of `tool` on a random scene in random order. `record` is called with each step before it is taken."""
    farfield = environment.import_farfield()
    farfield.register()
    case = OperatorCase(tool, record)
    try:
        _open_scene(random, tool, folder, samples)
        for _ in range(random.randint(2, 6)):
            for _ in range(random.choice((0, 0, 1, 2))):
                campaign_actions.change_scene(random, folder, case.add_step)
            name, build_properties = random.choice(OPERATORS.get(tool) or _operators_of(tool))
            _call(case, name, build_properties(random, folder))
    finally:
        farfield.unregister()
    return case


def _open_scene(random: Random, tool: str, folder: Path, samples: Samples) -> None:
    choice = random.random()
    if tool == "btf" and choice < 0.8:
        bpy.ops.wm.open_mainfile(filepath=str(samples.baked_file() if choice < 0.5 else samples.cloud_file()), load_ui=False)
        campaign_scenes.select_some(random)
    elif tool == "billboards" and choice < 0.4:
        bpy.ops.wm.open_mainfile(filepath=str(samples.cloud_file()), load_ui=False)
        campaign_scenes.select_some(random)
    else:
        bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
        campaign_scenes.build_scene(random, folder)
        if tool in campaign_projects.PREPARATIONS and random.random() < 0.7:
            campaign_projects.PREPARATIONS[tool](random, folder, samples)
        if tool == "restore":
            campaign_images.add_images(random, folder)
    bpy.ops.ed.undo_push(message="Start")


def _operators_of(tool: str) -> Operators:
    """Return all operators of a tool, each with random values of some of its properties."""
    names = [name for name in dir(bpy.ops.farfield) if name.startswith(f"{tool}_")]
    return tuple((name, functools.partial(_random_properties, name, tool)) for name in names)


def _random_properties(name: str, tool: str, random: Random, folder: Path) -> dict[str, Any]:
    """Return small values of settings, and random ones of a third of the other properties."""
    properties: dict[str, Any] = {}
    for item in getattr(bpy.ops.farfield, name).get_rna_type().properties:
        if item.identifier in SMALL[tool] and random.random() < 0.9:
            properties[item.identifier] = SMALL[tool][item.identifier]
        elif item.identifier != "rna_type" and not item.is_readonly and (random.random() < 0.35 or "PATH" in item.subtype):
            value = _random_value(random, item, tool, folder)
            if value is not None:
                properties[item.identifier] = value
    return properties


def _random_value(random: Random, item: bpy.types.Property, tool: str, folder: Path) -> Any:
    if item.type == "BOOLEAN":
        return random.random() < 0.5
    if item.type in ("INT", "FLOAT") and not item.is_array:
        low, high = LIMITS.get(item.identifier, (max(item.soft_min, -1e6), min(item.soft_max, 1e6)))
        return random.randint(int(low), int(high)) if item.type == "INT" else random.uniform(low, high)
    if item.type == "ENUM":
        choices = [choice.identifier for choice in item.enum_items]
        return random.choice(choices) if choices and not item.is_enum_flag else None
    if item.type == "STRING":
        if "PATH" in item.subtype:
            names = ("out.glb", "out", "missing/out", "project/transforms.json", "project/images", "store", "", "line\nbreak")
            return str(folder / random.choice(names))
        return random.choice(("", "Ball", "serial", random_inputs.random_name(random)))
    return None


def _call(case: OperatorCase, name: str, properties: dict[str, Any]) -> None:
    """Call one operator. It finishes, is not available, or reports one sentence and leaves the scene as it was."""
    case.add_step(f"{name}({', '.join(f'{key}={value!r}' for key, value in properties.items())})")
    before = _count_data()
    message = ""
    try:
        result = getattr(bpy.ops.farfield, name)(**properties)
    except RuntimeError as error:  # how Blender tells scripts of a reported error
        result, message = {"CANCELLED"}, str(error)
    if result == {"FINISHED"}:
        case.finished += 1
        return
    case.refused += 1
    if DISABLED in message:
        return
    lines = [line for line in message.splitlines() if line.strip()]
    if "Traceback" in message:
        case.problems.append(Problem(f"traceback in {name}", message))
    elif "defect of Farfield" in message:
        case.problems.append(Problem(f"defect in {name}", message))
    elif message and len(lines) != 1:
        case.problems.append(Problem(f"{len(lines)} lines reported by {name}", message))
    changed = {kind: (count, _count_data()[kind]) for kind, count in before.items() if count != _count_data()[kind]}
    if changed:
        case.problems.append(Problem(f"refused {name} changed the scene", f"{message.strip()} {changed}"))


def _count_data() -> dict[str, int]:
    counts = {kind: len(getattr(bpy.data, kind)) for kind in COUNTED}
    counts["images"] -= sum(image.name in UNCOUNTED_IMAGES for image in bpy.data.images)
    return counts


def _build(random: Random, folder: Path) -> dict[str, Any]:
    flags = {name: random.random() < 0.5 for name in ("combine_selected", "keep_original_visible")}
    return random_properties(random, BillboardSettings, tool="billboards") | flags


def _show(random: Random, folder: Path) -> dict[str, Any]:
    return {"show": random.choice(("TOGGLE", "SOURCE", "CLOUD"))}


def _crossfade(random: Random, folder: Path) -> dict[str, Any]:
    return random_properties(random, CrossfadeSettings, tool="billboards")


def _bake(random: Random, folder: Path) -> dict[str, Any]:
    return random_properties(random, BtfSettings, tool="btf")


def _export(random: Random, folder: Path) -> dict[str, Any]:
    name = random.choice(("out.glb", "out.btf", "out.octahedral", "images", "missing/out.btf", "", "line\nbreak.btf"))
    return random_properties(random, ExportSettings, tool="btf") | {"filepath": str(folder / name) if name else ""}


def _unwrap(random: Random, folder: Path) -> dict[str, Any]:
    return random_properties(random, UnwrapSettings, tool="unwrap")


def _stretch_image(random: Random, folder: Path) -> dict[str, Any]:
    return {"filepath": str(folder / random.choice(("image.png", "missing/image", "image.jpg"))), "resolution": 64}


def _restore(random: Random, folder: Path) -> dict[str, Any]:
    settings = random_properties(random, MaskSettings, RestoreSettings, tool="restore")
    return settings | campaign_images.random_image_properties(random, folder)


def _mask(random: Random, folder: Path) -> dict[str, Any]:
    return {"image": campaign_images.random_image_properties(random, folder)["image"]}


def _terrain(random: Random, folder: Path) -> dict[str, Any]:
    return random_properties(random, ClipboxSettings, tool="clipbox") | (
        {"terrain": "formula", "formula": random_inputs.random_formula(random).replace("\0", "")} if random.random() < 0.3 else {}
    )


def _convert(random: Random, folder: Path) -> dict[str, Any]:
    return random_properties(random, ConvertSettings, tool="clipbox")


def _none(random: Random, folder: Path) -> dict[str, Any]:
    return {}


OPERATORS: dict[str, Operators] = {
    "billboards": (
        ("billboards_build", _build), ("billboards_build", _build), ("billboards_estimate", _none), ("billboards_show", _show),
        ("billboards_crossfade", _crossfade), ("billboards_show_level", _none),
    ),
    "btf": (
        ("btf_bake", _bake), ("btf_link_suns", _none), ("btf_link_suns", _none), ("btf_restore_pbr", _none), ("btf_export", _export),
        ("billboards_show", _show), ("billboards_crossfade", _crossfade),
    ),
    "unwrap": (
        ("unwrap", _unwrap), ("unwrap", _unwrap), ("unwrap_direction", _none), ("unwrap_overlay", _none),
        ("unwrap_stretch_image", _stretch_image),
    ),
    "restore": (
        ("restore_image", _restore), ("restore_image", _restore), ("restore_image", _restore), ("restore_mask", _mask),
        ("restore_outline", _none), ("restore_compare", _none),
    ),
    "clipbox": (
        ("clipbox_create", _terrain), ("clipbox_create", _terrain), ("clipbox_update", _terrain), ("clipbox_follow_view", _none),
        ("clipbox_convert_to_mesh", _convert),
    ),
}  # fmt: skip
