"""The rules of the architecture hold: layers, tools, file lengths, names.

A function decorated with `rule` names the places in one file that violate the rule; `test_rule` lists those of all files, which are read
and parsed once. Other tests concern the checkout altogether.
"""

import ast
import pkgutil
import re
import subprocess
import sys
import tomllib
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path

import pytest

from lib import environment
from source_files import SourceFile, fields_of, identifiers, our_paths, words_of

pytestmark = pytest.mark.once
ROOT = environment.ROOT
ADDON = ROOT / "addon"
BLENDER_MODULES = {"aud", "bl_math", "blf", "bmesh", "bpy", "bpy_extras", "gpu", "gpu_extras", "imbuf", "mathutils"}
MAY_IMPORT = {  # the layers, lowest first
    "core": {"core"},
    "compat": set(),
    "bridge": {"bridge", "compat", "core"},
    "operators": {"operators", "bridge", "compat", "core"},
    "panels": {"panels", "operators", "bridge", "compat", "core"},
    "registration": {"panels", "operators", "bridge", "compat", "core"},
}
TOOLS = {"billboards", "btf", "unwrap", "photos", "restore", "texmesh", "packages", "bdam", "clipbox", "distance"}
TOOLS_MAY_IMPORT = {
    "photos": {"restore", "unwrap"},
    "btf": {"billboards"},
    "packages": {"texmesh"},
    "texmesh": {"billboards"},
    "billboards": {"texmesh"},
    "distance": {"billboards", "texmesh"},
}
LAST_NETS = {  # may catch Exception
    *("addon/operators/error_reports.py", "addon/operators/long_work.py", "scripts/lib/command_line.py"),
    *("addon/operators/follow_handlers.py", "addon/operators/view_following.py", "addon/operators/clipbox/live_update.py"),
}
SHARED_PACKAGES = {
    "core": {"geometry", "heights", "imaging", "files", "jobs"},
    "bridge": {"geometry", "imaging", "overlays", "rendering", "shading"},
}
# Not standard terms of the field; see CONTRIBUTING.md, Words.
RETIRED_IN_IDENTIFIERS = set(
    "anew apart aslant bend bends carved centre centred centres colour coloured colours dearness fewest glow grey hear hears hue "  # noqa: SIM905
    "hues lamp lamps mended middle middles neighbour neighbours openness owe owes relief rests rim rims share shares shines sight sighting "
    "sightings slope slopes standing stood strewn tint tints told whole".split()
)
RETIRED_IN_TEXT = re.compile(r"\b(afar|anew|aslant|besides?|lamps?|mended|polygonis\w+|storeys?|strewn|strew|upon)\b", re.IGNORECASE)
REGISTRY_HOST = re.compile(r"\b(?:pypi|pythonhosted|anaconda|npmjs)\.(?:org|com)\b")
MACHINE_PATH = re.compile(r"(?<![\w.~/])/(?:home|root|Users|tmp|work)/\w")
VERSION_QUESTION = re.compile(r"app\.version")
FRAGMENT = re.compile(r"(?:^|\s)#\s*of\b")  # a comment that begins with "of" is no sentence
MIN_LISTED_FIELDS = 5

Rule = Callable[["SourceFile"], Iterator[str]]
RULES: dict[str, Rule] = {}


def tool_of(parts: tuple[str, ...]) -> str | None:
    """The tool that a module of any layer belongs to, None for a shared module."""
    return parts[1] if len(parts) > 1 and parts[1] in TOOLS else None


@cache
def violations() -> dict[str, list[str]]:
    """The places that violate each rule."""
    found = {name: [] for name in RULES}
    for path in our_paths():
        file = SourceFile(path, path.read_text(encoding="utf-8", errors="replace"))
        for name, check in RULES.items():
            found[name] += [f"{file.name}:{place}" for place in check(file)]
    return found


def rule(check: Rule) -> Rule:
    RULES[check.__name__] = check
    return check


def addon_rule(check: Rule) -> Rule:
    """A rule of the modules of the extension."""
    RULES[check.__name__] = lambda file: check(file) if file.is_of_addon and file.is_python else ()
    return check


@addon_rule
def imports_run_downwards(file: SourceFile) -> Iterator[str]:
    allowed = MAY_IMPORT[file.parts[0]] if file.parts else set()
    return (f" imports {'.'.join(target)}" for target in file.imports if target[0] not in allowed)


@addon_rule
def tools_do_not_import_each_other(file: SourceFile) -> Iterator[str]:
    tool = tool_of(file.parts)
    allowed = {None, tool} | TOOLS_MAY_IMPORT.get(tool, set())
    if file.parts[:1] != ("registration",):  # it lists the operators and panels of all tools
        yield from (f" imports {'.'.join(target)}" for target in file.imports if tool_of(target) not in allowed)


