"""Write src/api/schema.ts: the types of the API's requests and answers in TypeScript, from its OpenAPI document.

Use      python webviewer/scripts/make_api_types.py            (tests/api/test_types.py fails where the file is stale)
What that document leaves open or out is typed by hand in src/api/types.ts; the same test holds those types against
real answers.
"""

import json
import tempfile
from pathlib import Path
from typing import Any

TARGET = Path(__file__).parents[1] / "src" / "api" / "schema.ts"
SKIPPED = ("HTTPValidationError", "ValidationError")


def document() -> dict[str, Any]:
    """Return the OpenAPI document of the app."""
    from farfield_api.app import make_app
    from farfield_api.settings import ApiSettings

    with tempfile.TemporaryDirectory() as folder:
        settings = ApiSettings(
            database_url=f"sqlite:///{folder}/none.sqlite", broker_url="redis+socket:///none",
            artifacts=Path(folder) / "artifacts", secret="00", web=Path(folder),
        )  # fmt: skip
        return make_app(settings).openapi()


def typescript(openapi: dict[str, Any]) -> str:
    """Return one interface a schema, names sorted, and the list of routes."""
    parts = ["/** Made by scripts/make_api_types.py from the API's OpenAPI document. Do not edit. */"]
    for name, schema in sorted(openapi["components"]["schemas"].items()):
        if name in SKIPPED or name.startswith("Body_"):
            continue
        if "properties" not in schema:
            parts.append(f"export type {name} = {_type(schema)};")
            continue
        lines = [f"export interface {name} {{"]
        required = set(schema.get("required", ()))
        for key, value in schema["properties"].items():
            if text := value.get("description"):
                lines.append(f"  /** {text} */")
            lines.append(f"  {key}{'' if key in required else '?'}: {_type(value)};")
        parts.append("\n".join([*lines, "}"]))
    routes = [
        f'  | "{method.upper()} {path}"'
        for path, methods in sorted(openapi["paths"].items())
        for method in sorted(methods)
        if method in ("get", "post", "put", "patch", "delete", "head")
    ]
    parts.append("/** Every route; the client names no other. */\nexport type Route =\n" + "\n".join(routes) + ";")
    return "\n\n".join(parts) + "\n"


def _type(schema: dict[str, Any]) -> str:
    if "$ref" in schema:
        return str(schema["$ref"]).rsplit("/", 1)[-1]
    if "const" in schema:
        return json.dumps(schema["const"])
    if "enum" in schema:
        return " | ".join(json.dumps(v) for v in schema["enum"])
    if "anyOf" in schema:
        return " | ".join(_type(s) for s in schema["anyOf"])
    kind = schema.get("type")
    if kind == "array":
        if "prefixItems" in schema:
            return "[" + ", ".join(_type(s) for s in schema["prefixItems"]) + "]"
        item = _type(schema.get("items", {}))
        return f"({item})[]" if " " in item else f"{item}[]"
    known = {"integer": "number", "number": "number", "string": "string", "boolean": "boolean", "null": "null",
             "object": "Record<string, unknown>"}  # fmt: skip
    return known.get(str(kind), "unknown")


if __name__ == "__main__":
    TARGET.write_text(typescript(document()), encoding="utf-8")
