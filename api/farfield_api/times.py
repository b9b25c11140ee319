"""Times as clients see them: RFC 3339, UTC, to the millisecond."""

from datetime import UTC, datetime


def iso(seconds: float | None) -> str | None:
    """Return "2026-01-31T09:15:00.000Z" for seconds since 1970, or None."""
    if seconds is None:
        return None
    return datetime.fromtimestamp(seconds, UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
