"""Tenants, their API keys, and one-time logins. Secrets are stored as digests only.

A key reads ff_ID_SECRET. The secret is 256 random bits, so a plain SHA-256 keeps it: nothing can be guessed from it.
"""

import hashlib
import hmac
import re
import secrets
from collections.abc import Collection, Iterable
from dataclasses import dataclass, replace
from typing import Any

import sqlalchemy as sa

from farfield.errors import KeyNotFound, QuotaExceeded, TenantExists, TenantNotFound
from farfield.store.engine import insert, new_id, now, read, write
from farfield.store.pages import Cursor, newest_first, owned
from farfield.store.tables import SCOPES, api_key, ended_session, login, tenant

LOGIN_S = 7 * 24 * 3600.0


@dataclass(frozen=True, slots=True)
class Caller:
    """Who a request comes from, and the tenant that it acts in."""

    tenant_id: str
    key_id: str
    scopes: frozenset[str]
    key_name: str = ""
    operator: bool = False  # of the operator's tenant
    session: str | None = None  # digest of the cookie that it came with


def digest_of(secret: str) -> str:
    """Return what is stored of a secret."""
    return hashlib.sha256(secret.encode()).hexdigest()


def create_tenant(engine: sa.Engine, name: str, *, operator: bool = False) -> str:
    """Return the id of the tenant with this name, made where there is none; `operator` counts for a new one."""
    with write(engine) as tx:
        found = tx.scalar(sa.select(tenant.c.id).where(tenant.c.name == name))
        if found is None:
            found = new_id()
            tx.execute(sa.insert(tenant).values(id=found, name=name, is_operator=operator, created_at=now()))
        return str(found)


def add_tenant(engine: sa.Engine, name: str) -> str:
    """Return the id of a new tenant. Raises TenantExists."""
    with write(engine) as tx:
        if tx.scalar(sa.select(tenant.c.id).where(tenant.c.name == name)) is not None:
            raise TenantExists(name)
        tenant_id = new_id()
        tx.execute(sa.insert(tenant).values(id=tenant_id, name=name, created_at=now()))
        return tenant_id


def get_tenant(engine: sa.Engine, tenant_id: str) -> sa.Row[Any]:
    """Return the tenant's row. Raises TenantNotFound."""
    with read(engine) as tx:
        row = tx.execute(sa.select(tenant).where(tenant.c.id == tenant_id)).one_or_none()
    if row is None:
        raise TenantNotFound(tenant_id)
    return row


def page_of_tenants(engine: sa.Engine, *, before: Cursor | None, limit: int) -> list[sa.Row[Any]]:
    """Return the newest tenants."""
    with read(engine) as tx:
        return list(
            tx.execute(newest_first(sa.select(tenant), tenant.c.created_at, tenant.c.id, before=before, limit=limit))
        )


def create_key(
    engine: sa.Engine, tenant_id: str, name: str, scopes: Collection[str], *, lifetime_s: float | None = None,
    most: int | None = None,
) -> str:  # fmt: skip
    """Make an API key and return it; it cannot be read again. `scopes`: words of tables.SCOPES.

    most  keys of the tenant that may be valid at a time; None: any number. Raises QuotaExceeded.
    """
    assert set(scopes) <= set(SCOPES)
    with write(engine) as tx:
        _check_number(tx, tenant_id, most)
        return _insert_key(tx, tenant_id, name, " ".join(s for s in SCOPES if s in scopes), _after(lifetime_s))


def rotate_key(
    engine: sa.Engine, tenant_id: str, key_id: str, *, grace_s: float, lifetime_s: float | None = None,
    most: int | None = None,
) -> str:  # fmt: skip
    """Make a key of the same name and scopes and return it; the old one ends after `grace_s`, if not sooner.

    lifetime_s  of the new key; None: as long as the old one was made for. Raises KeyNotFound
    most        as for create_key, where the old key lives on. Raises QuotaExceeded.
    """
    with write(engine) as tx:
        old = _key(tx, tenant_id, key_id, alive=True)
        if grace_s:
            _check_number(tx, old.tenant_id, most)
        expires_at: Any = _after(lifetime_s)
        if lifetime_s is None and old.expires_at is not None:
            expires_at = now() + (old.expires_at - old.created_at)
        made = _insert_key(tx, old.tenant_id, old.name, old.scopes, expires_at)
        sooner = api_key.c.expires_at.is_(None) | (api_key.c.expires_at > now() + grace_s)
        tx.execute(sa.update(api_key).where(api_key.c.id == key_id, sooner).values(expires_at=now() + grace_s))
        return made


def revoke_key(engine: sa.Engine, key_id: str) -> None:
    """End a key, and with it every session made from it."""
    with write(engine) as tx:
        gone = (api_key.c.id == key_id) & api_key.c.revoked_at.is_(None)
        tx.execute(sa.update(api_key).where(gone).values(revoked_at=now()))


def get_key(engine: sa.Engine, tenant_id: str, key_id: str) -> sa.Row[Any]:
    """Return what may be shown of a key of the tenant, whether it still is valid or not. Raises KeyNotFound."""
    with read(engine) as tx:
        return _key(tx, tenant_id, key_id)


def page_of_keys(engine: sa.Engine, tenant_id: str, *, before: Cursor | None, limit: int) -> list[sa.Row[Any]]:
    """Return the tenant's newest keys, revoked and expired ones too, without what is stored of their secrets."""
    with read(engine) as tx:
        query = sa.select(*_SHOWN).where(owned(api_key.c.tenant_id, tenant_id))
        return list(tx.execute(newest_first(query, api_key.c.created_at, api_key.c.id, before=before, limit=limit)))


