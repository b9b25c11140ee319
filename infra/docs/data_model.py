"""Writes docs/data-model.md from the dataclasses of the stages: a table in the docs, a dataclass in the code, one text.

python infra/docs/data_model.py          write the page
python infra/docs/data_model.py --check  exit 1 when the page is not what the code says
"""

import ast
import re
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "services" / "farfield"
PAGE = ROOT / "docs" / "data-model.md"
MODELS = (
    ("scene", "scene/model.py"), ("hierarchy", "hierarchy/model.py"), ("detail", "detail/model.py"),
    ("rendertime", "rendertime/model.py"), ("view-space tree", "geometry/cells.py"), ("visibility", "visibility/model.py"),
    ("viewspace", "viewspace/model.py"),
    ("candidates", "candidates/model.py"), ("placement, repair", "placement/model.py"), ("bake", "bake/model.py"),
)  # fmt: skip
HEAD = """# Data model

What each stage hands to the next: frozen dataclasses of numpy columns, stored as one file each in the container of
[`farfield/columns.py`](../services/farfield/columns.py). Ids are integers, null is -1, ranges are half-open, lists of
variable length are CSR (entries of row i are `[row[i], row[i+1])`). Lengths are metres relative to the scene's
`origin_m` unless a line says otherwise. What the viewer reads is described in
[formats/placementdb.md](formats/placementdb.md).

This page is written by `python infra/docs/data_model.py` from the code.
"""


def tables(name: str, path: str) -> str:
    """Return the section of one module: its dataclasses' docstrings and columns."""
    source = (PACKAGE / path).read_text(encoding="utf-8")
    lines = source.splitlines()
    out = [f"\n## {name}\n"]
    for node in ast.parse(source).body:
        if not isinstance(node, ast.ClassDef) or not any(isinstance(s, ast.AnnAssign) for s in node.body):
            continue
        doc = "\n".join(line.strip() for line in (ast.get_docstring(node) or "").splitlines())
        out.append(f"[`{node.name}`](../services/farfield/{path}) {doc}\n")
        out.append("| column | type and shape | meaning |\n|---|---|---|")
        pending = ""
        for i in range(node.lineno, node.end_lineno or 0):
            line = lines[i].strip()
            field = re.match(r"(\w+): ([^#=]+?)(?: = [^#]+)?(?:  # (.*))?$", line)
            if not field:
                pending = line.removeprefix("# ") if line.startswith("# ") else ""
                continue
            comment = field[3] or ""
            shape = re.match(r"(\([^)]*\) *(?:[a-z]\d+)?(?:, or \(0,\)[^ ]*)?) *(.*)", comment)
            kind, meaning = (shape[1].strip(), shape[2]) if shape else (f"`{field[2].strip()}`", comment)
            kind = re.sub(r" +", " ", kind)
            out.append(f"| `{field[1]}` | {kind} | {(meaning or pending).replace('|', chr(92) + '|')} |")
            pending = ""
    return "\n".join(out) + "\n"


def page() -> str:
    """Return the whole page."""
    return HEAD + "".join(tables(name, path) for name, path in MODELS)


if __name__ == "__main__":
    if "--check" in sys.argv:
        sys.exit(PAGE.read_text(encoding="utf-8") != page())
    PAGE.write_text(page(), encoding="utf-8")
