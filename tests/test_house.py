"""The walls of the house stand: what may import what, how long a room is, and that everything bears its tool's name."""

import ast
import pkgutil
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import environment

ROOT = environment.ROOT
ADDON = ROOT / "addon"
BLENDER_MODULES = {"aud", "bl_math", "blf", "bmesh", "bpy", "bpy_extras", "gpu", "gpu_extras", "imbuf", "mathutils"}
MAY_IMPORT = {  # storeys, from the ground up
    "core": {"core"},
    "compat": set(),
    "bridge": {"bridge", "compat", "core"},
    "preferences": {"compat", "core"},
    "operators": {"operators", "preferences", "bridge", "compat", "core"},
    "panels": {"panels", "operators", "preferences", "bridge", "compat", "core"},
    "registration": {"panels", "operators", "preferences", "bridge", "compat", "core"},
}
TOOLS = {"billboards", "btf", "unwrap", "photos", "restore", "texmesh", "bdam", "clipbox"}
TOOLS_MAY_IMPORT = {"photos": {"restore"}, "btf": {"billboards"}}
NOT_OURS = {".git", ".venv", ".hypothesis", ".pytest_cache", ".ruff_cache", "__pycache__", "build", "dist", "out"}
REGISTRY_HOST = re.compile(r"\b(?:pypi|pythonhosted|anaconda|npmjs)\.(?:org|com)\b")
MACHINE_PATH = re.compile(r"(?<![\w.~/])/(?:home|root|Users|tmp|work)/\w")


def our_files() -> list[Path]:
    """Every text file of the project."""
    files = []
    for path in sorted(ROOT.rglob("*")):
        if path.is_file() and not NOT_OURS & set(path.relative_to(ROOT).parts) and path.suffix not in {".png", ".jpg", ".webp", ".blend"}:
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
    return parts[1] if len(parts) > 1 and parts[0] == "core" and parts[1] in TOOLS else None


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
            raise ImportError(name + " is out of bounds for the ground floor")

sys.meta_path.insert(0, NoBlender())
import environment
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

    def test_tools_leave_each_other_alone(self, path):
        tool = tool_of(module_parts(path))
        allowed = {None, tool} | TOOLS_MAY_IMPORT.get(tool, set())
        if module_parts(path)[:1] == ("core",):
            for target in imported_within_addon(path):
                assert tool_of(target) in allowed, f"{tool or 'a shared part'} imports {'.'.join(target)}"

    def test_outside_imports_are_allowed_here(self, path):
        outside = imported_from_outside(path)
        assert not outside & {"addon", "farfield", "pickle", "cPickle", "dill", "marshal", "shelve"}
        if module_parts(path)[:1] == ("core",):
            assert not outside & BLENDER_MODULES

    def test_is_a_room_not_a_hall(self, path):
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
            if isinstance(node, ast.ExceptHandler):
                assert node.type is not None and ast.unparse(node.type) not in {"Exception", "BaseException"}, f"line {node.lineno}"


@pytest.mark.parametrize("tool", sorted(path.parent.name for path in ADDON.glob("core/*/__init__.py")))
def test_a_tool_has_its_name_in_every_storey(tool):
    assert tool in TOOLS, f"core/{tool} is no tool of this house; shared parts are files, not packages"
    places = [f"addon/operators/{tool}.py", f"addon/panels/{tool}.py", f"scripts/{tool}.py", f"tests/{tool}", f"docs/{tool}.md"]
    assert [place for place in places if not (ROOT / place).exists()] == []


def test_no_text_names_a_registry_or_a_place_on_one_machine():
    offences = []
    for path in our_files():
        for number, line in enumerate(path.read_text(encoding="utf-8", errors="replace").splitlines(), 1):
            if REGISTRY_HOST.search(line) or MACHINE_PATH.search(line):
                offences.append(f"{path.relative_to(ROOT)}:{number}: {line.strip()[:100]}")
    assert not offences, "\n".join(offences)


def test_the_walls_see_what_they_should():
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
