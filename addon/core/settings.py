"""Settings declared once: frozen dataclasses that panels, command-line flags and the tables in the docs are built from.

    @dataclass(frozen=True, kw_only=True)
    class BillboardSettings(Settings):
        error: float = setting(0.01, "Largest distance ...", minimum=1e-5, maximum=0.5, unit=Unit.FRACTION)

Settings hold internal units: radians and fractions. Panels and flags show degrees and percentages, see `Unit`. When a setting counts is
declared with it, as `used_if={"terrain": ("heights",)}`: panels hide it otherwise, texts say so, and a command line warns.
"""

import argparse
import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from numbers import Integral, Real
from types import SimpleNamespace
from typing import Any, ClassVar, Literal

from .errors import SettingsError

TYPE_NAMES = {float: "a number", int: "an integer", bool: "true or false", str: "text", tuple: "a list of numbers"}
ABBREVIATIONS = {"Mb": "MB", "Uv": "UV"}  # in labels
SMALL_WORDS = {"Per": "per", "To": "to", "In": "in", "Of": "of"}  # in labels, except as their first word

# What another setting must be: one of these values, or True for anything but off, 0 or empty, and False for the opposite.
Condition = tuple[str, ...] | bool


class Unit(Enum):
    """The unit of a number."""

    NONE = ""
    FRACTION = "%"  # A fraction internally; the help says of which quantity.
    ANGLE = "degrees"  # Radians internally.
    LENGTH = "scene units"
    SECONDS = "seconds"
    PIXELS = "px"


@dataclass(frozen=True)
class Choice:
    """One value of a setting with several values: its label in the interface and one line of help."""

    label: str
    help: str


@dataclass(frozen=True)
class Description:
    """The declaration of one setting, as panels, flags and docs need it.

    Attributes:
        name: of the field.
        type: one of `TYPE_NAMES`.
        default: its value unless it is given.
        help: one sentence without a full stop.
        label: in the interface. In lower case and with hyphens it is the flag.
        minimum: lowest allowed number, None for no limit.
        maximum: highest allowed number, None for no limit.
        unit: of a number.
        choices: every allowed value with its `Choice`.
        path: marks a string as the path of a file or folder.
        is_color: marks three numbers as a color as displayed, 0 to 1.
        group: the sub-panel that shows the setting, "" for the main panel.
        panel_label: replaces `label` in a panel, where there is room for about 15 characters.
        in_presets: whether presets hold it; not if it names a file or data-block of the user.
        used_if: what other settings must be so that this one counts, by name; all must be so.
        condition: the same as text, for instance "Terrain is Heights or Forest"; "" if the setting always counts.
    """

    name: str
    type: type
    default: Any
    help: str
    label: str
    minimum: float | None
    maximum: float | None
    unit: Unit
    choices: dict[str, Choice]
    path: Literal["file", "folder"] | None
    is_color: bool
    group: str
    panel_label: str
    in_presets: bool
    used_if: Mapping[str, Condition]
    condition: str = ""

    @property
    def tooltip(self) -> str:
        """The help text, and when the setting counts."""
        return f"{self.help}. Used if {self.condition}" if self.condition else self.help

    @property
    def flag(self) -> str:
        """The command-line flag, for instance `--max-normal-deviation`."""
        return flag_of(self.name)

    @property
    def flags(self) -> tuple[str, ...]:
        """All flags of the setting: `--textures` and `--no-textures` for a boolean, otherwise `flag` alone."""
        return (self.flag, "--no-" + self.flag.removeprefix("--")) if self.type is bool else (self.flag,)

    @property
    def has_integers(self) -> bool:
        """Whether the setting is several integers."""
        return self.type is tuple and all(isinstance(number, int) for number in self.default)

    def with_flag(self, value: Any) -> str:
        """Return the flag that sets `value`: `--levels 3`, `--no-textures`."""
        return self.flags[not value] if self.type is bool else f"{self.flag} {self.format(value)}"

    def format(self, value: Any) -> str:
        """Return `value` in the units of the interface: `1%`, `60`, `clusters`."""
        if self.unit is Unit.FRACTION:
            return f"{value * 100:g}%"
        if self.unit is Unit.ANGLE:
            return f"{math.degrees(value):g}"
        if isinstance(value, bool):
            return "on" if value else "off"
        if isinstance(value, tuple):
            return ",".join(f"{number:g}" for number in value)
        return f"{value:g}" if isinstance(value, float) else str(value)

    def parse(self, text: str) -> Any:
        """Return the value written as `text` on a command line.

        Raises:
            SettingsError: `text` cannot be read as this setting.
        """
        try:
            if self.type is float:
                number = float(text.rstrip("% ")) / (100.0 if text.rstrip().endswith("%") else 1.0)
                return math.radians(number) if self.unit is Unit.ANGLE else number
            if self.type is tuple:
                return tuple((int if self.has_integers else float)(number) for number in text.split(","))
            return self.type(text)
        except ValueError:
            numbers = "integers" if self.has_integers else "numbers"
            expected = f"{numbers} separated by commas" if self.type is tuple else "a number"
            raise SettingsError(f'{self.label} must be {expected}, not "{text}".', settings=(self.name,)) from None


