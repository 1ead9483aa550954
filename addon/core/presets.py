"""Presets: files with the settings of a tool that differ from their defaults, and a sentence about them.

    {"description": "Rocks that float in layers", "settings": {"terrain": "islands", "scale": 2.0}}

The name of the file is that of the preset. Values have the units of `Settings`: radians and fractions. A file of a stranger is data: its
names and values are checked like those of a command line, and nothing in it is run.
"""

import dataclasses
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from .errors import FileError, SettingsError
from .files.atomic_write import atomic_write
from .files.file_access import read_file
from .files.filenames import safe_filename
from .json_values import parse_json, text
from .settings import Description, Settings, describe

SUFFIX = ".json"
MAX_BYTES = 100_000  # Many times the size of all settings of a tool.


@dataclass(frozen=True)
class Preset:
    """What a preset makes of the settings of a tool.

    description: one sentence, which may be empty. values: of the settings that differ from their defaults, by name.
    """

    description: str = ""
    values: Mapping[str, Any] = field(default_factory=dict)

    def build(self, settings_type: type[Settings]) -> Settings:
        """Return the settings of one type. Raises SettingsError where values are not allowed."""
        own = {each.name for each in dataclasses.fields(settings_type)}
        return settings_type(**{name: value for name, value in self.values.items() if name in own})


def preset_settings(settings_types: Iterable[type[Settings]]) -> list[Description]:
    """Return the settings that presets hold: those that name no file or data-block of the user."""
    return [item for item in describe(*settings_types) if item.in_presets]


def read_preset(path: Path, settings_types: Sequence[type[Settings]]) -> Preset:
    """Return the preset of a file, all of whose values are valid settings of `settings_types`.

    Raises:
        FileError: the file cannot be read or is no preset.
        SettingsError: a name or a value is not allowed.
    """
    content = read_file(path, MAX_BYTES)
    try:
        document = parse_json(content)
        if not isinstance(document, dict) or not isinstance(document.get("settings"), dict):
            raise ValueError("it has no settings")
        description = text(document.get("description", ""), "its description")
        values = _to_tuples(document["settings"], settings_types)
    except (ValueError, OverflowError) as error:
        raise FileError(f'"{path}" is no preset: {error}; save it again, or remove it.') from error
    try:
        check_values(values, settings_types)
    except OverflowError as error:
        raise SettingsError(f'The preset "{path.stem}" has a number that is too large; save it again, or remove it.') from error
    except SettingsError as error:
        raise SettingsError(f'The preset "{path.stem}" cannot be used: {error}', error.settings) from None
    return Preset(description, values)


def check_values(values: Mapping[str, Any], settings_types: Sequence[type[Settings]]) -> None:
    """Raise SettingsError when one of `values`, by name, is not allowed, or when they contradict each other."""
    known = {item.name for item in preset_settings(settings_types)}
    for name in values:
        if name not in known:
            raise SettingsError(f'It has no setting "{name}" in this version.')
    for settings_type in settings_types:
        Preset(values=values).build(settings_type)


def _to_tuples(values: Mapping[str, Any], settings_types: Iterable[type[Settings]]) -> dict[str, Any]:
    """Return values with tuples in place of the lists of JSON."""
    tuples = {item.name for item in preset_settings(settings_types) if item.type is tuple}
    return {name: tuple(value) if name in tuples and isinstance(value, list) else value for name, value in values.items()}


def write_preset(path: Path, preset: Preset) -> None:
    """Write a preset to a file, completely or not at all.

    Raises:
        FileError: the file cannot be written.
    """
    document = {"description": preset.description, "settings": dict(preset.values)}
    with atomic_write(path) as temporary:
        temporary.write_text(json.dumps(document, indent=2, ensure_ascii=False) + "\n", encoding="utf-8")


def preset_path(folder: Path, name: str) -> Path:
    """Return the path of the preset `name` in a folder; it need not exist. Characters that file names cannot have are replaced."""
    return folder / (safe_filename(name) + SUFFIX)


def list_presets(folder: Path) -> list[Path]:
    """Return the files of the presets in a folder in the order of their names; none if there is no such folder."""
    return sorted((path for path in folder.glob(f"*{SUFFIX}")), key=lambda path: path.stem.casefold())


def describe_values(preset: Preset, settings_types: Iterable[type[Settings]]) -> str:
    """Return the values of a preset in one line: "Levels 5, Textures off"."""
    named = [item for item in preset_settings(settings_types) if item.name in preset.values]
    return ", ".join(f"{item.label} {_format(item, preset.values[item.name])}" for item in named)


def _format(item: Description, value: Any) -> str:
    return item.choices[value].label if item.choices else item.format(value)
