"""The text files of the project, and what rules ask about the Python among them."""

import ast
import os
import re
from collections import defaultdict
from collections.abc import Iterator
from functools import cache, cached_property
from pathlib import Path

from lib import environment

ROOT = environment.ROOT
ADDON = ROOT / "addon"
CACHES = {".git", ".venv", ".hypothesis", ".pytest_cache", ".ruff_cache", "__pycache__"}
OUTPUT_FOLDERS = {ROOT / "build", ROOT / "dist", ROOT / "out"}


LEAVES = {ast.Constant, ast.Name, ast.alias}  # Half of all nodes: they contain no other nodes but the contexts of names.


def parse_file(path: Path) -> ast.Module:
    """The syntax tree of the Python file `path`. Keep few of them: the garbage collector visits all their nodes again and again."""
    return ast.parse(path.read_text(encoding="utf-8"))


def walk(tree: ast.AST) -> list[ast.AST]:
    """All nodes of a tree but the contexts of names, breadth first; `ast.walk` takes much longer."""
    nodes = [tree]
    for node in nodes:
        if type(node) in LEAVES:
            continue
        for field in node._fields:
            value = getattr(node, field, None)
            if isinstance(value, list):
                nodes += [item for item in value if isinstance(item, ast.AST)]
            elif isinstance(value, ast.AST) and field != "ctx":
                nodes.append(value)
    return nodes


class SourceFile:
    """A text file of the project, parsed if it is Python."""

    def __init__(self, path: Path, text: str) -> None:
        self.path, self.name = path, path.relative_to(ROOT).as_posix()
        self.is_python, self.is_of_addon = path.suffix == ".py", path.is_relative_to(ADDON)
        self.text, self.lines = text, text.splitlines()

    @property
    def parts(self) -> tuple[str, ...]:
        """`addon/core/btf/bake.py` is ("core", "btf", "bake"); a package is its folder."""
        parts = self.path.relative_to(ADDON).with_suffix("").parts
        return parts[:-1] if parts[-1] == "__init__" else parts

    @cached_property
    def tree(self) -> ast.Module:
        return ast.parse(self.text)

    @cached_property
    def nodes(self) -> dict[type[ast.AST], list[ast.AST]]:
        """All nodes, by their class."""
        nodes: defaultdict[type[ast.AST], list[ast.AST]] = defaultdict(list)
        for node in walk(self.tree):
            nodes[type(node)].append(node)
        return nodes

    def all(self, *types: type[ast.AST]) -> list[ast.AST]:
        """The nodes of these classes."""
        return [node for each in types for node in self.nodes.get(each, ())]

    @cached_property
    def imports(self) -> set[tuple[str, ...]]:
        """Parts of every module below `addon/` that this one imports, wherever in the file."""
        package = self.path.relative_to(ADDON).parts[:-1]
        found = set()
        for node in self.all(ast.ImportFrom):
            if node.level:
                assert node.level - 1 <= len(package), f"{self.name} imports from above the addon"
                base = package[: len(package) - node.level + 1] + tuple((node.module or "").split(".") if node.module else ())
                found |= {(*base, alias.name) for alias in node.names}
        return found

    def outside_imports(self) -> set[str]:
        """First names of every absolute import."""
        names = {alias.name for node in self.all(ast.Import) for alias in node.names}
        names |= {node.module for node in self.all(ast.ImportFrom) if not node.level}
        return {name.split(".")[0] for name in names}

    def matching_lines(self, *wrong: re.Pattern) -> Iterator[str]:
        """Number and text of each line that one of the patterns is in; most patterns are nowhere in the file, which is found out first."""
        wrong = [pattern for pattern in wrong if pattern.search(self.text)]
        for number, line in enumerate(self.lines if wrong else (), 1):
            if any(pattern.search(line) for pattern in wrong):
                yield f"{number}: {line.strip()[:100]}"


@cache
def our_paths() -> list[Path]:
    """Every text file of the project."""
    paths = []
    for folder, folders, names in os.walk(ROOT):
        folders[:] = [name for name in folders if name not in CACHES and Path(folder, name) not in OUTPUT_FOLDERS]
        paths += [Path(folder, name) for name in names]
    return sorted(path for path in paths if path.suffix not in {".png", ".jpg", ".webp", ".gif", ".blend"})


def identifiers(file: SourceFile) -> Iterator[tuple[int, str]]:
    """Line and name of every definition, assignment and parameter."""
    yield from ((node.lineno, node.id) for node in file.all(ast.Name) if isinstance(node.ctx, ast.Store))
    yield from ((node.lineno, node.attr) for node in file.all(ast.Attribute) if isinstance(node.ctx, ast.Store))
    yield from ((node.lineno, node.arg) for node in file.all(ast.arg))
    yield from ((node.lineno, node.name) for node in file.all(ast.FunctionDef, ast.ClassDef))


@cache
def words_of(name: str) -> list[str]:
    """The words that an identifier is made of, in lower case: `maxPixelSize` and `MAX_PIXEL_SIZE` have three."""
    return [word.lower() for word in re.split(r"_+|(?<=[a-z])(?=[A-Z])", name) if word]


def fields_of(node: ast.ClassDef) -> list[str]:
    """The public fields of a data class or a named tuple. None of settings, whose help texts describe them, and of the numbers of a method,
    which all have a value and a comment where they need one."""
    items = [item for item in node.body if isinstance(item, ast.AnnAssign) and isinstance(item.target, ast.Name)]
    bases = [ast.unparse(base) for base in node.bases]
    is_data = any("dataclass" in ast.unparse(item) for item in node.decorator_list) or "NamedTuple" in bases
    are_numbers = all(isinstance(item.value, ast.Constant | ast.BinOp | ast.UnaryOp | ast.Tuple) for item in items)
    describes_itself = are_numbers or any(base.endswith("Settings") for base in bases)
    return [item.target.id for item in items if not item.target.id.startswith("_")] if is_data and not describes_itself else []
