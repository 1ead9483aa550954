"""A hook of MkDocs that adds to the site what is outside of `docs`: README.md as start page, and a script to search without a server."""

from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page
from mkdocs.utils import get_relative_url

ROOT = Path(__file__).resolve().parents[2]
PAGES = {"README.md": "index.md", "CHANGELOG.md": "changelog.md", "CONTRIBUTING.md": "contributing.md"}
WORKER_SOURCE = Path(__file__).with_name("site_worker.js")
WORKER = "assets/site_worker.js"
THEMES_WORKER = "https://unpkg.com/iframe-worker/shim"  # which the theme would load from the internet


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages, with their links as seen from `docs`, and the script. The license is no page."""
    for name, page in PAGES.items():
        text = (ROOT / name).read_text(encoding="utf-8").replace("](docs/", "](").replace("[LICENSE](LICENSE)", "LICENSE")
        for other, other_page in PAGES.items():
            text = text.replace(f"]({other})", f"]({other_page})")
        files.append(File.generated(config, page, content=text))
    files.append(File.generated(config, WORKER, content=WORKER_SOURCE.read_text(encoding="utf-8")))
    return files


def on_post_page(output: str, page: Page, config: MkDocsConfig) -> str:  # noqa: ARG001 - MkDocs passes it.
    """Let a page load the script from the site."""
    return output.replace(THEMES_WORKER, get_relative_url(WORKER, page.url))


def on_post_template(output: str, template_name: str, config: MkDocsConfig) -> str:  # noqa: ARG001 - MkDocs passes them.
    """Let the page for missing pages load it, too."""
    return output.replace(THEMES_WORKER, WORKER)