@addon_rule
def outside_imports_are_allowed(file: SourceFile) -> Iterator[str]:
    forbidden = {"addon", "farfield", "pickle", "cPickle", "dill", "marshal", "shelve"}
    if file.parts[:1] == ("core",):
        forbidden |= BLENDER_MODULES
    return (f" imports {name}" for name in file.outside_imports() & forbidden)


@addon_rule
def files_have_less_than_400_lines(file: SourceFile) -> Iterator[str]:
    if len(file.lines) >= 400:
        yield f" {len(file.lines)} lines"


@addon_rule
def files_classes_and_functions_have_docstrings(file: SourceFile) -> Iterator[str]:
    for node in file.tree.body:
        is_public = isinstance(node, ast.FunctionDef | ast.ClassDef) and not node.name.startswith("_")
        if is_public and not ast.get_docstring(node) and node.name not in {"register", "unregister"}:
            yield f"{node.lineno}: {node.name}"
    if file.parts and file.tree.body and not ast.get_docstring(file.tree):
        yield "1: the file"


@addon_rule
def only_compat_asks_for_the_version(file: SourceFile) -> Iterator[str]:
    return file.matching_lines(VERSION_QUESTION) if file.parts != ("compat",) else iter(())


@addon_rule
def functions_take_no_blind_keywords(file: SourceFile) -> Iterator[str]:
    return (f"{node.lineno}: **{node.args.kwarg.arg}" for node in file.all(ast.FunctionDef) if node.args.kwarg)


@rule
def only_the_last_nets_catch_everything(file: SourceFile) -> Iterator[str]:
    """Those of the extension, and one in the scripts."""
    if file.is_python and (file.is_of_addon or file.name.startswith("scripts/")):
        handlers = file.all(ast.ExceptHandler)
        lines = [node.lineno for node in handlers if node.type is None or ast.unparse(node.type) in {"Exception", "BaseException"}]
        allowed = 0 if file.name not in LAST_NETS else len(lines) if file.is_of_addon else 1
        yield from (f"{line}: catches everything" for line in lines[allowed:])


@addon_rule
def operators_report_their_errors(file: SourceFile) -> Iterator[str]:
    """Otherwise an error would open a box full of Python."""
    for node in file.all(ast.FunctionDef) if file.parts[:1] == ("operators",) else ():
        is_entry = node.name in {"execute", "invoke", "modal"}
        if is_entry and "reports_errors" not in {ast.unparse(decorator) for decorator in node.decorator_list}:
            yield f"{node.lineno}: {node.name}"


@rule
def identifiers_are_standard_terms(file: SourceFile) -> Iterator[str]:
    if file.is_python:
        return (f"{line}: {name}" for line, name in identifiers(file) if not RETIRED_IN_IDENTIFIERS.isdisjoint(words_of(name)))
    return iter(())


@rule
def text_is_modern_english(file: SourceFile) -> Iterator[str]:
    if file.path.suffix in {".py", ".md", ".toml"} and file.path != Path(__file__):
        return file.matching_lines(RETIRED_IN_TEXT)
    return iter(())


@rule
def comments_are_sentences(file: SourceFile) -> Iterator[str]:
    return file.matching_lines(FRAGMENT) if file.is_python else iter(())


@addon_rule
def classes_list_their_fields(file: SourceFile) -> Iterator[str]:
    for node in file.all(ast.ClassDef):
        fields = fields_of(node)
        if len(fields) >= MIN_LISTED_FIELDS:
            text = ast.get_docstring(node) or ""
            missing = [name for name in fields if not re.search(rf"^\s*(\w+, )*{name}(, \w+)*:", text, re.MULTILINE)]
            if missing:
                yield f"{node.lineno}: the docstring of {node.name} has no line for {', '.join(missing)}"


@rule
def no_text_names_a_registry_or_a_place_on_one_machine(file: SourceFile) -> Iterator[str]:
    return file.matching_lines(REGISTRY_HOST, MACHINE_PATH)


@pytest.mark.parametrize("name", RULES)
def test_rule(name):
    places = violations()[name]
    if places:
        pytest.fail(f"{len(places)} places\n" + "\n".join(places), pytrace=False)


def test_all_files_are_checked():
    names = {path.relative_to(ROOT).as_posix() for path in our_paths()}
    assert {"README.md", "pyproject.toml", ".ci/run", "addon/core/btf/settings.py", "scripts/lib/environment.py"} | LAST_NETS <= names


