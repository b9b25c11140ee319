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

    def miss(self, what: str, value: float, limit: float, *, bound: float, text: str = "{:.4f}") -> None:
        """Note a figure whose limit is not reached yet and say so; fail only where it is not below `bound` either."""
        state = "ok" if value < limit else "MISSED"
        self.rows.append((what, text.format(value), f"below {text.format(limit)}", state))
        assert value < bound, f"{what}: {text.format(value)}, has been below {text.format(bound)}"

    def note(self, what: str, value: str) -> None:
        self.rows.append((what, value, "", ""))
