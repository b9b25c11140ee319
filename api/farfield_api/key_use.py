"""When a key was last used: gathered in this process, written twice a minute, so that reading costs no write."""

import asyncio
import logging

import sqlalchemy as sa
from farfield.store import tenants
from starlette.concurrency import run_in_threadpool

log = logging.getLogger(__name__)

EVERY_S = 30.0


class KeyUse:
    """The keys that were used since they were last written down."""

    def __init__(self, engine: sa.Engine) -> None:
        self.engine = engine
        self._used: set[str] = set()

    def note(self, key_id: str) -> None:
        """Remember that the key was used now."""
        self._used.add(key_id)

    def write(self) -> None:
        """Write down what was gathered; what cannot be written is kept for the next time."""
        used, self._used = self._used, set()
        if not used:
            return
        try:
            tenants.mark_used(self.engine, used)
        except sa.exc.SQLAlchemyError:
            log.warning("when keys were used could not be written", exc_info=True)
            self._used |= used

    async def run(self) -> None:
        """Write now and then; runs until cancelled."""
        while True:
            await asyncio.sleep(EVERY_S)
            await run_in_threadpool(self.write)
