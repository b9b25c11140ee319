"""Makes what docs/evidence.md shows, and writes its tables and plots into the page.

python infra/docs/evidence.py run NAME       compare on one of PLACES, into out/evidence/NAME (minutes)
python infra/docs/evidence.py run stability  the long form, into out/evidence/stability.json
python infra/docs/evidence.py page           write what out/evidence holds into the page; what it does not hold stays as it is

Scenes are those of the development scenes (FARFIELD_SCENES, or ../shared/scenes); Rainier's heightfield becomes a mesh of
64 objects here. What stages made is kept in out/evidence/NAME/cache: a run that was stopped goes on.
"""

import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).parents[2]
OUT = ROOT / "out" / "evidence"
PAGE, PICTURES = ROOT / "docs" / "evidence.md", ROOT / "docs" / "pictures" / "evidence"
SCENES = Path(os.environ.get("FARFIELD_SCENES", ROOT.parent / "shared" / "scenes"))
FARFIELD = str(Path(sys.executable).with_name("farfield"))


@dataclass(frozen=True, slots=True, kw_only=True)
class Scene:
    """A scene of the page. `settings` is its TOML; `make` writes scene and settings where there is no file of the scene."""

    title: str
    file: str = ""
    settings: str = ""
    make: Callable[[Path, Path], None] | None = None
    flags: tuple[str, ...] = ()  # of the command


def _space(low: list[float], high: list[float], cell_m: float, *more: str, visibility: str = "off") -> str:
    return "\n".join(
        [f'visibility.mode = "{visibility}"', *more, "[view_space]", f"cell_m = {cell_m}", f"boxes = [[{low}, {high}]]"]
    )


def _city(scene: Path, settings: Path) -> None:
    sys.path.insert(0, str(ROOT / "infra" / "demo"))
    import san_francisco

    san_francisco.build(scene, settings)


def _town(scene: Path, settings: Path) -> None:
    sys.path.insert(0, str(ROOT / "tests"))
    from farfield.scene.write import write_glb
    from towns import town

    scene.write_bytes(write_glb(town(60, view_m=24)))
    low, high = [-12.0, 1.0, -12.0], [12.0, 3.0, 12.0]
    lines = ['budget = "24 calls"', "camera.width = 320", "camera.height = 180", "placement.far_m = 25.0"]
    settings.write_text("\n".join([*lines, _space(low, high, 12.0, visibility="sampled")]), encoding="utf-8")


def _rainier(scene: Path, settings: Path) -> None:
    """Write 257 x 257 heights around the summit as 8 x 8 tiles, and settings for a flight above them."""
    import trimesh
    from PIL import Image

    full = np.array(Image.open(SCENES / "dem-mt-rainier-srtm3" / "mt_rainier_90m.tif"))
    row, column = (max(0, int(k) - 128) for k in np.unravel_index(int(full.argmax()), full.shape))
    height = full[row : row + 257, column : column + 257].astype(np.float64)
    height[height < 0] = np.median(height[height >= 0])  # voids
    x, z = np.meshgrid(np.arange(257) * 63.5, np.arange(257) * 92.6)  # 3 arc seconds at 46.9 degrees north
    corner = np.stack([x, height, z], -1)
    a = (np.arange(32)[:, None] * 33 + np.arange(32)).reshape(-1)
    faces = np.concatenate([np.stack([a, a + 33, a + 1], 1), np.stack([a + 1, a + 33, a + 34], 1)])
    tiles = trimesh.Scene()
    for i in range(8):
        for j in range(8):
            part = corner[32 * i : 32 * i + 33, 32 * j : 32 * j + 33].reshape(-1, 3)
            tiles.add_geometry(trimesh.Trimesh(part, faces, process=False), node_name=f"tile {i} {j}")
    scene.write_bytes(tiles.export(file_type="glb"))
    low, high = [7000.0, 4500.0, 11000.0], [9000.0, 4700.0, 13000.0]
    settings.write_text(
        'budget = "60000 triangles"\n' + _space(low, high, 500.0, 'detail.mode = "off"'), encoding="utf-8"
    )


