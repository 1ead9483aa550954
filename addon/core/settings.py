"""Settings declared once: a frozen dataclass from which panels, command-line flags and the tables in docs are built.

    @dataclass(frozen=True, kw_only=True)
    class BillboardSettings(Settings):
        error: float = setting(0.01, "Largest distance ...", minimum=1e-5, maximum=0.5, unit=Unit.SHARE)

Values are kept in the units of the core (angles in radians, shares as fractions); panels and flags show them in the units of people
(degrees, per cent), see `Unit`.
"""

import argparse
import dataclasses
import math
from dataclasses import dataclass
from enum import Enum
from typing import Any

from .errors import SettingsError


class Unit(Enum):
    """What a number means, and how people write it."""

    NONE = ""
    SHARE = "%"  # of the longest side of the bounding box, or of another whole; a fraction inside
    ANGLE = "degrees"  # radians inside
    PIXELS = "px"
    COUNT = "count"
    MEGABYTES = "MB"
    LENGTH = "scene units"


@dataclass(frozen=True)
class Description:
    """One setting as panels, flags and docs see it."""

    name: str
    type: type
    default: Any
    help: str
    minimum: float | None
    maximum: float | None
    unit: Unit
    choices: dict[str, str]

    @property
    def flag(self) -> str:
        """The command-line flag, for instance `--max-normal-deviation`; a switch that is on by default is turned off by `--no-...`."""
        switched_on = self.type is bool and self.default
        return ("--no-" if switched_on else "--") + self.name.replace("_", "-")

    def shown(self, value: Any) -> str:
        """`value` as people write it: `1%`, `60`, `clusters`."""
        if self.unit is Unit.SHARE:
            return f"{value * 100:g}%"
        if self.unit is Unit.ANGLE:
            return f"{math.degrees(value):g}"
        if isinstance(value, bool):
            return "on" if value else "off"
        if isinstance(value, tuple):
            return ",".join(f"{number:g}" for number in value)
        return f"{value:g}" if isinstance(value, float) else str(value)

    def parse(self, text: str) -> Any:
        """The value written as `text` on a command line.

        Raises:
            SettingsError: when `text` cannot be read as this setting.
        """
        try:
            if self.type is float:
                number = float(text.rstrip("% ")) / (100.0 if text.rstrip().endswith("%") else 1.0)
                return math.radians(number) if self.unit is Unit.ANGLE else number
            if self.type is tuple:
                return tuple(float(number) for number in text.split(","))
            return self.type(text)
        except ValueError:
            takes = "numbers with commas between them" if self.type is tuple else "a number"
            raise SettingsError(f'{self.flag} takes {takes}, not "{text}".') from None


def setting(
    default: Any,
    help: str,
    *,
    minimum: float | None = None,
    maximum: float | None = None,
    unit: Unit = Unit.NONE,
    choices: dict[str, str] | None = None,
) -> Any:
    """A dataclass field with all that is known about one setting. `choices` maps each allowed word to its help."""
    metadata = {"help": help, "minimum": minimum, "maximum": maximum, "unit": unit, "choices": choices or {}}
    return dataclasses.field(default=default, metadata=metadata)


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Base of a tool's settings: checks every value against its declaration when it is made."""

    def __post_init__(self) -> None:
        for description in describe(type(self)):
            check(description, getattr(self, description.name))


def describe(settings_type: type[Settings]) -> list[Description]:
    """The settings of `settings_type` in their declared order."""
    return [
        Description(name=field.name, type=type(field.default), default=field.default, **field.metadata)
        for field in dataclasses.fields(settings_type)
    ]


def check(description: Description, value: Any) -> None:
    """Raise SettingsError when `value` is not allowed for this setting."""
    if description.choices:
        if value not in description.choices:
            words = ", ".join(description.choices)
            raise SettingsError(f'{description.flag} must be one of {words}, not "{value}".')
        return
    if description.type is tuple:
        if len(value) != len(description.default) or not all(math.isfinite(number) for number in value):
            raise SettingsError(
                f"{description.flag} takes {len(description.default)} finite numbers, not {description.shown(tuple(value))}."
            )
        return
    if not isinstance(value, int | float) or isinstance(value, bool):
        return
    if not math.isfinite(value):
        raise SettingsError(f"{description.flag} must be a finite number, not {value}.")
    low, high = description.minimum, description.maximum
    if low is not None and value < low:
        raise SettingsError(f"{description.flag} is {description.shown(value)}; the smallest is {description.shown(low)}.")
    if high is not None and value > high:
        raise SettingsError(f"{description.flag} is {description.shown(value)}; the largest is {description.shown(high)}.")


def add_flags(parser: argparse.ArgumentParser, settings_type: type[Settings]) -> None:
    """Add one flag a setting to `parser`."""
    for description in describe(settings_type):
        text = description.help.replace("%", "%%")
        if description.type is bool:
            parser.add_argument(description.flag, dest=description.name, action="store_const", const=not description.default, help=text)
        else:
            default = description.shown(description.default).replace("%", "%%")
            parser.add_argument(
                description.flag, dest=description.name, choices=list(description.choices) or None, help=f"{text} (default: {default})"
            )


def from_flags(settings_type: type[Settings], arguments: argparse.Namespace) -> Settings:
    """The settings that a parser built by `add_flags` has read.

    Raises:
        SettingsError: when a value cannot be read or is out of its range.
    """
    values = {}
    for description in describe(settings_type):
        given = getattr(arguments, description.name)
        if given is not None:
            values[description.name] = description.parse(given) if isinstance(given, str) else given
    return settings_type(**values)


def markdown_table(settings_type: type[Settings]) -> str:
    """The settings as a Markdown table for docs."""
    rows = ["| flag | default | range | what it does |", "|---|---|---|---|"]
    for description in describe(settings_type):
        if description.choices:
            span = ", ".join(f"`{word}`" for word in description.choices)
        elif description.minimum is None or description.type is bool:
            span = ""
        else:
            high = "" if description.maximum is None else description.shown(description.maximum)
            span = f"{description.shown(description.minimum)} to {high}".rstrip()
        default = description.shown(description.default)
        rows.append(f"| `{description.flag}` | {default} | {span} | {description.help} |")
    return "\n".join(rows)
