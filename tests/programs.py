"""Programs that some tests need and that no environment of Farfield has: where they are, and how to install them."""

import os
import re
import shutil
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

import reference_tools
from lib import environment

TESTS = environment.ROOT / "tests"
CHROMIUM_VARIABLE = "FARFIELD_CHROMIUM"
CHROMIUM_NAMES = ("chromium", "chromium-browser", "google-chrome", "chrome", "chromium-headless-shell", "headless_shell")
INSTALLERS = {  # the command of a package manager, and its names of Chromium and Node
    "apt-get": ("sudo apt-get install", "chromium", "nodejs"),
    "dnf": ("sudo dnf install", "chromium", "nodejs"),
    "brew": ("brew install", "chromium", "node"),
    "winget": ("winget install", "Hibbiki.Chromium", "OpenJS.NodeJS"),
}


class Program(NamedTuple):
    """A program that tests need.

    Attributes:
        name: as users know it.
        find: returns its path, None where it is missing.
        users: a pattern in the text of test files that are skipped without it, in whole or in part.
        package: its position in the values of INSTALLERS, None if `command` installs it.
        command: installs it, or says how to.
    """

    name: str
    find: Callable[[], str | Path | None]
    users: str
    package: int | None
    command: str

    def installation(self) -> str:
        """Return the one command that installs the program."""
        names = next((names for manager, names in INSTALLERS.items() if shutil.which(manager)), None)
        return self.command if self.package is None or names is None else f"{names[0]} {names[self.package]}"


def find_chromium() -> str | None:
    """Return Chromium or a browser that is made from it, None if there is none."""
    return os.environ.get(CHROMIUM_VARIABLE) or next(filter(None, map(shutil.which, CHROMIUM_NAMES)), None)


def find_node() -> str | None:
    """Return Node, None if there is none."""
    return shutil.which("node")


def find_mkdocs() -> Path | None:
    """Return the Python that has MkDocs, None if there is none."""
    return reference_tools.find_python(reference_tools.DOCS_TOOLS)


PROGRAMS = (
    Program("Chromium", find_chromium, r"find_chromium", 1, f"install Chromium, or set {CHROMIUM_VARIABLE} to its program"),
    Program("Node", find_node, r'find_node|which\("node"\)', 2, "install Node.js"),
    Program("the reference tools", reference_tools.find_python, r"reference.tools|mean_flip", None, "python3 scripts/reference_tools.py"),
    Program("MkDocs", find_mkdocs, r"find_mkdocs", None, "python3 scripts/build_docs.py"),
)


def describe_missing(paths: Iterable[Path], programs: Iterable[Program] = PROGRAMS) -> Iterator[str]:
    """Yield a line for each program that is missing although tests in one of these files and folders need it."""
    missing = [program for program in programs if program.find() is None]
    files = {file for path in paths for file in (path.rglob("test_*.py") if path.is_dir() else [path])} if missing else set()
    texts = {file: file.read_text(encoding="utf-8") for file in sorted(files) if file.is_file()}
    for program in missing:
        users = [file.relative_to(environment.ROOT).as_posix() for file, text in texts.items() if re.search(rf"\b({program.users})", text)]
        if users:
            yield f"WILL BE SKIPPED without {program.name}: tests in {', '.join(users)}. To run them: {program.installation()}"
