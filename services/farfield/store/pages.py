"""Lists, newest first, in pages: one order (created_at, id) and one cursor for all of them."""

from typing import Any

import sqlalchemy as sa

ALL = "*"  # in place of a tenant: rows of every one, for an operator that reads

Cursor = tuple[float, str]  # (created_at, id) of the last row of the page before


def owned(column: sa.ColumnElement[Any], tenant_id: str) -> sa.ColumnElement[bool]:
    """Return the condition that a row is the tenant's, or anyone's where `tenant_id` is ALL."""
    return sa.true() if tenant_id == ALL else column == tenant_id


def newest_first(
    query: sa.Select[Any], created_at: sa.ColumnElement[Any], row_id: sa.ColumnElement[Any], *, before: Cursor | None,
    limit: int,
) -> sa.Select[Any]:  # fmt: skip
    """Return `query` for the page of up to `limit` rows after the cursor; equal times are told apart by id."""
    if before is not None:
        at, last = before
        query = query.where((created_at < at) | ((created_at == at) & (row_id < last)))
    return query.order_by(created_at.desc(), row_id.desc()).limit(limit)


def holding(column: sa.ColumnElement[Any], text: str) -> sa.ColumnElement[bool]:
    """Return the condition that the column holds `text` somewhere, whatever the case of its letters A to Z."""
    escaped = text.lower().replace("\\", "\\\\").replace("%", "\\%").replace("_", "\\_")
    return sa.func.lower(column).like(f"%{escaped}%", escape="\\")
