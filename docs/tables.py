"""Update the tables of settings and operators in the docs from their declarations: `python3 docs/tables.py`.

A table is between a line `<!-- settings: NAME -->` and a line `<!-- end of settings -->`; see `find_settings` for the names. That of all
operators is between `<!-- operators -->` and `<!-- end of operators -->`.
"""

import importlib
import re
import sys
from pathlib import Path

FOLDER = Path(__file__).resolve().parent
sys.path.insert(0, str(FOLDER.parent / "scripts"))

from lib import environment

environment.ensure()
environment.import_farfield()

sys.path.insert(0, str(FOLDER))
importlib.import_module("farfield.addon.registration")  # It imports all operators and panels.

from operator_table import operator_table

from farfield.addon.core.settings import Description, Settings, describe

TABLE = re.compile(r"(<!-- settings: (\w+) -->\n).*?(<!-- end of settings -->)", re.DOTALL)
OPERATORS = re.compile(r"(<!-- operators -->\n).*?(<!-- end of operators -->)", re.DOTALL)


def find_settings() -> dict[str, type[Settings]]:
    """Return the settings classes in `core/<tool>/settings.py` and in those of its sub-packages by table name.

    The table of the settings class that is named after the tool has the name of the tool; the names of others have a suffix:
    `clipbox` for `ClipboxSettings`, `clipbox_convert` for `ConvertSettings`, `billboards_build` for `BuildOptions`.
    """
    tables = {}
    core = environment.ROOT / "addon" / "core"
    for path in sorted([*core.glob("*/settings.py"), *core.glob("*/*/settings.py")]):
        parts = path.relative_to(core).with_suffix("").parts
        tool = parts[0]
        module = importlib.import_module(f"farfield.addon.core.{'.'.join(parts)}")
        for name, item in vars(module).items():
            if isinstance(item, type) and issubclass(item, Settings) and item is not Settings:
                subject = name.removesuffix("Settings").removesuffix("Options").lower()
                tables[tool if tool.startswith(subject) else f"{tool}_{subject}"] = item
    return tables


def update_tables(text: str) -> str:
    """Return the page `text` with every table replaced by the current declarations."""
    tables = find_settings()
    if OPERATORS.search(text):
        text = OPERATORS.sub(lambda match: f"{match[1]}{operator_table()}\n{match[2]}", text)
    return TABLE.sub(lambda match: f"{match[1]}{markdown_table(tables[match[2]])}\n{match[3]}", text)


def markdown_table(settings_type: type[Settings]) -> str:
    """Return the settings as a Markdown table for the docs, with a column that says when they count if some do not always."""
    descriptions = describe(settings_type)
    has_conditions = any(item.condition for item in descriptions)
    rows = []
    for item in descriptions:
        flags = [", ".join(f"`{flag}`" for flag in item.flags)] if settings_type.has_flags else []
        conditions = [item.condition] if has_conditions else []
        in_panel = "" if item.panel_label == item.label else f" (in the panel: *{item.panel_label}*)"
        rows.append([item.label + in_panel, *flags, item.format(item.default), _format_range(item), *conditions, item.help])
    titles = ["Setting", *["Flag"] * settings_type.has_flags, "Default", "Range", *["Used if"] * has_conditions, "Description"]
    return "\n".join([f"| {' | '.join(titles)} |", "|---" * len(titles) + "|", *(f"| {' | '.join(row)} |" for row in rows)])


def _format_range(description: Description) -> str:
    if description.choices:
        return ", ".join(f"`{value}` ({choice.label})" for value, choice in description.choices.items())
    if description.minimum is None or description.type is bool:
        return ""
    minimum = description.format(description.minimum)
    return f"{minimum} or more" if description.maximum is None else f"{minimum} to {description.format(description.maximum)}"


def main() -> None:
    for page in sorted(FOLDER.glob("*.md")):
        page.write_text(update_tables(page.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    main()
