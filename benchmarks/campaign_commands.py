"""Random command lines of the scripts, with their input files."""

import os
from dataclasses import dataclass, field
from pathlib import Path
from random import Random

import bpy
import campaign_actions
import campaign_checks
import campaign_inputs
import campaign_projects
from campaign_inputs import MESH_SUFFIXES, TERRAIN_SUFFIXES, Samples
from campaign_values import random_flags, small_flags

import random_inputs

OUT_SUFFIXES = {
    "billboards": (".blend", ".obj", ".glb"),
    "btf": (".blend",),
    "unwrap": (".blend", ".obj", ".glb"),
    "clipbox": (".blend", ".ply", ".obj"),
    "restore": campaign_inputs.IMAGE_SUFFIXES,
    "texmesh": (".blend", ".glb"),
    "photos": (".blend", ".obj", ".glb"),
}
MASK_WORDS = ("alpha", "#000000", "#FFFFFF", "#808080", "#12345", "")
EXPORT_SUFFIXES = (".glb", ".btf", ".octahedral", "")
OUT_NAMES = (
    "out",
    "Größe 樹",
    "-out",
    "a b",
    "..",
    "CON",
    "line\nbreak",
    "x" * 250,
    os.fsdecode(b"\xff"),
    "new/folder/out",
    "in.blend/out",
)
INTERRUPTED_FRACTION = 0.03
PROJECTS = {
    "texmesh": campaign_projects.texmesh_arguments,
    "packages": campaign_projects.packages_arguments,
    "photos": campaign_projects.photos_arguments,
    "bdam": campaign_projects.bdam_arguments,
}
OUTPUTS_OF_COMMANDS = {
    "levels": {"--out": (".blend", ".glb"), "--report": (".json",)},
    "analyze": {"--plot": (".png",), "--report": (".json",)},
    "build": {"--out": ("",), "--report": (".json",)},
    "verify": {},
    "info": {"--report": (".json",)},
    "extract": {"--out": (".ply", ".obj", ".blend"), "--report": (".json",)},
    "photos": {
        "--texture": (".png", ".png", ".<UDIM>.png"),
        "--out": OUT_SUFFIXES["photos"],
        "--stages": ("",),
        "--overlays": ("",),
        "--report": (".json",),
    },
}
REQUIRED_OUTPUTS = {"levels": ("--out",), "build": ("--out",), "extract": ("--out",), "photos": ("--texture",)}


@dataclass
class CommandCase:
    """One run of a script.

    outputs: the files and folders that the arguments name; work: the folder of --work, which a failed run may fill. interrupt_after:
    seconds until Ctrl+C, None for never. changes: what was done to the scene of the input file.
    """

    tool: str
    arguments: list[str] = field(default_factory=list)
    outputs: list[Path] = field(default_factory=list)
    work: Path | None = None
    interrupt_after: float | None = None
    changes: list[str] = field(default_factory=list)


def build_case(random: Random, tool: str, folder: Path, samples: Samples) -> CommandCase:
    """Write the input files of a random case to `folder` and return its arguments."""
    case = CommandCase(tool)
    source: Path | None = None
    if tool in PROJECTS:
        return _build_project_case(random, case, folder, samples)
    if tool == "clipbox":
        _add_terrain(random, case, folder, samples)
    elif tool == "restore":
        source = _add_images(random, case, folder)
    else:
        source = _write_cloud_input(random, folder, samples, case) if tool == "btf" else _write_mesh_input(random, folder, samples)
        case.arguments.append(str(source))
        if tool == "unwrap" and random.random() < 0.3:
            case.arguments.append(f"--direction={random.choice(('0,0,1', '0,0,0', 'nan,0,0', '1,1', '1e300,0,0'))}")
    if random.random() > 0.01:
        _add_output(case, "--out", _choose_output(random, folder, random.choice(OUT_SUFFIXES[tool]), source, case))
    if random.random() < 0.25:
        _add_output(case, "--report", _choose_output(random, folder, ".json", source, case))
    if tool == "unwrap" and random.random() < 0.3:
        _add_output(case, "--image", _choose_output(random, folder, ".png", source, case))
    if tool == "btf":
        _add_bake_outputs(random, case, folder, source)
    if tool == "restore":
        _add_restore_outputs(random, case, folder, source)
    if tool == "billboards" and random.random() < 0.2:
        case.arguments.append(random.choice(("--cross-fade", "--keep-original-visible", "--no-textures")))
    if tool == "clipbox" and random.random() < 0.15:
        case.arguments.append("--convert-to-mesh")
    case.arguments += small_flags(tool) + random_flags(random, tool)
    if random.random() < 0.02:
        case.arguments.append(random.choice(("--nonsense", "--", "extra", "--help", "--out")))
    if random.random() < INTERRUPTED_FRACTION:
        case.interrupt_after = random.uniform(0.0, 1.0 if tool != "btf" else 5.0)
    return case


