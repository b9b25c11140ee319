"""An experiment's document as files: report.json, a CSV a table, an SVG a plot, and one page that needs nothing else."""

import csv
import io
import json
import os
from collections.abc import Iterator, Mapping
from html import escape
from pathlib import Path
from typing import Any

from farfield.errors import SettingsInvalid
from farfield.experiment import svg

_STYLE = """
:root{--ground:#fff;--text:#1b1f24;--quiet:#5d6670;--line:#dfe3e8;--mark:#fff5cf}
@media (prefers-color-scheme:dark){:root{--ground:#14181d;--text:#e6e9ed;--quiet:#9aa4af;--line:#333a42;--mark:#3d3512}}
@media print{:root{--ground:#fff;--text:#000;--quiet:#333;--line:#bbb;--mark:#eee}section{break-inside:avoid}}
body{font:15px/1.5 system-ui,sans-serif;background:var(--ground);color:var(--text);max-width:1080px;margin:2rem auto;
padding:0 1rem}h1{font-size:1.6rem}h2{font-size:1.2rem;margin-top:2.5rem}table{border-collapse:collapse;font-size:13px;
font-variant-numeric:tabular-nums}.wide{overflow-x:auto}th,td{text-align:right;padding:.25rem .6rem;border-bottom:1px solid
var(--line);vertical-align:top}th:first-child,td:first-child,td.words{text-align:left}tr.current{background:var(--mark)}
.quiet,dl{color:var(--quiet)}dl{display:grid;grid-template-columns:max-content 1fr;gap:.1rem 1rem}dd{margin:0;
overflow-wrap:anywhere}code{font:12.5px ui-monospace,monospace}pre{overflow-x:auto}
"""


def write(document: Mapping[str, Any], out: Path) -> list[Path]:
    """Write all files into folder `out` and return them, report.json first. Raises SettingsInvalid, naming --out."""
    written = []
    try:
        out.mkdir(parents=True, exist_ok=True)
        for name, text in contents(document):
            part = out / f"{name}.{os.getpid()}.part"
            part.write_text(text, encoding="utf-8")
            part.replace(out / name)
            written.append(out / name)
    except OSError as error:
        raise SettingsInvalid("--out", f"cannot be written to: {error}") from error
    return written


def contents(document: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Yield (file name, text) of every file."""
    yield "report.json", json.dumps(document, indent=1, sort_keys=True, allow_nan=False) + "\n"
    yield "index.html", page(document)
    for section in document["sections"]:
        if section["rows"]:
            yield f"{section['key']}.csv", table(section)
        for plot in section["plots"]:
            yield f"{plot['key']}.svg", svg.draw(plot, alone=True) + "\n"


def table(section: Mapping[str, Any]) -> str:
    """Return a section's table as CSV with a head, figures in full."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    keys = [column["key"] for column in section["columns"]]
    writer.writerow(keys)
    for row in section["rows"]:
        writer.writerow(["" if row.get(key) is None else row[key] for key in keys])
    return out.getvalue()


def shown(value: Any, digits: int | None) -> str:
    """Return a table's value as it is shown; nothing: an en dash."""
    if value is None:
        return "–"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int):
        return f"{value:,}"
    if isinstance(value, float):
        return svg.number(value) if digits is None else f"{value:,.{digits}f}"
    return str(value)


def page(document: Mapping[str, Any]) -> str:
    """Return the page: one HTML file without scripts or anything from elsewhere, light, dark and for paper."""
    parts = [
        f"<h1>{escape(document['title'])}</h1>", _facts(document), *(f"<p>{escape(n)}</p>" for n in document["notes"]),
        *(_section(section) for section in document["sections"]),
        "<h2>Settings</h2><pre><code>", escape(json.dumps(document["settings"], indent=1)), "</code></pre>",
    ]  # fmt: skip
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width">'
        f"<title>{escape(document['title'])}: {escape(document['scene']['name'])}</title>"
        f"<style>{_STYLE}{svg.STYLE}</style></head><body>{''.join(parts)}</body></html>\n"
    )


def _facts(document: Mapping[str, Any]) -> str:
    machine, scene = document["machine"], document["scene"]
    counts = ", ".join(
        f"{svg.number(v)} {k.replace('_', ' ')}" for k, v in scene.items() if isinstance(v, (int, float))
    )
    rows = {
        "scene": f"{scene['name']} ({counts})" if counts else scene["name"], "SHA-256": scene["sha256"],
        "command": document["command"], "machine": f"{machine['processor']}, {machine['cores']} cores, {machine['system']}",
        "software": ", ".join(f"{k} {v}" for k, v in document["software"].items()),
        "took": f"{document['seconds']:,.0f} s",
    }  # fmt: skip
    return "<dl>" + "".join(f"<dt>{k}</dt><dd>{escape(str(v))}</dd>" for k, v in rows.items()) + "</dl>"


def _section(section: Mapping[str, Any]) -> str:
    out = [
        f'<section id="{escape(section["key"])}"><h2>{escape(section["title"])}</h2><p>{escape(section["text"])}</p>'
    ]
    out.append(f'<p class="quiet">Truth: {escape(section["truth"])} Samples: {escape(section["samples"])}</p>')
    if section["missing"] is not None:
        out.append(f"<p><strong>Not measured:</strong> {escape(section['missing'])}</p>")
    out += [svg.draw(plot) for plot in section["plots"]]
    if section["rows"]:
        out.append('<div class="wide"><table><thead><tr>')
        out += [f"<th>{escape(column['label'])}</th>" for column in section["columns"]]
        out.append("</tr></thead><tbody>")
        for row in section["rows"]:
            out.append('<tr class="current">' if row.get("mark") == "current" else "<tr>")
            for column in section["columns"]:
                value = row.get(column["key"])
                words = ' class="words"' if isinstance(value, str) else ""
                out.append(f"<td{words}>{escape(shown(value, column['digits']))}</td>")
            out.append("</tr>")
        out.append("</tbody></table></div>")
    return "".join([*out, "</section>"])
