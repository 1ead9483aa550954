"""Build the docs as a static site: `python3 scripts/build_docs.py [--out build/site]`; open its index.html.

The generator is MkDocs with the theme Material, which the first run installs in an environment of its own. The site loads nothing from
elsewhere and needs no server. A link that leads nowhere is an error.
"""

import argparse
import os
import subprocess
import sys
from pathlib import Path

from lib.environment import ROOT
from reference_tools import DOCS_TOOLS, find_python, install


def main() -> int:
    parser = argparse.ArgumentParser(description="Build the docs as a static site.")
    parser.add_argument("--out", type=Path, default=ROOT / "build" / "site", help="folder of the site (default: build/site)")
    out = parser.parse_args().out.absolute()
    if out.exists() and any(out.iterdir()) and not (out / "sitemap.xml").exists():
        print(f'"{out}" contains other files than a site; choose another folder with --out.', file=sys.stderr)
        return 2
    if find_python(DOCS_TOOLS) is None:
        install(DOCS_TOOLS)
    command = [str(find_python(DOCS_TOOLS)), "-m", "mkdocs", "build", "--strict", "--quiet", "--config-file", str(ROOT / "mkdocs.yml")]
    quiet = os.environ | {"NO_MKDOCS_2_WARNING": "1"}  # The theme advertises its successor.
    code = subprocess.run([*command, "--site-dir", str(out)], env=quiet, check=False).returncode
    if code == 0:
        print(out / "index.html")
    return code


if __name__ == "__main__":
    sys.exit(main())