def setting(
    default: Any,
    help: str,
    *,
    label: str | None = None,
    minimum: float | None = None,
    maximum: float | None = None,
    unit: Unit = Unit.NONE,
    choices: dict[str, Choice] | None = None,
    path: Literal["file", "folder"] | None = None,
    is_color: bool = False,
    group: str = "",
    panel_label: str | None = None,
    in_presets: bool | None = None,
    used_if: Mapping[str, Condition] | None = None,
) -> Any:
    """Declare one setting as a dataclass field; see `Description`. `label` is the field's name in title case by default, `panel_label` is
    `label`, and presets hold it unless it is a path."""
    metadata = {"help": help, "label": label, "minimum": minimum, "maximum": maximum, "unit": unit, "choices": choices or {}, "path": path}
    metadata |= {"is_color": is_color, "group": group, "panel_label": panel_label, "used_if": used_if or {}}
    metadata["in_presets"] = path is None if in_presets is None else in_presets
    return dataclasses.field(default=default, metadata=metadata)


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Base class of settings. Checks every value against its declaration on construction.

    has_flags: whether scripts have a flag for each setting. depends_on: other classes with settings that `used_if` names.
    """

    has_flags: ClassVar[bool] = True
    depends_on: ClassVar[tuple[type["Settings"], ...]] = ()

    def __post_init__(self) -> None:
        for description in describe(type(self)):
            check(description, getattr(self, description.name))


def describe(*settings_types: type[Settings]) -> list[Description]:
    """Return the settings of these classes in declaration order."""
    descriptions = []
    for settings_type in settings_types:
        others = {item.name: item for other in settings_type.depends_on for item in describe(other)}
        own = {field.name: _describe_field(field) for field in dataclasses.fields(settings_type)}
        for item in own.values():
            conditions = [_describe_condition((others | own)[name], wanted) for name, wanted in item.used_if.items()]
            descriptions.append(dataclasses.replace(item, condition=" and ".join(conditions)))
    return descriptions


def _describe_field(field: dataclasses.Field) -> Description:
    label = field.metadata["label"] or default_label(field.name)
    labels = {"label": label, "panel_label": field.metadata["panel_label"] or label}
    return Description(name=field.name, type=type(field.default), default=field.default, **{**field.metadata, **labels})


def _describe_condition(item: Description, wanted: Condition) -> str:
    """Return what the setting `item` must be, as text."""
    if isinstance(wanted, bool):
        states = ("off", "on") if item.type is bool else ("0", "not 0")
        return f"{item.label} is {states[wanted]}"
    excluded = [choice.label for value, choice in item.choices.items() if value not in wanted]
    if len(excluded) == 1 and len(wanted) > 1:
        return f"{item.label} is not {excluded[0]}"
    *labels, last = [item.choices[value].label for value in wanted]
    return f"{item.label} is {', '.join(labels)} or {last}" if labels else f"{item.label} is {last}"


def is_used(description: Description, values: Any) -> bool:
    """Return whether a setting counts.

    values: an object whose attributes are the values of the settings that `used_if` names: settings, or the property group of a panel.
    """
    return _find_unmet(description, values) is None


def _find_unmet(description: Description, values: Any) -> str | None:
    """Return the name of the first setting because of which a setting does not count, None if it counts; see `is_used`."""
    for name, wanted in description.used_if.items():
        value = getattr(values, name)
        if bool(value) is not wanted if isinstance(wanted, bool) else value not in wanted:
            return name
    return None


def default_label(name: str) -> str:
    """Return the label of the field `name`: `Max Normal Deviation`, `Texture MB`, `UV Map`."""
    first, *others = name.replace("_", " ").title().split()
    return " ".join([ABBREVIATIONS.get(first, first), *((ABBREVIATIONS | SMALL_WORDS).get(word, word) for word in others)])


def flag_of(name: str) -> str:
    """Return the command-line flag of the field `name`."""
    return "--" + name.replace("_", "-")


def check(description: Description, value: Any) -> None:
    """Raise SettingsError, with the setting's label, when `value` is not allowed for this setting."""
    problem = _find_problem(description, value)
    if problem is not None:
        raise SettingsError(f"{description.label} {problem}.", settings=(description.name,))