def _build_project_case(random: Random, case: CommandCase, folder: Path, samples: Samples) -> CommandCase:
    """Add arguments of a script with commands or folders."""
    case.arguments, source = PROJECTS[case.tool](random, folder, samples)
    command = case.arguments[0] if case.tool != "photos" else "photos"
    outputs = OUTPUTS_OF_COMMANDS[command]
    for flag, suffixes in outputs.items():
        is_required = flag in REQUIRED_OUTPUTS.get(command, ())
        if random.random() < (0.98 if is_required else 0.2):
            _add_output(case, flag, _choose_output(random, folder, random.choice(suffixes), source, case))
            if flag == "--overlays":
                case.work = case.outputs[-1]  # They show why a merge fails, and are written before it.
    if case.tool == "bdam" and command == "build" and case.outputs and case.outputs[0].name:  # A build that was cancelled can continue.
        case.work = case.outputs[0].with_name(f".{case.outputs[0].name}.farfield-build")
    if command in ("levels", "build", "photos"):
        case.arguments += small_flags(case.tool) + random_flags(random, case.tool)
    if random.random() < 0.02:
        case.arguments.append(random.choice(("--nonsense", "extra", "--help")))
    if random.random() < INTERRUPTED_FRACTION:
        case.interrupt_after = random.uniform(0.0, 1.5)
    return case


def _write_mesh_input(random: Random, folder: Path, samples: Samples) -> Path:
    choice = random.random()
    if choice < 0.35:
        return campaign_inputs.write_mesh(random, folder)
    if choice < 0.7:
        return campaign_inputs.write_scene(random, folder)
    if choice < 0.93:
        return campaign_inputs.write_damaged(random, samples.mesh_file(random.choice(MESH_SUFFIXES)), folder)
    return campaign_inputs.odd_path(random, folder, random.choice(MESH_SUFFIXES))


def _write_cloud_input(random: Random, folder: Path, samples: Samples, case: CommandCase) -> Path:
    """Write a file with a cloud in which a user has changed things, or another file."""
    choice = random.random()
    if choice > 0.9:
        return campaign_inputs.odd_path(random, folder, ".blend")
    if choice > 0.75:
        return campaign_inputs.write_damaged(random, samples.cloud_file(), folder)
    if choice > 0.65:
        return campaign_inputs.write_scene(random, folder)
    bpy.ops.wm.open_mainfile(filepath=str(samples.cloud_file()), load_ui=False)
    for _ in range(random.choice((0, 0, 1, 1, 2))):
        campaign_actions.change_scene(random, folder, case.changes.append)
    path = folder / "in.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path), check_existing=False)
    return path


