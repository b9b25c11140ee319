"""Why a ratio goes another way than the paper's: the first measured difference that accounts for it, or "unexplained"."""

import math
from collections.abc import Callable, Iterator, Mapping
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from farfield.experiment.table1 import Test

SAME = 0.02  # a ratio this near 1 has no direction
UNEXPLAINED = "unexplained"
Facts = Mapping[str, Any]


def compare(test: "Test", facts: Mapping[str, Facts]) -> dict[str, Any]:
    """Return the row of a test: what it came to, beside the paper's, with `direction` and, where that differs, `why`.

    direction  "same", "other", "nothing to compare" (the other weighs nothing), "" (held against nothing)
    """
    mine = facts[test.key]
    row: dict[str, Any] = {
        "test": test.key, "name": test.name, **{k: mine[k] for k in ("problem_views", "hopeless", "candidates", "impostors")},
        "megabytes": mine["bytes"] / 1e6, "cpu_seconds": mine["cpu_seconds"], "held_against": test.base, "ratio": None,
        "paper_ratio": None, "direction": "", "why": "", "mark": "current" if test.base is None and test.key == "1" else "",
        **dict(zip(("paper_views", "paper_candidates", "paper_impostors", "paper_mb"), test.paper or (None,) * 4,
                   strict=True)),
    }  # fmt: skip
    if test.base is None:
        return row
    base = facts[test.base]
    row["ratio"] = mine["bytes"] / base["bytes"] if base["bytes"] else None
    if test.paper is not None:
        row["paper_ratio"] = test.paper[3] / (test.paper_base_mb or 14.1)
        same = same_direction(row["ratio"], row["paper_ratio"])
        row["direction"] = "nothing to compare" if row["ratio"] is None else "same" if same else "other"
        if row["direction"] == "other":
            row["why"] = next(_reasons(test.key, mine, base, facts), UNEXPLAINED)
    return row


def same_direction(ours: float | None, paper: float) -> bool:
    """Return whether two ratios lie on the same side of 1; one within SAME of 1 agrees with one within 0.1 only."""
    if ours is None or ours <= 0:
        return ours is not None and paper < 1
    a, b = math.log(ours), math.log(paper)
    if abs(a) <= math.log1p(SAME) or abs(b) <= math.log1p(SAME):
        return abs(a) <= math.log1p(0.1) and abs(b) <= math.log1p(0.1)
    return (a > 0) == (b > 0)


def _reasons(key: str, mine: Facts, base: Facts, facts: Mapping[str, Facts]) -> Iterator[str]:
    """Yield what was measured that accounts for the difference, the surest first."""
    if not mine["problem_views"] or not base["problem_views"]:
        less = "it" if not mine["problem_views"] else "what it is held against"
        yield f"{less} has no problem view at its budget, so there is nothing to place"
    own = _OWN.get(key)
    if own is not None and (said := own(mine, base, facts)) is not None:
        yield said
    if max(mine["hopeless_share"], base["hopeless_share"]) > 0.02:
        yield (
            f"{mine['hopeless']:,} of {mine['problem_views']:,} problem views are hopeless here and {base['hopeless']:,} of "
            f"{base['problem_views']:,} there: what cannot be saved takes no memory, so the two do not buy the same"
        )
    grew = mine["bytes"] > base["bytes"]
    for name, said in (("overrun_mean", "mean overrun of a problem view"), ("seen_mean", "objects that a cell sees")):
        if base[name] and (mine[name] > base[name] * (1 + SAME)) == grew and abs(mine[name] / base[name] - 1) > SAME:
            yield f"the {said} is {mine[name]:.3g} against {base[name]:.3g}: there is {'more' if grew else 'less'} to save"


def _boxes(mine: Facts, base: Facts, facts: Mapping[str, Facts]) -> str | None:
    both, raw_shafts, raw_boxes = facts["1"], facts["p"], facts["pb"]
    if both["boxes_share"] <= 0.5 and mine["bytes"] >= base["bytes"]:
        return None
    way = raw_boxes["bytes"] / raw_shafts["bytes"] if raw_shafts["bytes"] else math.nan
    return (
        f"fitted boxes are the tighter view cells here: where both are on offer (test 1), {100 * both['boxes_share']:.0f} % "
        f"of the impostors have one; unfitted, as the paper has them (pb over p), boxes weigh {way:.2f} of shafts"
    )


def _density(mine: Facts, base: Facts, facts: Mapping[str, Facts]) -> str | None:
    n, m = mine["candidates"], base["candidates"]
    if m and abs(n / m - 1) <= 0.01:
        return f"{n:,} candidates instead of {m:,}: all sets of cells that help are offered either way"
    ratio = mine["bytes"] / base["bytes"] if base["bytes"] else math.nan
    halves = facts["n1"]["bytes"], facts["n2"]["bytes"]
    if abs(ratio - 1) < 0.05:
        return (f"{n:,} candidates instead of {m:,} change memory by {100 * (ratio - 1):+.1f} %: the choice among those offered "
                f"is already within a few percent (halves of the view space differ by "
                f"{100 * abs(halves[1] / halves[0] - 1) if halves[0] else 0:.0f} %)")  # fmt: skip
    return None


def _alone(mine: Facts, base: Facts, facts: Mapping[str, Facts]) -> str | None:
    if mine["bytes"] >= base["bytes"]:
        return None
    return (f"an impostor of one cell is shown in {mine['views_each']:.1f} problem views, a shaft's in {base['views_each']:.1f}, "
            f"and has {mine['layers_each']:.1f} layers against {base['layers_each']:.1f}: near view cells cost more layers than "
            "sharing them saves")  # fmt: skip


def _maps(mine: Facts, base: Facts, facts: Mapping[str, Facts]) -> str | None:
    return (f"maps hold only what lies far off, {mine['impostors']:,} parts of {mine['layers_each']:.1f} layers each; "
            f"{mine['hopeless']:,} of {mine['problem_views']:,} problem views stay over budget with them against "
            f"{base['hopeless']:,} of {base['problem_views']:,}: they weigh less because they do less")  # fmt: skip


def _hidden(mine: Facts, base: Facts, facts: Mapping[str, Facts]) -> str | None:
    if base["skipped_visibility"]:
        return f"the test that it is held against had no visibility either: {base['skipped_visibility']}"
    return None


_OWN: dict[str, Callable[[Facts, Facts, Mapping[str, Facts]], str | None]] = {
    "11": _density, "12": _density, "13": _boxes, "pb": _boxes, "14": _alone, "15": _maps, "16": _hidden,
}  # fmt: skip
