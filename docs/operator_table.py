"""The table of operators in `python-api.md`: their labels in the F3 search, and their buttons, found in the code of the panels."""

import ast
import re
from collections.abc import Iterator

import bpy

from lib import environment

PREFIX = "farfield."
IS_LABEL = re.compile(r"[a-z]")  # Names of icons, the other texts of buttons, are in upper case.


def find_operators() -> dict[str, type[bpy.types.Operator]]:
    """Return the operators of the extension by identifier, without internal ones; import `addon.registration` before."""
    classes = (item for item in bpy.types.Operator.__subclasses__() if getattr(item, "bl_idname", "").startswith(PREFIX))
    return {item.bl_idname: item for item in classes if "INTERNAL" not in getattr(item, "bl_options", ())}


def operator_table() -> str:
    """Return a Markdown table with a row per operator, in the order of the tools, and those of all tools at the end."""
    from farfield.addon.operators.documentation import TOOLS

    operators, buttons = find_operators(), find_buttons()

    def order(identifier: str) -> tuple[int, str]:
        tool = re.match(r"farfield\.([a-z]+)", identifier)[1]
        return (TOOLS.index(tool) if tool in TOOLS else len(TOOLS)), identifier

    rows = ["| Operator | Label | Button |", "|---|---|---|"]
    for identifier in sorted(operators, key=order):
        label = operators[identifier].bl_label
        texts = ", ".join(text or f"{label} (icon)" for text in buttons.get(identifier, []))
        rows.append(f"| `bpy.ops.{identifier}` | {label} | {texts or 'none'} |")
    return "\n".join(rows)


def find_buttons() -> dict[str, list[str]]:
    """Return the texts of the buttons in all panels by the identifier of their operator, an empty text for an icon."""
    operators = find_operators()
    identifiers = {item.__name__: identifier for identifier, item in operators.items()}
    found: dict[str, list[str]] = {}
    for path in sorted((environment.ROOT / "addon" / "panels").glob("*.py")):
        for reference, text in _find_pairs(ast.parse(path.read_text(encoding="utf-8"))):
            pattern = re.escape(identifiers.get(reference, reference)).replace(r"\*", r"\w+")
            for identifier in filter(re.compile(pattern).fullmatch, operators):
                texts = found.setdefault(identifier, [])
                texts += [each for each in (text or [operators[identifier].bl_label]) if each not in texts]
    return found


def _find_pairs(tree: ast.Module) -> Iterator[tuple[str, list[str]]]:
    """Yield the class or the identifier, with `*` for parts that vary, of the operator of each button, and the texts that it may have."""
    assigned = {}  # texts by the name of a variable
    for node in ast.walk(tree):
        if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Tuple):
            assigned |= {target.id: _labels(node.value) for target in node.targets[0].elts if isinstance(target, ast.Name)}
    for node in ast.walk(tree):
        arguments = node.args if isinstance(node, ast.Call) else node.elts if isinstance(node, ast.Tuple) else []
        for index, argument in enumerate(arguments):
            reference = _operator_of(argument)
            if reference is None:
                continue
            texts = [keyword.value for keyword in getattr(node, "keywords", ()) if keyword.arg == "text"]
            texts = texts or arguments[index + 1 : index + 2]
            if texts or ast.unparse(getattr(node, "func", node)).endswith(".operator"):
                yield reference, [label for text in texts for label in assigned.get(getattr(text, "id", ""), _labels(text))]


def _operator_of(node: ast.expr) -> str | None:
    """Return the class or the identifier of the operator that an argument names, None if it names none."""
    if isinstance(node, ast.JoinedStr):
        text = "".join(part.value if isinstance(part, ast.Constant) else "*" for part in node.values)
        return text if text.startswith(PREFIX) else None
    match = re.fullmatch(r"(?:\w+\.)?(FARFIELD_OT_\w+)(?:\.bl_idname)?", ast.unparse(node))
    return match[1] if match else None


def _labels(node: ast.expr) -> list[str]:
    """Return the texts in an expression that may be those of a button."""
    if isinstance(node, ast.JoinedStr):
        return ["".join(part.value if isinstance(part, ast.Constant) else f"*{ast.unparse(part.value)}*" for part in node.values)]
    texts = [item.value for item in ast.walk(node) if isinstance(item, ast.Constant) and isinstance(item.value, str)]
    return [text for text in texts if not text or IS_LABEL.search(text)]