EXAMPLES = {  # a file, a line that may stand in it, and one that violates the rule
    "imports_run_downwards": ("addon/core/a.py", "from . import b", "from ..bridge import b"),
    "tools_do_not_import_each_other": ("addon/core/btf/a.py", "from ..billboards import b", "from ..unwrap import b"),
    "outside_imports_are_allowed": ("addon/core/a.py", "import numpy", "import bpy"),
    "files_have_less_than_400_lines": ("addon/core/a.py", "", 400 * "a\n"),
    "files_classes_and_functions_have_docstrings": ("addon/core/a.py", '"""Text."""\ndef _f(): pass', '"""Text."""\ndef f(): pass'),
    "only_compat_asks_for_the_version": ("addon/bridge/a.py", "", "bpy.app.version"),
    "functions_take_no_blind_keywords": ("addon/core/a.py", "def f(*, a): pass", "def f(**a): pass"),
    "only_the_last_nets_catch_everything": ("scripts/a.py", "try: a\nexcept OSError: b", "try: a\nexcept Exception: b"),
    "operators_report_their_errors": ("addon/operators/a.py", "@reports_errors\ndef modal(self): pass", "def modal(self): pass"),
    "identifiers_are_standard_terms": ("tests/a.py", "maxSize = MAX_SIZE = 1", "maxGlowSize = 1"),
    "text_is_modern_english": ("docs/a.md", "Updated.", "Made anew."),
    "comments_are_sentences": ("docs/a.py", "a = 3  # Offsets of vertices.", "a = 3  #" + " of the vertices"),
    "classes_list_their_fields": (
        *("addon/core/a.py", '@dataclass\nclass A:\n """A.\n\n a, b, c: 1.\n d: 2.\n e: 3.\n """\n a: X\n b: X\n c: X\n d: X\n e: X'),
        '@dataclass\nclass A:\n """A of a, b, c, d and e."""\n a: X\n b: X\n c: X\n d: X\n e: X',
    ),
    "no_text_names_a_registry_or_a_place_on_one_machine": (
        "docs/a.md",
        "https://example.invalid/home/page",
        "see /" + "home/me/scene.blend",
    ),
}


@pytest.mark.parametrize("name", RULES)
def test_rule_tells_right_from_wrong(name):
    path, right, wrong = EXAMPLES[name]
    found = [list(RULES[name](SourceFile(ROOT / path, text))) for text in (right, wrong)]
    assert [bool(places) for places in found] == [False, True]


def test_words_of_an_identifier():
    assert words_of("MAX_PIXEL_SIZE") == words_of("maxPixelSize") == ["max", "pixel", "size"]


def test_hosts_of_registries_are_found():
    assert REGISTRY_HOST.search("from https://files." + "pythonhosted" + ".org/packages")


def core_module_names() -> list[str]:
    return [module.name for module in pkgutil.walk_packages([str(ADDON / "core")], "core.")]


def test_core_imports_where_there_is_no_blender():
    names = [f"farfield.addon.{name}" for name in ("core", *core_module_names())]
    code = f"""
import importlib, sys
sys.path.insert(0, {str(ROOT / "scripts")!r})

class NoBlender:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in {BLENDER_MODULES!r}:
            raise ImportError(name + " must not be imported by core")

sys.meta_path.insert(0, NoBlender())
from lib import environment
environment.import_farfield()
for name in {names!r}:
    importlib.import_module(name)
"""
    outcome = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert outcome.returncode == 0, outcome.stderr


def test_a_tool_has_its_identifier_in_every_layer():
    assert {path.parent.name for path in ADDON.glob("core/*/__init__.py")} == TOOLS | SHARED_PACKAGES["core"]
    places = [
        "addon/bridge/{}",
        "addon/operators/{}",
        "addon/panels/{}.py",
        "scripts/{}.py",
        "tests/{}",
        "benchmarks/bench_{}.py",
        "docs/{}.md",
    ]
    paths = [place.format(tool) for tool in sorted(TOOLS) for place in places]
    assert [path for path in paths if not (ROOT / path).exists()] == []


def test_layers_hold_shared_modules_and_tools_only():
    for layer in ("core", "bridge", "operators", "panels"):
        packages = {path.parent.name for path in ADDON.glob(f"{layer}/*/__init__.py")}
        assert packages <= TOOLS | SHARED_PACKAGES.get(layer, set())


def test_versions_agree():
    manifest = tomllib.loads((ROOT / "blender_manifest.toml").read_text(encoding="utf-8"))
    changes = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    newest = re.search(r"^## \[?(\d+\.\d+\.\d+)", changes, re.MULTILINE)
    assert newest and newest[1] == manifest["version"]


def test_manifest_is_what_the_readme_promises():
    manifest = tomllib.loads((ROOT / "blender_manifest.toml").read_text(encoding="utf-8"))
    assert (manifest["id"], manifest["blender_version_min"]) == ("farfield", "4.5.0")
    assert "blender_version_max" not in manifest, "no version is known to fail"
    assert "wheels" not in manifest, "a checkout holds no wheels; the zip's manifest lists them"