def _find_problem(description: Description, value: Any) -> str | None:
    """Return the rest of a sentence that begins with the setting's label, None when `value` is allowed."""
    if not _has_type(description.type, value):
        return f"must be {TYPE_NAMES[description.type]}, not {value!r:.60}"
    if description.choices:
        return None if value in description.choices else f'must be one of {", ".join(description.choices)}, not "{value}"'
    if description.type is tuple:
        if len(value) != len(description.default) or not all(math.isfinite(number) for number in value):
            return f"must be {len(description.default)} finite numbers, not {description.format(tuple(value))}"
        if description.has_integers and not all(isinstance(number, Integral) for number in value):
            return f"must be {len(description.default)} integers, not {description.format(tuple(value))}"
        return next(filter(None, (_find_limit_problem(description, number) for number in value)), None)
    if not isinstance(value, int | float) or isinstance(value, bool):
        return None
    if isinstance(value, float) and not math.isfinite(value):
        return f"must be a finite number, not {value}"
    return _find_limit_problem(description, value)


def _find_limit_problem(description: Description, value: float) -> str | None:
    """Return the rest of a sentence that begins with the setting's label, None when a number is within the limits."""
    if description.minimum is not None and value < description.minimum:
        return f"is {description.format(value):.60}; the minimum is {description.format(description.minimum)}"
    if description.maximum is not None and value > description.maximum:
        return f"is {description.format(value):.60}; the maximum is {description.format(description.maximum)}"
    return None


def _has_type(setting_type: type, value: Any) -> bool:
    """Return whether `value` can be a setting of this type: settings in a file from elsewhere can have any JSON type."""
    if setting_type in (float, int):
        return isinstance(value, Real if setting_type is float else Integral) and not isinstance(value, bool)
    if setting_type is tuple:
        return isinstance(value, tuple | list) and all(_has_type(float, number) for number in value)
    return isinstance(value, setting_type)


def add_flags(parser: argparse.ArgumentParser, settings_type: type[Settings], names: Sequence[str] | None = None) -> None:
    """Add one flag per setting, or for those with these `names`, to `parser`."""
    for description in describe(settings_type):
        if names is not None and description.name not in names:
            continue
        default = description.format(description.default)
        text = (f"{description.tooltip} (default: {default})" if default else description.tooltip).replace("%", "%%")
        if description.type is bool:
            parser.add_argument(description.flag, dest=description.name, action=argparse.BooleanOptionalAction, help=text)
        else:
            parser.add_argument(description.flag, dest=description.name, choices=list(description.choices) or None, help=text)


def from_flags(settings_type: type[Settings], arguments: argparse.Namespace) -> Settings:
    """Return the settings that a parser built by `add_flags` has read.

    Raises:
        SettingsError: a value cannot be read or is out of range; the message begins with the flag.
    """
    values = {}
    try:
        for description in describe(settings_type):
            given = getattr(arguments, description.name, None)
            if given is not None:
                values[description.name] = description.parse(given) if isinstance(given, str) else given
        return settings_type(**values)
    except SettingsError as error:
        raise with_flags(error) from None


def unused_flags(arguments: argparse.Namespace, settings: Sequence[Settings]) -> list[str]:
    """Return a sentence for each flag that was given although its setting does not count with these `settings`."""
    values = SimpleNamespace(**{name: value for each in settings for name, value in vars(each).items()})
    descriptions = {item.name: item for each in settings for item in describe(type(each))}
    sentences = []
    for item in descriptions.values():
        unmet = None if getattr(arguments, item.name, None) is None else _find_unmet(item, values)
        if unmet is not None:
            flag = item.with_flag(getattr(values, item.name)).split()[0]
            sentences.append(f"{flag} is not used with {descriptions[unmet].with_flag(getattr(values, unmet))}.")
    return sentences


def with_flags(error: SettingsError) -> SettingsError:
    """Return `error` for a command line: its message preceded by the flags of the settings that it names."""
    if not error.settings:
        return error
    return SettingsError(f"{', '.join(flag_of(name) for name in error.settings)}: {error}")
