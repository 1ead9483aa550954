"""What the commands of `texmesh.py` and `packages.py` read: settings and objects."""

from argparse import Namespace

import bpy

from lib import environment

environment.import_farfield()

from farfield.addon.core.errors import SettingsError
from farfield.addon.core.files.file_access import read_file
from farfield.addon.core.settings import describe
from farfield.addon.core.texmesh.level_candidates import parse_ratios
from farfield.addon.core.texmesh.perception.answer_settings import estimate_settings
from farfield.addon.core.texmesh.perception.recorded_answers import MAX_ANSWER_BYTES, decode_answers, merge_answers
from farfield.addon.core.texmesh.settings import LevelSettings, TexmeshSettings
from lib import command_line, run_files, scene_files

BUDGETS = {choice: item for item in describe(LevelSettings) for choice in item.used_if.get("levels", ())}


def add_answers_flag(parser: command_line.Parser) -> None:
    """Add the flag for answers of judges."""
    parser.add_argument(
        "--answers",
        nargs="+",
        type=run_files.INPUT,
        metavar="FILE",
        help="files with answers of a calibration, which give --weber-threshold and --distance-factor",
    )


def read_level_settings(given: Namespace) -> TexmeshSettings:
    """Return the settings of levels. What determines the levels follows from the flags if it is not given, and what answers of judges give
    from those.

    Raises:
        SettingsError: a value is invalid, two flags imply different choices of levels, or answers give no threshold.
        FileError: a file of answers is damaged.
    """
    implied = [choice for choice, item in BUDGETS.items() if getattr(given, item.name) is not None]
    if given.levels is None and implied:
        if len(implied) > 1:
            names = " and ".join(BUDGETS[choice].flag for choice in implied)
            raise SettingsError(f"{names} exclude each other; give one, or name the one that counts by --levels.")
        given.levels = implied[0]
    if given.answers:
        parts = [decode_answers(read_file(path, MAX_ANSWER_BYTES), str(path)) for path in given.answers]
        values, _ = estimate_settings(merge_answers(parts))
        for name, value in values.items():
            if getattr(given, name) is None:
                setattr(given, name, value)
    settings = command_line.read_settings(given, TexmeshSettings)[TexmeshSettings]
    if settings.levels == "ratios":
        parse_ratios(settings.ratios)
    return settings


def open_objects(given: Namespace) -> tuple[list[bpy.types.Object], str]:
    """Open the input and return its objects with surfaces that are visible in renders, and a sentence if they were moved to the origin.
    Raises FarfieldError."""
    origin = scene_files.open_near_origin(given.input.absolute(), given.files)
    return scene_files.objects_in_renders(given.input), scene_files.describe_moved(origin)
