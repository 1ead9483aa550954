"""Update the tables of settings in the docs from their declarations in the core: `python3 docs/tables.py`.

A table is between a line `<!-- settings: NAME -->` and a line `<!-- end of settings -->`; see `find_settings` for the names.
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

from farfield.addon.core.settings import Settings, markdown_table

TABLE = re.compile(r"(<!-- settings: (\w+) -->\n).*?(<!-- end of settings -->)", re.DOTALL)


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
    """Return the page `text` with every table of settings replaced by the current declarations."""
    tables = find_settings()
    return TABLE.sub(lambda match: f"{match[1]}{markdown_table(tables[match[2]])}\n{match[3]}", text)


def main() -> None:
    for page in sorted(FOLDER.glob("*.md")):
        page.write_text(update_tables(page.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    main()