CALLS = 'budget = "{} calls"\n'
PLACES = {
    "san-francisco": Scene(title="San Francisco, the demo city", make=_city, flags=("--boxes", "4")),
    # a square that opens to the street net: no triangle above 3 m within 41 m of its middle, sight to 107 m
    "munich": Scene(title="Munich", file="munich-osm/scene.glb",
                    settings=CALLS.format(400) + _space([0, 1.5, -108], [32, 1.8, -76], 16)),
    "bim": Scene(title="An apartment building, every part apart (BIM)", file="schependomlaan-bim/scene.glb",
                 settings=CALLS.format(900) + _space([24, 2.0, -14], [30, 2.3, -8], 3)),
    "game-world": Scene(title="A game world", file="folio2025-world/scene.glb",
                        settings=CALLS.format(250) + _space([-8, 3, -8], [8, 4, 8], 8)),
    "town": Scene(title="A made-up town of 60 houses, to see that all rows work", make=_town,
                  flags=("--frames", "12", "--passes", "2", "--pictures", "3")),
    "rainier": Scene(title="Mount Rainier's heightfield as a mesh", make=_rainier),
}  # fmt: skip


def run(name: str, more: list[str]) -> int:
    """Make one scene's figures, or the stability table."""
    OUT.mkdir(parents=True, exist_ok=True)
    if name == "stability":
        with (OUT / "stability.json").open("w", encoding="utf-8") as file:
            return subprocess.run([FARFIELD, "stability", "--json", *more], stdout=file, check=False).returncode
    place, folder = PLACES[name], OUT / name
    folder.mkdir(exist_ok=True)
    scene, settings = folder / f"{name}.glb", folder / f"{name}.toml"
    if place.make is not None and not (scene.exists() and settings.exists()):
        place.make(scene, settings)
    elif place.make is None:
        settings.write_text(place.settings + "\n", encoding="utf-8")
        scene = SCENES / place.file
    words = [FARFIELD, "experiment", "compare", str(scene), "--settings", str(settings), "--out", str(folder), *more]
    return subprocess.run([*words, *place.flags], check=False).returncode


def page() -> int:
    """Renew the blocks of the page for which there are figures."""
    text = PAGE.read_text(encoding="utf-8")
    found = OUT / "stability.json"
    if found.exists():
        text = _put(text, "stability", stability(json.loads(found.read_text(encoding="utf-8"))))
    for name, place in PLACES.items():
        report = OUT / name / "report.json"
        if report.exists():
            text = _put(text, name, scene_block(name, place, json.loads(report.read_text(encoding="utf-8"))))
    PAGE.write_text(text, encoding="utf-8")
    return 0


def _put(text: str, name: str, block: str) -> str:
    start, end = f"<!-- {name} -->", f"<!-- end of {name} -->"
    if start not in text:
        raise SystemExit(f"{PAGE.name} has no block {start}")
    head, rest = text.split(start, 1)
    return f"{head}{start}\n\n{block.strip()}\n\n{end}{rest.split(end, 1)[1]}"


def scene_block(name: str, place: Scene, document: dict[str, Any]) -> str:
    """Return what the page says of one scene; copies its plots."""
    (section,) = document["sections"]
    machine, scene = document["machine"], document["scene"]
    PICTURES.mkdir(parents=True, exist_ok=True)
    pictures = []
    for plot in section["plots"]:
        shutil.copy(OUT / name / f"{plot['key']}.svg", PICTURES / f"{name}-{plot['key']}.svg")
        pictures.append(f"![{plot['title']}](pictures/evidence/{name}-{plot['key']}.svg)")
    facts = (
        f"{scene['objects']:,} objects, {scene['triangles']:,} triangles, {scene['cells']} cells; budget "
        f"{document['settings']['budget']}; {section['samples']}. {machine['processor']}, {machine['cores']} cores, "
        f"{machine['system']}; {'; '.join(document['notes'])}; farfield {document['software']['farfield']}."
    )
    lines = [
        place.title,
        "",
        f"    python infra/docs/evidence.py run {name}",
        "",
        facts,
        "",
        table(section),
        "",
        section["text"],
        "",
        *pictures,
    ]
    return "### " + "\n".join(lines)


