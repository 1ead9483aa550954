"""Promises of docs/security.md that are about all of the source, and that each of the others has a test."""

import ast
import re
from collections.abc import Iterator

import pytest

from lib import environment
from source_files import parse_file, walk

pytestmark = pytest.mark.once
ADDON = environment.ROOT / "addon"
NETWORK = {
    "socket", "ssl", "http", "ftplib", "requests", "aiohttp", "httpx", "urllib", "urllib3", "webbrowser", "xmlrpc", "smtplib", "telnetlib",
}  # fmt: skip
CLUSTERS = {"dask", "distributed"}
UNSAFE = {"pickle", "marshal", "shelve", "dill", "cloudpickle", "joblib"}
MAYBE_UNSAFE = re.compile(rf"\b(?:{'|'.join([*sorted(UNSAFE), 'eval', 'exec', 'load'])})\b")


def imported_modules(nodes: list[ast.AST]) -> Iterator[str]:
    """The full names of what a file imports, wherever it does."""
    for node in nodes:
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            yield node.module


@pytest.mark.slow
def test_the_extension_uses_the_network_only_to_show_packages_on_this_machine():
    found = {(path.name, name) for path in ADDON.rglob("*.py") for name in imported_modules(walk(parse_file(path)))}
    used = {entry for entry in found if entry[1].partition(".")[0] in NETWORK | CLUSTERS}
    assert used == {("local_server.py", "http.server"), ("viewing.py", "webbrowser")}


def test_the_extension_changes_neither_the_modules_nor_the_search_path_of_blender():
    """Worker processes have their own."""
    changes = re.compile(r"sys\.(?:path|meta_path|path_hooks)\b|sys\.modules(?:\[[^\]]*\] = |\.(?:update|setdefault)\()")
    found = {path.name for path in ADDON.rglob("*.py") if changes.search(path.read_text(encoding="utf-8"))}
    assert found == {"worker_start.py", "core_worker_start.py"}


def name_of(function: ast.expr) -> str:
    """`load` or `np.load`; "" for what has no such name. It takes a fraction of the time of ast.unparse."""
    if isinstance(function, ast.Attribute) and isinstance(function.value, ast.Name):
        return f"{function.value.id}.{function.attr}"
    return function.id if isinstance(function, ast.Name) else ""


def test_nothing_reads_pickles_or_evaluates_text():
    paths = [*ADDON.rglob("*.py"), *(environment.ROOT / "scripts").rglob("*.py")]
    suspects = [path for path in paths if MAYBE_UNSAFE.search(path.read_text(encoding="utf-8"))]  # None of the others has such a name.
    assert 10 < len(suspects) < len(paths)
    for path in suspects:
        nodes = walk(parse_file(path))
        assert not {name.partition(".")[0] for name in imported_modules(nodes)} & UNSAFE, path
        for node in nodes:
            if not isinstance(node, ast.Call):
                continue
            name = name_of(node.func)
            assert name not in ("eval", "exec"), path
            if name in ("np.load", "numpy.load"):
                assert any(word.arg == "allow_pickle" and ast.unparse(word.value) == "False" for word in node.keywords), path


def test_every_promise_names_tests_that_exist():
    text = (environment.ROOT / "docs" / "results" / "reliability.md").read_text(encoding="utf-8")
    rows = text.partition("## Promises")[2].partition("\n## ")[0].split("|---|---|\n")[1].strip().splitlines()
    assert len(rows) >= 20
    for row in rows:
        named = re.findall(r"`(tests/[\w/]+\.py)(?:::(\w+))?`|`(benchmarks/\w+\.py)`", row)
        assert named, row
        for path, function, campaign in named:
            content = (environment.ROOT / (path or campaign)).read_text(encoding="utf-8")
            assert not function or re.search(rf"^\s*def {function}\(", content, re.MULTILINE), row