def _add_terrain(random: Random, case: CommandCase, folder: Path, samples: Samples) -> None:
    position = [random.choice((0.0, 1.5, -30.0, 60.0)) for _ in range(3)]
    if random.random() < 0.15:
        position[random.randrange(3)] = random.choice((1e6, 1e15, 1e300, float("nan"), float("inf")))
    case.arguments += ["--at", ",".join(map(str, position)) if random.random() < 0.9 else random_inputs.bad_value(random)]
    choice = random.random()
    if choice < 0.35:
        terrain = random.choice(("heights", "volume", "forest"))
        sample = samples.terrain_file(random.choice(TERRAIN_SUFFIXES), random)
        if terrain == "forest" and random.random() < 0.5:
            sample = samples.mesh_file(random.choice(MESH_SUFFIXES))
        source = campaign_inputs.write_damaged(random, sample, folder) if random.random() < 0.6 else sample
        if random.random() < 0.1:
            source = campaign_inputs.odd_path(random, folder, random.choice(TERRAIN_SUFFIXES))
        case.arguments += ["--terrain", terrain, f"--source={source}"]
        if random.random() < 0.2:
            image = campaign_inputs.write_damaged(random, samples.terrain_file(".png", random), folder)
            case.arguments.append(f"--source-color={image}")
    elif choice < 0.7:
        case.arguments.append(f"--formula={random_inputs.random_formula(random)}".replace("\0", ""))
    if random.random() < 0.15:
        case.arguments.append(f"--path={campaign_inputs.write_path(random, folder)}")


def _add_images(random: Random, case: CommandCase, folder: Path) -> Path:
    """Add an image and a mask, which may be a word, and return the path of the image."""
    image, mask = campaign_inputs.write_images(random, folder)
    if random.random() < 0.1:
        image = campaign_inputs.odd_path(random, folder, random.choice(campaign_inputs.IMAGE_SUFFIXES))
    case.arguments += [str(image), random.choice(MASK_WORDS) if random.random() < 0.2 else str(mask)]
    if random.random() < 0.2:
        case.arguments.append(random.choice(("--data", "--normal-map")))
    if random.random() < 0.1:
        case.arguments.append(f"--color-tolerance={random.choice(('0', '5%', '100%', random_inputs.bad_value(random)))}")
    if random.random() < 0.2:
        case.arguments.append(f"{random.choice(('--source-mask', '--barriers'))}={random.choice((image, mask))}")
    return image


def _add_restore_outputs(random: Random, case: CommandCase, folder: Path, source: Path | None) -> None:
    if random.random() < 0.2:
        _add_output(case, "--curve", _choose_output(random, folder, ".png", source, case))
    if random.random() < 0.2:
        _add_output(case, "--stages", _choose_output(random, folder, "", source, case))


def _add_bake_outputs(random: Random, case: CommandCase, folder: Path, source: Path | None) -> None:
    if random.random() < 0.2:
        _add_output(case, "--curve", _choose_output(random, folder, ".png", source, case))
    for _ in range(random.choice((0, 0, 0, 1, 2))):
        _add_output(case, "--export", _choose_output(random, folder, random.choice(EXPORT_SUFFIXES), source, case))
    if random.random() < 0.3:
        case.work = random.choice((folder / "work", folder / "work" / "deep", folder / "in.blend", None))
        if case.work == folder / "work" and random.random() < 0.3:
            case.work.mkdir()
            (case.work / "job.json").write_bytes(random_inputs.damage(random, b'{"version": 1, "fingerprint": "abc", "views": [1, 2]}'))
        case.arguments += ["--work", "" if case.work is None else str(case.work)]


def _add_output(case: CommandCase, flag: str, path: Path) -> None:
    case.arguments.append(f"{flag}={path}")
    case.outputs.append(path)


def _choose_output(random: Random, folder: Path, suffix: str, source: Path | None, case: CommandCase) -> Path:
    """Return the path of an output: mostly a new file, else an existing one, another output, the input, a link, a folder, an odd name."""
    path = folder / f"out-{len(case.outputs)}{suffix}"
    choice = 2.0 * random.random()
    if choice < 0.1:
        path.write_bytes(campaign_checks.OLD_CONTENT)
        if choice < 0.03:
            path.chmod(0o444)
    elif choice < 0.13 and case.outputs:
        return case.outputs[0]
    elif choice < 0.17 and source is not None:
        return source
    elif choice < 0.2:
        target = folder / f"target{suffix}"
        target.write_bytes(b"what the link leads to")
        path.symlink_to(target.name)
    elif choice < 0.23:
        path.mkdir()
        (path / "content").write_bytes(b"content")
    elif choice < 0.26:
        path = path.with_suffix(random.choice(("", ".xyz", suffix.upper())))
    elif choice < 0.34:
        path = folder / (random.choice(OUT_NAMES) + suffix)
    return path