def table(section: dict[str, Any]) -> str:
    """Return a section's table as Markdown."""

    def cell(row: dict[str, Any], column: dict[str, Any]) -> str:
        value = row.get(column["key"])
        if isinstance(value, float) or (isinstance(value, int) and column["digits"] is not None):
            return f"{value:,.{2 if column['digits'] is None else column['digits']}f}"
        return "" if value is None else f"{value:,}" if isinstance(value, int) else str(value).replace("|", "/")

    columns = section["columns"]
    rows = [[c["label"] for c in columns], ["---"] * len(columns)]
    rows += [[cell(row, c) for c in columns] for row in section["rows"]]
    return "\n".join("| " + " | ".join(row) + " |" for row in rows)


def stability(found: dict[str, Any]) -> str:
    """Return the tables of `farfield stability`."""
    short = lambda text: text if len(text) < 130 else text[:126] + "..."  # noqa: E731
    formulas = []
    for r in found["formulas"]:
        double, single = r["float64"], r["float32"]
        nan = f"{single['not_a_number']:,} of {single['tried']:,}"
        formulas.append(
            f"| `{r['name']}` | {r['equation']} | {r['domain']} | {double['error']:.1e} | {_error(single['error'])} | {nan} | "
            f"`{short(double['at'])}` |"
        )
    predicates = [
        f"| {r['name']} | {r['domain']} | {r['tried']:,} | {r['error']:.1e} | {_error(r['error_single'])} | {r['forbidden']}"
        + (f" ({r['forbidden_single']})" if r["forbidden_single"] is not None else "") + " |"
        for r in found["predicates"]
    ]  # fmt: skip
    cases = [
        f"| {r['group']} | {r['name']} | {r['outcome']}{' **' + r['wrong'] + '**' if r['wrong'] else ''} | {r['seconds']:.1f} |"
        for r in found["cases"]
    ]
    relations = [
        f"| {r['name']} | {r['compared']} | {', '.join(r['differs']) or 'nothing'} |" for r in found["relations"]
    ]
    software = ", ".join(f"{name} {version}" for name, version in found["software"].items())
    verdict = "Everything holds." if found["holds"] else "Not everything holds."
    text = f"""
Tried on: {found["machine"]}, {software}, seed {found["seed"]}, `{found["command"]}`. {verdict}
Inputs of a formula: {found["formulas"][0]["float64"]["tried"]:,}; its error is over its condition there. Made-up levels.

| formula | equation | domain | float64 | float32 | NaN in float32 | worst input in float64 |
|---|---|---|---|---|---|---|
{chr(10).join(formulas)}

| predicate | domain | cases | float64 | float32 | forbidden (float32) |
|---|---|---|---|---|---|
{chr(10).join(predicates)}

| group | case | outcome | seconds |
|---|---|---|---|
{chr(10).join(cases)}

| relation | compared | differs |
|---|---|---|
{chr(10).join(relations)}
"""
    return re.sub(r"\n{3,}", "\n\n", text)


def _error(value: float | None) -> str:
    return "-" if value is None else "infinite" if value == float("inf") else f"{value:.1e}"


if __name__ == "__main__":
    given = sys.argv[1:]
    if given[:1] == ["page"]:
        sys.exit(page())
    if len(given) > 1 and given[0] == "run" and given[1] in (*PLACES, "stability"):
        sys.exit(run(given[1], given[2:]))
    sys.exit(__doc__)
