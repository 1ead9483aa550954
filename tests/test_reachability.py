"""What the extension and the scripts do not reach does not stand in `addon`: it belongs to tests or benchmarks.

Modules are reached by imports, by names of worker modules such as "addon.core.jobs.task_worker", and by names of start scripts such as
"worker_start.py". Functions and classes are used where code that is used has their name, or where a tool exports them.
"""

import ast
import re
from functools import cache
from pathlib import Path

import pytest

from lib import environment
from source_files import parse_file, walk

pytestmark = pytest.mark.once
ROOT = environment.ROOT
SCRIPTS = ROOT / "scripts"
WORKER_MODULE = re.compile(r"\baddon(?:\.\w+)+")
START_SCRIPT = re.compile(r"\w+\.py")
CALLED_BY_BLENDER = {"register", "unregister"}
UNUSED_ON_PURPOSE = {"eevee_engine": "`compat` alone asks for Blender's version, for tests and benchmarks, too."}


@cache  # the same modules are imported a thousand times
def module_file(parts: tuple[str, ...]) -> Path | None:
    """The file of a module of the checkout or of `scripts`; None if `parts` name none."""
    for folder in (ROOT, SCRIPTS):
        for path in (folder.joinpath(*parts).with_suffix(".py"), folder.joinpath(*parts, "__init__.py")):
            if path.is_file():
                return path
    return None


def named_files(path: Path) -> set[Path]:
    """The files of the checkout that `path` imports or names."""
    package, found = path.relative_to(ROOT).parts[:-1], set()
    for node in walk(parse_file(path)):
        names = []
        if isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else ()
            base += tuple((node.module or "").split(".")) if node.module else ()
            names = [(*base, alias.name) for alias in node.names]
        elif isinstance(node, ast.Import):
            names = [tuple(alias.name.split(".")) for alias in node.names]
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            names = [tuple(name.split(".")) for name in WORKER_MODULE.findall(node.value)]
            if START_SCRIPT.fullmatch(node.value):
                found.add(path.with_name(node.value))
        for parts in names:
            inside = parts[1:] if parts[:1] == ("farfield",) else parts
            found |= {module_file(inside[:count]) for count in range(1, len(inside) + 1)}
    return {file for file in found if file is not None and file.is_file()}


@cache
def reached_files() -> set[Path]:
    """The files that the extension and the scripts need."""
    reached, waiting = set(), [ROOT / "__init__.py", *SCRIPTS.glob("*.py")]
    while waiting:
        path = waiting.pop()
        if path not in reached:
            reached.add(path)
            waiting += named_files(path)
    return reached


def names_in(node: ast.AST) -> set[str]:
    """The names that code uses, those in quoted annotations and behind `as` included; an import alone uses nothing."""
    names = set()
    for inner in walk(node):
        if isinstance(inner, ast.Name):
            names.add(inner.id)
        elif isinstance(inner, ast.Attribute):
            names.add(inner.attr)
        elif isinstance(inner, ast.alias) and inner.asname:
            names.add(inner.name)
        elif isinstance(inner, ast.Constant) and isinstance(inner.value, str) and inner.value.isidentifier():
            names.add(inner.value)
    return names


def unused_definitions() -> list[str]:
    """The functions and classes of the extension that no code which runs uses, directly or by others that are used."""
    definitions, waiting = [], set(CALLED_BY_BLENDER | set(UNUSED_ON_PURPOSE))
    for path in [*(ROOT / "addon").rglob("*.py"), *SCRIPTS.rglob("*.py")]:
        for node in parse_file(path).body:
            if SCRIPTS not in path.parents and isinstance(node, ast.FunctionDef | ast.ClassDef):
                definitions.append((f"{path.relative_to(ROOT).as_posix()}:{node.lineno}", node))
            else:
                waiting |= names_in(node)
    used: set[str] = set()
    while waiting:
        used |= waiting
        waiting = {name for _, node in definitions if node.name in waiting for name in names_in(node)} - used
    return sorted(f"{place} {node.name}" for place, node in definitions if node.name not in used)


def test_every_module_of_the_extension_is_reached():
    modules = {path for path in (ROOT / "addon").rglob("*.py") if path.stat().st_size}
    unreached = sorted(path.relative_to(ROOT).as_posix() for path in modules - reached_files())
    assert not unreached, "neither the extension nor a script needs\n" + "\n".join(unreached)


@pytest.mark.slow
def test_every_function_and_class_of_the_extension_is_used():
    unused = unused_definitions()
    assert not unused, "neither the extension nor a script uses\n" + "\n".join(unused)


def test_no_exception_is_out_of_date():
    source = "\n".join(path.read_text(encoding="utf-8") for path in (ROOT / "addon").rglob("*.py"))
    for name in UNUSED_ON_PURPOSE:
        assert re.search(rf"^(?:def|class) {name}\b", source, re.MULTILINE), name


def test_reaching_follows_imports_workers_and_start_scripts():
    reached = {path.relative_to(ROOT).as_posix() for path in reached_files()}
    assert {
        "addon/registration.py",
        "addon/core/jobs/task_worker.py",
        "addon/bridge/worker_start.py",
        "scripts/lib/environment.py",
    } <= reached
    assert not any(name.startswith(("tests/", "benchmarks/")) for name in reached)
