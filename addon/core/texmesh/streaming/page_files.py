"""The page that shows a package: three files that any static web server sends beside it, made of the modules in the folder page."""

import re
from pathlib import Path

PAGE_FOLDER = Path(__file__).resolve().parent / "page"
INDEX, STYLE, SCRIPT = "index.html", "style.css", "main.js"
COMMENT = re.compile(r"^[ \t]*(?://[^\n]*|/\*\*.*?\*/)\n|[ \t]+// [^\n]*", re.MULTILINE | re.DOTALL)
IMPORT = re.compile(r'^import \{ ([^}]+) \} from "\./(\w+)\.js";$', re.MULTILINE)
EXPORT = re.compile(r"^export ((?:async )?(?:function\*?|class|const) (\w+))", re.MULTILINE)


def read_page() -> dict[str, bytes]:
    """Return the files of the page by name. Modules are joined to one, so that a browser waits for fewer responses; comments (` // ` begins
    one anywhere), indentation and empty lines are left out."""
    index = re.sub(r'<link rel="modulepreload"[^\n]*\n', "", (PAGE_FOLDER / INDEX).read_text("utf-8"))
    script = COMMENT.sub("", join_modules({path.stem: path.read_text("utf-8") for path in sorted(PAGE_FOLDER.glob("*.js"))}))
    texts = {INDEX: index, STYLE: (PAGE_FOLDER / STYLE).read_text("utf-8"), SCRIPT: script}
    return {name: "".join(f"{line.strip()}\n" for line in text.splitlines() if line.strip()).encode() for name, text in texts.items()}


def join_modules(modules: dict[str, str]) -> str:
    """Return one JavaScript module that does what the module "main" does. Each of `modules`, by name, becomes a function that is called
    once, after those that it imports, and returns what the module exports."""
    parts: list[str] = []
    joined: set[str] = set()

    def add(name: str) -> None:
        joined.add(name)
        text = modules[name]
        for _, other in IMPORT.findall(text):
            if other not in joined:
                add(other)
        exported = ", ".join(found for _, found in EXPORT.findall(text))
        body = EXPORT.sub(r"\1", IMPORT.sub(r"const { \1 } = $\2;", text))
        parts.append(f"const ${name} = (() => {{\n{body}\nreturn {{ {exported} }};\n}})();\n")

    add(Path(SCRIPT).stem)
    return "".join(parts)
