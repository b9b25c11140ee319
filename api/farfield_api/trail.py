"""The audit trail: every change that somebody with a key asks for is written down before its answer is sent.

Which routes there are does not matter: what is not GET, HEAD or OPTIONS is a change. Bodies, keys and secrets are not kept.
Pieces of an upload are left out: what makes and ends the upload tells enough.
"""

import logging

import sqlalchemy as sa
from farfield.store import audit
from farfield.store.tenants import Caller
from starlette.concurrency import run_in_threadpool
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from farfield_api.auth import SAFE

log = logging.getLogger(__name__)

LEFT_OUT = ("PATCH /v1/uploads/",)


class Trail:
    """Wraps the app: see the module."""

    def __init__(self, app: ASGIApp, engine: sa.Engine) -> None:
        self.app, self.engine = app, engine

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http" or scope["method"] in SAFE:
            await self.app(scope, receive, send)
            return
        scope.setdefault("state", {})
        written = False

        async def noting(message: Message) -> None:
            nonlocal written
            if message["type"] == "http.response.start" and not written:
                written = True
                made = next((v.decode("latin-1") for k, v in message.get("headers", ()) if k == b"location"), "")
                await run_in_threadpool(self._note, scope, message["status"], made)
            await send(message)

        try:
            await self.app(scope, receive, noting)
        except Exception:
            if not written:
                await run_in_threadpool(self._note, scope, 500, "")
            raise

    def _note(self, scope: Scope, status: int, made: str) -> None:
        caller = scope["state"].get("caller")
        action = f"{scope['method']} {getattr(scope.get('route'), 'path', scope['path'])}"
        if not isinstance(caller, Caller) or action.startswith(LEFT_OUT):
            return
        address = scope["client"][0] if scope.get("client") else "unknown"
        target = f"{scope['path']} -> {made}" if made else scope["path"]
        try:
            audit.record(
                self.engine, caller.tenant_id, key_id=caller.key_id, key_name=caller.key_name, address=address,
                action=action, target=_storable(target), status=status,
            )  # fmt: skip
        except sa.exc.SQLAlchemyError:  # what was asked for has happened already: its answer must not say otherwise
            log.exception("no audit entry: %s by key %s: %d", action, caller.key_id, status)


def _storable(text: str) -> str:
    return "".join(c if c.isprintable() else "\ufffd" for c in text)
