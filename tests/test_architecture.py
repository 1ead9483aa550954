"""The rules of the architecture hold: layers, tools, file lengths, names."""

import ast
import pkgutil
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

from lib import environment

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
TOOLS = {"billboards", "btf", "unwrap", "photos", "restore", "texmesh", "bdam", "clipbox"}
TOOLS_MAY_IMPORT = {"photos": {"restore", "unwrap"}, "btf": {"billboards"}}
LAST_NETS = {  # may catch Exception
    *("addon/operators/error_reports.py", "addon/operators/long_work.py", "scripts/lib/command_line.py"),
    *("addon/operators/follow_handlers.py", "addon/operators/view_following.py"),
}
SHARED_PACKAGES = {"core": {"geometry", "imaging", "files", "jobs"}, "bridge": {"geometry", "imaging", "overlays", "rendering", "shading"}}
# Not standard terms of the field; see CONTRIBUTING.md, Words.
RETIRED_IN_IDENTIFIERS = set(
    "anew apart aslant bend bends carved centre centred centres colour coloured colours dearness fewest glow grey hue hues lamp lamps "  # noqa: SIM905
    "mended middle middles neighbour neighbours openness relief rests rim rims share shares shines sight sighting sightings slope slopes "
    "standing stood strewn tint tints told whole".split()
)
RETIRED_IN_TEXT = re.compile(r"\b(afar|anew|aslant|besides|lamps?|mended|polygonis\w+|storeys?|strewn|strew|upon)\b", re.IGNORECASE)
NOT_OURS = {".git", ".venv", ".hypothesis", ".pytest_cache", ".ruff_cache", "__pycache__"}  # wherever they are
GENERATED = {"build", "dist", "out"}  # at the top; a folder of sources may have such a name
REGISTRY_HOST = re.compile(r"\b(?:pypi|pythonhosted|anaconda|npmjs)\.(?:org|com)\b")
MACHINE_PATH = re.compile(r"(?<![\w.~/])/(?:home|root|Users|tmp|work)/\w")


def our_files() -> list[Path]:
    """Every text file of the project."""
    files = []
    for path in sorted(ROOT.rglob("*")):
        parts = path.relative_to(ROOT).parts
        is_ours = not NOT_OURS & set(parts) and parts[0] not in GENERATED
        if path.is_file() and is_ours and path.suffix not in {".png", ".jpg", ".webp", ".blend"}:
            files.append(path)
    return files


def modules() -> list[Path]:
    return sorted(ADDON.rglob("*.py"))


def module_parts(path: Path) -> tuple[str, ...]:
    """`addon/core/btf/bake.py` is ("core", "btf", "bake"); a package is its folder."""
    parts = path.relative_to(ADDON).with_suffix("").parts
    return parts[:-1] if parts[-1] == "__init__" else parts


def imported_within_addon(path: Path) -> set[tuple[str, ...]]:
    """Parts of every module below `addon/` that `path` imports, wherever in the file."""
    package = path.relative_to(ADDON).parts[:-1]
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.level:
            assert node.level - 1 <= len(package), f"{path} imports from above the addon"
            base = package[: len(package) - node.level + 1] + tuple((node.module or "").split(".") if node.module else ())
            found |= {(*base, alias.name) for alias in node.names}
    return found