def mark_used(engine: sa.Engine, key_ids: Iterable[str]) -> None:
    """Remember that these keys were used about now."""
    with write(engine) as tx:
        tx.execute(sa.update(api_key).where(api_key.c.id.in_(list(key_ids))).values(last_used_at=now()))


def has_keys(engine: sa.Engine) -> bool:
    """Say whether any key is valid."""
    with read(engine) as tx:
        return bool(tx.scalar(sa.select(sa.func.count()).where(_alive()).select_from(api_key)))


def caller_of_key(engine: sa.Engine, key: str) -> Caller | None:
    """Return who holds `key`, or None. Compares in constant time."""
    prefix, _, rest = key.partition("_")
    key_id, _, secret = rest.partition("_")
    row = _valid_key(engine, key_id)
    expected = row.secret_digest if row is not None else digest_of("")
    if not hmac.compare_digest(digest_of(secret), expected) or row is None or prefix != "ff":
        return None
    return _caller(row)


def caller_of_id(engine: sa.Engine, key_id: str, session: str | None = None) -> Caller | None:
    """Return whose this key, or this session of it, is; None where the key is gone, expired or revoked, or the session ended.

    session  `digest_of` its cookie
    """
    if session is not None:
        with read(engine) as tx:
            if tx.scalar(_ENDED, {"session": session}) is not None:
                return None
    row = _valid_key(engine, key_id)
    return replace(_caller(row), session=session) if row is not None else None


def end_session(engine: sa.Engine, session: str, *, expires_at: float) -> None:
    """End a session for good, of which `session` is `digest_of` its cookie; forget those that are over anyway."""
    with write(engine) as tx:
        over = ended_session.c.expires_at < now() - 86_400.0  # a day later: the clock that made it may be another
        tx.execute(sa.delete(ended_session).where(over))
        values = {"session_digest": session, "expires_at": expires_at}
        tx.execute(insert(tx, ended_session).values(values).on_conflict_do_nothing())


def create_login(engine: sa.Engine, key_id: str, *, lifetime_s: float = LOGIN_S) -> str:
    """Make a token that opens the pages once, as the holder of the key. It goes into the fragment of a link."""
    token = secrets.token_urlsafe(32)
    with write(engine) as tx:
        owner = tx.execute(sa.select(api_key.c.tenant_id).where(api_key.c.id == key_id)).scalar_one()
        tx.execute(
            sa.insert(login).values(
                token_digest=digest_of(token), tenant_id=owner, api_key_id=key_id,
                created_at=now(), expires_at=now() + lifetime_s,
            )
        )  # fmt: skip
    return token


def redeem_login(engine: sa.Engine, token: str) -> Caller | None:
    """Use a login token up and return its key's holder; None where it is unknown, used or too old."""
    with write(engine) as tx:
        key_id = tx.scalar(
            sa.update(login)
            .where(login.c.token_digest == digest_of(token), login.c.used_at.is_(None), login.c.expires_at > now())
            .values(used_at=now()).returning(login.c.api_key_id)
        )  # fmt: skip
    return caller_of_id(engine, key_id) if key_id is not None else None


_SHOWN = [c for c in api_key.c if c.name != "secret_digest"]


def _alive() -> sa.ColumnElement[bool]:
    return api_key.c.revoked_at.is_(None) & (api_key.c.expires_at.is_(None) | (api_key.c.expires_at > now()))


def _after(seconds: float | None) -> Any:
    return now() + seconds if seconds is not None else None


def _check_number(tx: sa.Connection, tenant_id: str, most: int | None) -> None:
    valid = sa.select(sa.func.count()).select_from(api_key).where(api_key.c.tenant_id == tenant_id, _alive())
    if most is not None and (there := int(tx.scalar(valid) or 0)) >= most:
        raise QuotaExceeded("keys", there, most)


def _insert_key(tx: sa.Connection, tenant_id: str, name: str, scopes: str, expires_at: Any) -> str:
    key_id, secret = new_id(), secrets.token_urlsafe(32)
    tx.execute(
        sa.insert(api_key).values(
            id=key_id, tenant_id=tenant_id, name=name, secret_digest=digest_of(secret), scopes=scopes,
            created_at=now(), expires_at=expires_at,
        )
    )  # fmt: skip
    return f"ff_{key_id}_{secret}"


def _key(tx: sa.Connection, tenant_id: str, key_id: str, *, alive: bool = False) -> sa.Row[Any]:
    query = sa.select(*_SHOWN).where(api_key.c.id == key_id, owned(api_key.c.tenant_id, tenant_id))
    row = tx.execute(query.where(_alive()) if alive else query).one_or_none()
    if row is None:
        raise KeyNotFound(key_id)
    return row


def _valid_key(engine: sa.Engine, key_id: str) -> Any:
    if not re.fullmatch("[0-9a-f]{32}", key_id):
        return None
    with read(engine) as tx:
        return tx.execute(_VALID_KEY, {"key": key_id}).one_or_none()


def _caller(row: Any) -> Caller:
    return Caller(row.tenant_id, row.id, frozenset(row.scopes.split()), row.name, bool(row.is_operator))


# Asked by every request, so made once.
_VALID_KEY = (
    sa.select(api_key, tenant.c.is_operator).join(tenant, tenant.c.id == api_key.c.tenant_id)
    .where(api_key.c.id == sa.bindparam("key"), _alive())
)  # fmt: skip
_ENDED = sa.select(ended_session.c.expires_at).where(ended_session.c.session_digest == sa.bindparam("session"))
