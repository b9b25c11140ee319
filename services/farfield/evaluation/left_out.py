"""What a scene did not need, and about what that saved: derived from the report alone, in one place.

Problem  A stage that finds nothing to do is left out, and nobody sees what that was worth.
Method   A row for each need that the scene does not have. What was not done has no time of its own, so it is estimated:
         the scene's own count times what one of them took on other scenes (RATES), from the cheapest to the dearest of
         these; for shards that an earlier job had done, times what the others took in this job. Where neither is at hand,
         no figure is given.
Errs     Either way: RATES are of two shared cores, and scenes differ by their factors. They say what order of time it is.
"""

from collections.abc import Mapping
from typing import Any

# seconds of a processor for one: least and most, and of what
RATES: dict[str, tuple[str, float, float, str]] = {
    "visibility": ("cells", 0.03, 0.26, "sampled sets, cells of 23 m: Munich 3,445 cells, San Francisco 520"),
    "bound": ("candidates", 0.0004, 0.0004, "San Francisco, 173,913 candidates"),
    "proof": ("pairs", 0.015, 0.14, "2,200 pairs each: Munich (nothing in view), dream-apartment"),
}
_SOFTWARE = ("numba", "llvmpipe", "softpipe", "swiftshader", "software rasterizer")
_IMPOSTORS = ("candidates", "bake", "bound", "proof")


def left_out(report: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return rows of `need`, `why`, `stages` (left out in whole), `seconds` ([least, most] of one processor that this
    saved, or null) and `basis` (of these, or why there are none). `report` is that of `build_report`.
    """
    skipped = {s["name"]: s["skipped"] for s in report["stages"] if s["skipped"] is not None}
    rows = []
    if not report["problem_views"]:
        gone = [name for name in _IMPOSTORS if name in skipped]
        why = "every view is within the budget: there is nothing to replace"
        rows.append(_row("impostors", why, gone, None, "grows with the views that are too slow; there are none"))
    elif not report["impostors"]:
        gone = [name for name in _IMPOSTORS if name in skipped]
        rows.append(_row("impostors", "none was chosen", gone, None, "grows with the impostors; there are none"))
    for name, need in (("visibility", "occlusion"), ("detail", "levels of detail"), ("bound", "a lower bound"),
                       ("proof", "pictures of impostors")):  # fmt: skip
        if name in skipped and not (rows and name in rows[0]["stages"]):
            rows.append(_row(need, skipped[name], [name], *_estimate(name, report)))
    if not report["textures"]:
        why = "the level has no textures: none is decoded, sampled or stored with it"
        rows.append(_row("textures", why, [], None, "part of scene and bake, which did run"))
    if single := report["single_layer_impostors"]:
        why = f"{single:,} of {report['impostors']:,} impostors are shallow enough for one layer"
        rows.append(_row("more than one layer", why, [], None, "part of the bake; bytes are those of what is stored"))
    if report["impostors"] and _on_processors(report):
        why = f"everything was baked on processors: {report['software']['renderer']}"
        rows.append(_row("a GPU", why, [], None, "a machine, not time"))
    return rows + _reused(report)


def _row(need: str, why: str, stages: list[str], seconds: list[float] | None, basis: str) -> dict[str, Any]:
    return {"need": need, "why": why, "stages": stages, "seconds": seconds, "basis": basis}


def _estimate(name: str, report: Mapping[str, Any]) -> tuple[list[float] | None, str]:
    if name not in RATES:
        return None, "not measured"
    of, least, most, where = RATES[name]
    n = report["settings"]["proof"]["pairs"] if of == "pairs" else report[of]
    rate = f"{least:g}" if least == most else f"{least:g} to {most:g}"
    return [round(n * least, 1), round(n * most, 1)], f"{n:,} {of} at {rate} s ({where})"


def _on_processors(report: Mapping[str, Any]) -> bool:
    renderer = str(report["software"].get("renderer", "")).lower()
    return any(name in renderer for name in _SOFTWARE)


def _reused(report: Mapping[str, Any]) -> list[dict[str, Any]]:
    rows = []
    for s in report["stages"]:
        if not s["reused"]:
            continue
        ran = s["shards"] - s["reused"]
        seconds = [round(s["seconds"] * s["reused"] / ran, 1)] * 2 if ran else None
        basis = (
            f"at the rate of the {ran} that ran" if ran else "what they took is in the report of the job that made them"
        )
        why = f"unchanged: {s['reused']:,} of {s['shards']:,} shards were known from an earlier job"
        rows.append(_row(f"{s['name']} anew", why, [] if ran else [s["name"]], seconds, basis))
    return rows