def imported_from_outside(path: Path) -> set[str]:
    """First names of every absolute import in `path`."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and not node.level:
            found.add(node.module.split(".")[0])
    return found


def tool_of(parts: tuple[str, ...]) -> str | None:
    """The tool that a module of any layer belongs to, None for a shared module."""
    return parts[1] if len(parts) > 1 and parts[1] in TOOLS else None


def built_tools() -> list[str]:
    """The tools that exist."""
    return sorted({path.parent.name for path in ADDON.glob("core/*/__init__.py")} - SHARED_PACKAGES["core"])


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


@pytest.mark.parametrize("path", modules(), ids=lambda path: path.relative_to(ROOT).as_posix())
class TestModule:
    """Each file of the extension."""

    def test_imports_run_downwards(self, path):
        parts = module_parts(path)
        if not parts:
            assert not imported_within_addon(path)
            return
        for target in imported_within_addon(path):
            assert target[0] in MAY_IMPORT[parts[0]], f"{parts[0]} imports {'.'.join(target)}"

    def test_tools_do_not_import_each_other(self, path):
        parts = module_parts(path)
        if parts[:1] == ("registration",):
            return  # it lists the operators and panels of all tools
        tool = tool_of(parts)
        allowed = {None, tool} | TOOLS_MAY_IMPORT.get(tool, set())
        for target in imported_within_addon(path):
            assert tool_of(target) in allowed, f"{tool or 'a shared module'} imports {'.'.join(target)}"

    def test_outside_imports_are_allowed_here(self, path):
        outside = imported_from_outside(path)
        assert not outside & {"addon", "farfield", "pickle", "cPickle", "dill", "marshal", "shelve"}
        if module_parts(path)[:1] == ("core",):
            assert not outside & BLENDER_MODULES

    def test_has_less_than_400_lines(self, path):
        assert len(path.read_text(encoding="utf-8").splitlines()) < 400

    def test_says_what_it_is_for(self, path):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        public = [node for node in tree.body if isinstance(node, ast.FunctionDef | ast.ClassDef) and not node.name.startswith("_")]
        silent = [node.name for node in public if not ast.get_docstring(node) and node.name not in {"register", "unregister"}]
        assert not silent, f"without a docstring: {', '.join(silent)}"
        if module_parts(path):
            assert ast.get_docstring(tree) or not tree.body, "the file has no docstring"

    def test_asks_for_no_version_outside_compat(self, path):
        if module_parts(path) != ("compat",):
            assert "app.version" not in path.read_text(encoding="utf-8")

    def test_passes_no_blind_keywords_and_swallows_nothing(self, path):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.FunctionDef):
                assert node.args.kwarg is None, f"{node.name} takes **{node.args.kwarg.arg}"
            if isinstance(node, ast.ExceptHandler) and path.relative_to(ROOT).as_posix() not in LAST_NETS:
                assert node.type is not None and ast.unparse(node.type) not in {"Exception", "BaseException"}, f"line {node.lineno}"


def test_operators_report_their_errors():
    unguarded = []
    for path in sorted((ADDON / "operators").rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            is_entry = isinstance(node, ast.FunctionDef) and node.name in {"execute", "invoke", "modal"}
            if is_entry and "reports_errors" not in {ast.unparse(decorator) for decorator in node.decorator_list}:
                unguarded.append(f"{path.name}:{node.lineno} {node.name}")
    assert not unguarded, "an error would open a box full of Python"


def test_scripts_swallow_nothing():
    violations = []
    for path in sorted((ROOT / "scripts").rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ExceptHandler) and (node.type is None or ast.unparse(node.type) in {"Exception", "BaseException"}):
                violations.append(path.relative_to(ROOT).as_posix())
    assert set(violations) <= LAST_NETS and len(violations) == 1, violations


@pytest.mark.parametrize("tool", built_tools())
def test_a_tool_has_its_identifier_in_every_layer(tool):
    assert tool in TOOLS, f"core/{tool} is neither a tool nor one of the shared packages"
    layers = [f"addon/bridge/{tool}", f"addon/operators/{tool}", f"addon/panels/{tool}.py"]
    beside = [f"scripts/{tool}.py", f"tests/{tool}", f"benchmarks/bench_{tool}.py", f"docs/{tool}.md"]
    assert [path for path in layers + beside if not (ROOT / path).exists()] == []


def test_layers_hold_shared_modules_and_tools_only():
    for layer in ("core", "bridge", "operators", "panels"):
        packages = {path.parent.name for path in ADDON.glob(f"{layer}/*/__init__.py")}
        assert packages <= TOOLS | SHARED_PACKAGES.get(layer, set())


def identifiers(path: Path) -> Iterator[tuple[int, str]]:
    """Line and name of every definition, assignment and parameter in `path`."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node.lineno, node.id
        elif isinstance(node, ast.arg):
            yield node.lineno, node.arg
        elif isinstance(node, ast.FunctionDef | ast.ClassDef):
            yield node.lineno, node.name
        elif isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store):
            yield node.lineno, node.attr


def words_of(name: str) -> list[str]:
    """The words that an identifier is made of, in lower case: `maxPixelSize` and `MAX_PIXEL_SIZE` have three."""
    return [word.lower() for word in re.split(r"_+|(?<=[a-z])(?=[A-Z])", name) if word]


def test_words_of_an_identifier():
    assert words_of("MAX_PIXEL_SIZE") == words_of("maxPixelSize") == ["max", "pixel", "size"]


@pytest.mark.parametrize("path", [path for path in our_files() if path.suffix == ".py"], ids=lambda path: path.relative_to(ROOT).as_posix())
def test_identifiers_are_standard_terms(path):
    violations = [f"line {line}: {name}" for line, name in identifiers(path) if RETIRED_IN_IDENTIFIERS & set(words_of(name))]
    assert not violations, "\n".join(violations)


def test_text_is_modern_english():
    violations = []
    for path in our_files():
        if path.suffix not in {".py", ".md", ".toml"} or path == Path(__file__):
            continue
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
            if RETIRED_IN_TEXT.search(line):
                violations.append(f"{path.relative_to(ROOT)}:{number}: {line.strip()[:100]}")
    assert not violations, "\n".join(violations)


def test_no_text_names_a_registry_or_a_place_on_one_machine():
    violations = []
    for path in our_files():
        for number, line in enumerate(path.read_text(encoding="utf-8", errors="replace").splitlines(), 1):
            if REGISTRY_HOST.search(line) or MACHINE_PATH.search(line):
                violations.append(f"{path.relative_to(ROOT)}:{number}: {line.strip()[:100]}")
    assert not violations, "\n".join(violations)


def test_the_patterns_match():
    assert REGISTRY_HOST.search("from https://files." + "pythonhosted" + ".org/packages")
    assert MACHINE_PATH.search('open("/' + 'home/someone/scene.blend")')
    assert not MACHINE_PATH.search("https://example.invalid/home/page and docs/tmp/plan")


def test_versions_agree():
    manifest = tomllib.loads((ROOT / "blender_manifest.toml").read_text(encoding="utf-8"))
    changes = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    newest = re.search(r"^## \[?(\d+\.\d+\.\d+)", changes, re.MULTILINE)
    assert newest and newest[1] == manifest["version"]


def test_manifest_is_what_the_readme_promises():
    manifest = tomllib.loads((ROOT / "blender_manifest.toml").read_text(encoding="utf-8"))
    assert (manifest["id"], manifest["blender_version_min"], manifest["blender_version_max"]) == ("farfield", "4.5.0", "5.3.0")
    assert "wheels" not in manifest, "a checkout holds no wheels; the zip's manifest lists them"
