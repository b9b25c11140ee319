"""What `make accept` measured, beside what it has to be."""


class Figures:
    """What was measured, beside what it has to be."""

    def __init__(self) -> None:
        self.rows: list[tuple[str, str, str, str]] = []

    def check(self, what: str, value: float, limit: float, *, text: str = "{:,.0f}", least: bool = False) -> None:
        """Note a figure; fail unless it is below the limit (at most it, for 0; at least it where `least`)."""
        holds = value >= limit if least else value < limit or value == limit == 0
        sign = "at least" if least else "below" if limit else "none"
        self.rows.append(
            (what, text.format(value), f"{sign} {text.format(limit)}" if limit else sign, "ok" if holds else "FAILS")
        )
        assert holds, f"{what}: {text.format(value)}, must be {sign} {text.format(limit)}"

    def note(self, what: str, value: str) -> None:
        self.rows.append((what, value, "", ""))
