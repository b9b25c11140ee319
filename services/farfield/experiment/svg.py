"""Plots as SVG text: lines and points over linear or logarithmic axes, in colours that follow the page's theme.

What we left out: any interaction. A point's title is its tooltip; the numbers are in the table beside the plot.
"""

import math
from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

WIDTH, HEIGHT = 640, 340
LEFT, RIGHT, TOP, BOTTOM = 74, 18, 34, 54
COLOURS = 8  # classes s0 .. s7
_MOST_TICKS = 7

STYLE = """
.plot{--ink:#1b1f24;--soft:#5d6670;--grid:#dfe3e8;--s0:#0b62c4;--s1:#c2410c;--s2:#15803d;--s3:#7e22ce;--s4:#a16207;
--s5:#0e7490;--s6:#be185d;--s7:#57534e;font:12px system-ui,sans-serif;max-width:100%;height:auto}
@media (prefers-color-scheme:dark){.plot{--ink:#e6e9ed;--soft:#9aa4af;--grid:#333a42;--s0:#6cb2ff;--s1:#ff9a66;--s2:#6fd48c;
--s3:#c79bff;--s4:#e5bf55;--s5:#5fd0e6;--s6:#ff8fc0;--s7:#c2bcb6}}
@media print{.plot{--ink:#000;--soft:#333;--grid:#ccc;--s0:#0b62c4;--s1:#c2410c;--s2:#15803d;--s3:#7e22ce;--s4:#a16207;
--s5:#0e7490;--s6:#be185d;--s7:#57534e}}
.plot text{fill:var(--ink)}.plot .soft{fill:var(--soft)}.plot .grid{stroke:var(--grid)}.plot .axis{stroke:var(--soft)}
.plot .level{stroke:var(--soft);stroke-dasharray:6 4}.plot path,.plot .ring{fill:none;stroke-width:1.6}
.plot .title{font-weight:600;font-size:13px}
""" + "".join(
    f".plot .s{k}{{stroke:var(--s{k})}}.plot .d{k}{{fill:var(--s{k})}}" for k in range(COLOURS)
)  # fmt: skip


