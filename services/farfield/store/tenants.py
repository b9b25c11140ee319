"""Tenants, their API keys, and one-time logins. Secrets are stored as digests only.

A key reads ff_ID_SECRET. The secret is 256 random bits, so a plain SHA-256 keeps it: nothing can be guessed from it.
"""

import hashlib
import hmac
import secrets
from collections.abc import Collection
from dataclasses import dataclass
from typing import Any

import sqlalchemy as sa

from farfield.store.engine import new_id, now, read, write
from farfield.store.tables import SCOPES, api_key, login, tenant

LOGIN_S = 7 * 24 * 3600.0


@dataclass(frozen=True, slots=True)
class Caller:
    """Who a request comes from."""

    tenant_id: str
    key_id: str
    scopes: frozenset[str]


def digest_of(secret: str) -> str:
    """Return what is stored of a secret."""
    return hashlib.sha256(secret.encode()).hexdigest()


def create_tenant(engine: sa.Engine, name: str) -> str:
    """Return the id of the tenant with this name, made where there is none."""
    with write(engine) as tx:
        found = tx.scalar(sa.select(tenant.c.id).where(tenant.c.name == name))
        if found is None:
            found = new_id()
            tx.execute(sa.insert(tenant).values(id=found, name=name, created_at=now()))
        return str(found)


def create_key(engine: sa.Engine, tenant_id: str, name: str, scopes: Collection[str]) -> str:
    """Make an API key and return it; it cannot be read again. `scopes`: words of tables.SCOPES."""
    assert set(scopes) <= set(SCOPES)
    key_id, secret = new_id(), secrets.token_urlsafe(32)
    with write(engine) as tx:
        tx.execute(
            sa.insert(api_key).values(
                id=key_id, tenant_id=tenant_id, name=name, secret_digest=digest_of(secret),
                scopes=" ".join(s for s in SCOPES if s in scopes), created_at=now(),
            )
        )  # fmt: skip
    return f"ff_{key_id}_{secret}"


def revoke_key(engine: sa.Engine, key_id: str) -> None:
    """End a key, and with it every session made from it."""
    with write(engine) as tx:
        tx.execute(sa.update(api_key).where(api_key.c.id == key_id).values(revoked_at=now()))


def has_keys(engine: sa.Engine) -> bool:
    """Say whether any key is valid."""
    with read(engine) as tx:
        return bool(tx.scalar(sa.select(sa.func.count()).where(api_key.c.revoked_at.is_(None)).select_from(api_key)))


def caller_of_key(engine: sa.Engine, key: str) -> Caller | None:
    """Return who holds `key`, or None. Compares in constant time."""
    prefix, _, rest = key.partition("_")
    key_id, _, secret = rest.partition("_")
    row = _key_row(engine, key_id)
    expected = row.secret_digest if row is not None else digest_of("")
    if not hmac.compare_digest(digest_of(secret), expected) or row is None or prefix != "ff":
        return None
    return Caller(row.tenant_id, row.id, frozenset(row.scopes.split()))


def caller_of_id(engine: sa.Engine, key_id: str) -> Caller | None:
    """Return who a session of this key belongs to, or None where the key is gone or revoked."""
    row = _key_row(engine, key_id)
    return Caller(row.tenant_id, row.id, frozenset(row.scopes.split())) if row is not None else None


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


def _key_row(engine: sa.Engine, key_id: str) -> Any:
    columns = (api_key.c.id, api_key.c.tenant_id, api_key.c.secret_digest, api_key.c.scopes)
    with read(engine) as tx:
        return tx.execute(
            sa.select(*columns).where(api_key.c.id == key_id, api_key.c.revoked_at.is_(None))
        ).one_or_none()
