"""The cursor of a list as clients see it, and the parameters that all lists share."""

import base64
import json
import math
from collections.abc import Sequence
from datetime import datetime
from typing import Annotated, Any

from farfield.store.pages import Cursor
from fastapi import Query
from pydantic import AwareDatetime

from farfield_api.errors import CursorInvalid
from farfield_api.replies.common import PLAIN

CursorText = Annotated[
    str | None, Query(alias="cursor", max_length=400, description="the `next` of the page before, unchanged")
]
Limit = Annotated[int, Query(ge=1, le=200, description="at most so many")]
Part = Annotated[
    str | None,
    Query(min_length=1, max_length=255, pattern=PLAIN, description="part of the name, any case"),
]
Since = Annotated[AwareDatetime | None, Query(description="made then or later", examples=["2026-01-31T09:15:00Z"])]
Until = Annotated[AwareDatetime | None, Query(description="made before then", examples=["2026-02-28T00:00:00Z"])]
DryRun = Annotated[bool, Query(description="change nothing, only say what would be deleted")]


def read_cursor(text: str | None) -> Cursor | None:
    """Return the place where a page begins; None: at the newest. Raises CursorInvalid."""
    if text is None:
        return None
    try:
        at, last = json.loads(base64.b64decode(text + "=" * (-len(text) % 4), altchars=b"-_", validate=True))
    except (ValueError, TypeError, RecursionError):
        raise CursorInvalid from None
    if type(at) not in (int, float) or not isinstance(last, str) or len(last) > 64 or not last.isalnum():
        raise CursorInvalid
    if not (math.isfinite(at) and last.isascii()):
        raise CursorInvalid
    return float(at), last


def cut(rows: Sequence[Any], limit: int, *, key: str = "id") -> tuple[list[Any], str | None]:
    """Return (the first `limit` rows, the cursor of what follows them) of up to `limit` + 1 rows."""
    if len(rows) <= limit:
        return list(rows), None
    last = rows[limit - 1]
    place = json.dumps([last.created_at, str(getattr(last, key))], separators=(",", ":"))
    return list(rows[:limit]), base64.urlsafe_b64encode(place.encode()).decode().rstrip("=")


def seconds(at: datetime | None) -> float | None:
    """Return seconds since 1970 UTC: half a millisecond before, for times are shown to the millisecond, and stored finer."""
    return at.timestamp() - 0.0005 if at is not None else None