class _Axis:
    """Data to pixels. A logarithmic axis leaves out what is not positive."""

    def __init__(self, values: Sequence[float], low_px: float, high_px: float, *, log: bool) -> None:
        kept = [v for v in values if math.isfinite(v) and (v > 0 or not log)]
        low, high = (min(kept), max(kept)) if kept else (1.0, 10.0)
        self.log, self.low_px, self.high_px = log, low_px, high_px
        if log:
            low, high = math.log10(low), math.log10(high)
            if high - low < 0.3:
                low, high = low - 0.15, high + 0.15
        elif low >= 0 and low < 0.5 * high:
            low = 0.0
        if high <= low:
            low, high = low - (abs(low) * 0.1 or 1), high + (abs(high) * 0.1 or 1)
        margin = 0.05 * (high - low)
        self.low, self.high = (low if low == 0 and not log else low - margin), high + margin

    def px(self, value: float) -> float | None:
        if not math.isfinite(value) or (self.log and value <= 0):
            return None
        at = math.log10(value) if self.log else value
        return self.low_px + (at - self.low) / (self.high - self.low) * (self.high_px - self.low_px)

    def ticks(self) -> list[tuple[float, float]]:
        """Return round values within the axis and where they lie."""
        return [(v, at) for v in self._round() if (at := self.px(v)) is not None]

    def _round(self) -> list[float]:
        if self.log:
            found = [
                m * 10.0**e
                for e in range(math.floor(self.low), math.ceil(self.high) + 1)
                for m in ((1, 2, 5) if self.high - self.low < 2.5 else (1,))
            ]
            found = [v for v in found if self.low <= math.log10(v) <= self.high]
            return found[:: -(-len(found) // _MOST_TICKS)] if found else []
        raw = (self.high - self.low) / (_MOST_TICKS - 1)
        base = 10.0 ** math.floor(math.log10(raw))
        step = next(base * m for m in (1, 2, 5, 10) if base * m >= raw)
        return [step * k for k in range(math.ceil(self.low / step), math.floor(self.high / step) + 1)]


def number(value: float) -> str:
    """Return a number as people write it: three or four digits that count, thousands apart."""
    if value == 0:
        return "0"
    if abs(value) >= 1000:
        return f"{value:,.0f}" if abs(value) < 1e7 else f"{value:.2e}"
    return f"{value:.4g}" if abs(value) >= 1e-4 else f"{value:.1e}"


def draw(plot: Mapping[str, Any], *, alone: bool = False) -> str:
    """Return a plot (JSON values of `document.Plot`) as an <svg> element; `alone`: as a file, with its own colours."""
    series = plot["series"]
    x = _Axis([v for s in series for v in s["x"]], LEFT, WIDTH - RIGHT, log=plot["log_x"])
    ys = [v for s in series for v in s["y"]] + ([plot["level"]] if plot["level"] is not None else [])
    y = _Axis(ys, HEIGHT - BOTTOM - 16 * (len(series) > 1), TOP, log=plot["log_y"])
    out = [f'<text class="title" x="{LEFT}" y="18">{escape(plot["title"])}</text>']
    for tick, at in x.ticks():
        out.append(f'<line class="grid" x1="{at:.1f}" x2="{at:.1f}" y1="{TOP}" y2="{y.low_px}"/>')
        out.append(f'<text class="soft" x="{at:.1f}" y="{y.low_px + 16}" text-anchor="middle">{number(tick)}</text>')
    for tick, at in y.ticks():
        out.append(f'<line class="grid" x1="{LEFT}" x2="{WIDTH - RIGHT}" y1="{at:.1f}" y2="{at:.1f}"/>')
        out.append(f'<text class="soft" x="{LEFT - 6}" y="{at + 4:.1f}" text-anchor="end">{number(tick)}</text>')
    out.append(f'<line class="axis" x1="{LEFT}" x2="{WIDTH - RIGHT}" y1="{y.low_px}" y2="{y.low_px}"/>')
    out.append(
        f'<text x="{(LEFT + WIDTH - RIGHT) / 2}" y="{y.low_px + 34}" text-anchor="middle">{escape(plot["x"])}</text>'
    )
    middle = (TOP + y.low_px) / 2
    out.append(f'<text x="14" y="{middle}" text-anchor="middle" transform="rotate(-90 14 {middle})">'
               f'{escape(plot["y"])}</text>')  # fmt: skip
    if plot["level"] is not None and (held := y.px(plot["level"])) is not None:
        out.append(f'<line class="level" x1="{LEFT}" x2="{WIDTH - RIGHT}" y1="{held:.1f}" y2="{held:.1f}"/>')
        out.append(f'<text class="soft" x="{WIDTH - RIGHT - 4}" y="{held - 5:.1f}" text-anchor="end">'
                   f'{escape(plot["level_label"])}</text>')  # fmt: skip
    for k, one in enumerate(series):
        out += _series(one, k % COLOURS, x, y)
    if len(series) > 1:
        out += _legend(series)
    head = f'<svg class="plot" xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" width="{WIDTH}" '
    head += f'height="{HEIGHT}" role="img" aria-label="{escape(plot["title"])}">'
    style = f'<style>{STYLE}</style><rect width="100%" height="100%" fill="#fff"/>' if alone else ""
    return head + (style.replace("prefers-color-scheme:dark", "not all") if alone else "") + "".join(out) + "</svg>"


def _series(one: Mapping[str, Any], k: int, x: _Axis, y: _Axis) -> list[str]:
    points = [(x.px(a), y.px(b)) for a, b in zip(one["x"], one["y"], strict=True)]
    out, path, pen = [], "", "M"
    for a, b in points:
        if a is None or b is None:
            pen = "M"
            continue
        path += f"{pen}{a:.1f} {b:.1f}"
        pen = "L"
    if one["line"]:
        out.append(f'<path class="s{k}" d="{path}"/>')
    many = len(points) > 40
    for i, (a, b) in enumerate(points):
        if a is None or b is None or (many and i not in one["marked"]):
            continue
        label = one["labels"][i] if one["labels"] else one["name"]
        said = [label, f"{number(one['x'][i])}, {number(one['y'][i])}"]
        said += ["on the Pareto front"] * (i in one["pareto"]) + ["the job's own setting"] * (i in one["marked"])
        if i in one["marked"]:
            out.append(f'<circle class="ring s{k}" cx="{a:.1f}" cy="{b:.1f}" r="8"/>')
        filled = f'class="s{k} d{k}"' if not one["pareto"] or i in one["pareto"] else f'class="s{k}" fill="none"'
        out.append(
            f'<circle {filled} cx="{a:.1f}" cy="{b:.1f}" r="4"><title>{escape("; ".join(said))}</title></circle>'
        )
        if one["labels"] and len(points) <= 8 and k == 0:  # the others are at the same x
            end = a > WIDTH * 0.75
            out.append(f'<text class="soft" x="{a + (-9 if end else 9):.1f}" y="{b - 7:.1f}"'
                       f'{" text-anchor=" + chr(34) + "end" + chr(34) if end else ""}>{escape(label)}</text>')  # fmt: skip
    return out


def _legend(series: Sequence[Mapping[str, Any]]) -> list[str]:
    out, at = [], float(LEFT)
    for k, one in enumerate(series):
        out.append(f'<circle class="d{k % COLOURS}" cx="{at + 4:.1f}" cy="{HEIGHT - 10}" r="4"/>')
        out.append(f'<text class="soft" x="{at + 12:.1f}" y="{HEIGHT - 6}">{escape(one["name"])}</text>')
        at += 26 + 6.3 * len(one["name"])
    return out
