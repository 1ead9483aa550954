"""The tables of settings in the docs: `python3 docs/tables.py` writes them anew from the declarations in the core.

A table stands between a line `<!-- settings: TOOL -->` and a line `<!-- end of settings -->`.
"""

import re
import sys
from pathlib import Path

FOLDER = Path(__file__).resolve().parent
sys.path.insert(0, str(FOLDER.parent / "scripts"))

import environment

environment.ensure()
environment.import_farfield()

from farfield.addon.core.billboards.settings import BillboardSettings
from farfield.addon.core.btf.settings import BtfSettings
from farfield.addon.core.clipbox.settings import ClipboxSettings
from farfield.addon.core.settings import markdown_table
from farfield.addon.core.unwrap.settings import UnwrapSettings

SETTINGS = {"billboards": BillboardSettings, "btf": BtfSettings, "unwrap": UnwrapSettings, "clipbox": ClipboxSettings}
TABLE = re.compile(r"(<!-- settings: (\w+) -->\n).*?(<!-- end of settings -->)", re.DOTALL)


def with_tables(text: str) -> str:
    """The page `text` with every table of settings as the core declares it."""
    return TABLE.sub(lambda found: f"{found[1]}{markdown_table(SETTINGS[found[2]])}\n{found[3]}", text)


def main() -> None:
    for page in sorted(FOLDER.glob("*.md")):
        page.write_text(with_tables(page.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    main()
