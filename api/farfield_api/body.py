"""The body of a request, piece by piece, for as long as it moves.

Pace    A body brings at least PACE_BYTES in every `stall_s` seconds, or its end, or it is refused: one that drips holds no
        file open and no lock. Nothing else limits how long it takes.
"""

import asyncio
from collections.abc import AsyncIterator

from fastapi import Request

from farfield_api.errors import UploadCut, UploadStalled

PACE_BYTES = 1 << 16


class Body:
    """The pieces of one request's body; `interrupt` ends it as if the line had been cut."""

    def __init__(self, request: Request, stall_s: float) -> None:
        self._receive, self._stall_s = request.receive, stall_s
        self._waiting: asyncio.Timeout | None = None
        self._interrupted = False

    def interrupt(self) -> None:
        self._interrupted = True
        if self._waiting is not None:
            self._waiting.reschedule(0.0)

    async def pieces(self) -> AsyncIterator[bytes]:
        """Yield what arrives. Raises UploadStalled, and UploadCut where the line ends before the body does."""
        clock = asyncio.get_running_loop().time
        deadline, n_bytes, more = clock() + self._stall_s, 0, True
        while more:
            try:
                async with asyncio.timeout_at(0.0 if self._interrupted else deadline) as self._waiting:
                    message = await self._receive()
            except TimeoutError:
                raise UploadCut if self._interrupted else UploadStalled(self._stall_s) from None
            finally:
                self._waiting = None
            if message["type"] != "http.request":
                raise UploadCut
            piece, more = message.get("body", b""), message.get("more_body", False)
            n_bytes += len(piece)
            if n_bytes >= PACE_BYTES:
                deadline, n_bytes = clock() + self._stall_s, 0
            if piece:
                yield piece
