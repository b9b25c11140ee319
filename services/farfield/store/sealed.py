"""Secrets that must be used, and so cannot be hashed, in a form that the database alone does not give away.

Method   The secret's 32 bytes under a pad that HMAC-SHA256 makes of the operator's key and a nonce of this secret alone,
         and a tag over both, which tells a wrong key from a right one. The key never stands in the database.
After    Counter mode of a pseudorandom function, one block; encrypt, then authenticate (Bellare and Namprempre 2000).
Without  a key a secret stays as it is, and is sealed by the first `seal_all` that has one.
"""

import base64
import hashlib
import hmac
import secrets

import sqlalchemy as sa

from farfield.errors import ServiceError
from farfield.store.engine import read, write
from farfield.store.tables import webhook
from farfield.webhooks import PREFIX

SEALED = "sealed:"
NONCE_BYTES, SECRET_BYTES, TAG_BYTES = 16, 32, 16


def seal(key: str | None, secret: str) -> str:
    """Return what is stored of a secret made by `farfield.webhooks.new_secret`; without a key the secret itself."""
    plain = base64.b64decode(secret.removeprefix(PREFIX))
    if not key or len(plain) != SECRET_BYTES:
        return secret
    nonce = secrets.token_bytes(NONCE_BYTES)
    hidden = _padded(key, nonce, plain)
    return SEALED + base64.b64encode(nonce + hidden + _tag(key, nonce, hidden)).decode()


def unseal(key: str | None, stored: str) -> str:
    """Return the secret that was stored. Raises ServiceError where the key is missing or another."""
    if not stored.startswith(SEALED):
        return stored
    if not key:
        raise ServiceError("a webhook's secret is sealed, and there is no FARFIELD_WEBHOOK_KEY to open it with")
    data = base64.b64decode(stored.removeprefix(SEALED))
    nonce, hidden, tag = data[:NONCE_BYTES], data[NONCE_BYTES:-TAG_BYTES], data[-TAG_BYTES:]
    if not hmac.compare_digest(tag, _tag(key, nonce, hidden)):
        raise ServiceError("a webhook's secret was sealed with another FARFIELD_WEBHOOK_KEY")
    return PREFIX + base64.b64encode(_padded(key, nonce, hidden)).decode()


def seal_all(engine: sa.Engine, key: str | None) -> int:
    """Seal what still lies as it is; return how many webhooks that were."""
    if not key:
        return 0
    plain = webhook.c.secret.startswith(PREFIX) | webhook.c.old_secret.startswith(PREFIX)
    query = sa.select(webhook.c.id, webhook.c.secret, webhook.c.old_secret).where(plain)
    with read(engine) as tx:
        if tx.execute(query.limit(1)).one_or_none() is None:
            return 0
    with write(engine) as tx:
        rows = tx.execute(query.with_for_update()).all()
        for row in rows:
            kept = {name: seal(key, text) if text is not None and text.startswith(PREFIX) else text
                    for name, text in (("secret", row.secret), ("old_secret", row.old_secret))}  # fmt: skip
            tx.execute(sa.update(webhook).where(webhook.c.id == row.id).values(**kept))
        return len(rows)


def _padded(key: str, nonce: bytes, data: bytes) -> bytes:
    pad = hmac.digest(key.encode(), b"farfield webhook pad" + nonce, hashlib.sha256)
    return bytes(a ^ b for a, b in zip(data, pad, strict=True))


def _tag(key: str, nonce: bytes, hidden: bytes) -> bytes:
    return hmac.digest(key.encode(), b"farfield webhook tag" + nonce + hidden, hashlib.sha256)[:TAG_BYTES]
