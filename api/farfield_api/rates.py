"""How often a key may ask: a limit for what reads and one for what changes, told in every answer.

Counted in this process, or in Redis where there are several (FARFIELD_RATE_STORE). A store that does not answer lets
everybody through: limits protect the service from haste, keys from strangers.
"""

import logging
import time
from dataclasses import dataclass

import limits
from limits.storage import storage_from_string
from limits.strategies import SlidingWindowCounterRateLimiter

from farfield_api.errors import RateLimited

log = logging.getLogger(__name__)

TIMEOUT_S = 0.5  # a request never waits longer for the store
PAUSE_S = 5.0  # for so long a store that failed is not asked again


@dataclass(frozen=True, slots=True)
class Rate:
    """What is left of a limit."""

    name: str
    limit: int
    window_s: int
    remaining: int
    reset_s: int

    @property
    def headers(self) -> dict[str, str]:
        """The fields of draft-ietf-httpapi-ratelimit-headers-10."""
        return {
            "ratelimit-policy": f'"{self.name}";q={self.limit};w={self.window_s}',
            "ratelimit": f'"{self.name}";r={self.remaining};t={self.reset_s}',
        }


class RateLimits:
    """The limits of all keys; `read` and `write` such as "600/minute", or empty for none."""

    def __init__(self, *, read: str, write: str, store: str) -> None:
        self._items = {name: limits.parse(text) for name, text in (("read", read), ("write", write)) if text}
        redis = {"socket_timeout": TIMEOUT_S, "socket_connect_timeout": TIMEOUT_S} if store != "memory://" else {}
        self._limiter = SlidingWindowCounterRateLimiter(storage_from_string(store, **redis))
        self._asleep_until = 0.0

    def spend(self, key_id: str, *, name: str) -> Rate | None:
        """Count a request of the key against the limit `name`; None where there is no limit. Raises RateLimited."""
        item = self._items.get(name)
        if item is None or time.monotonic() < self._asleep_until:
            return None
        try:
            allowed = self._limiter.hit(item, name, key_id)
            left = self._limiter.get_window_stats(item, name, key_id)
        except Exception:  # of whatever store
            log.warning("the store of the rate limits does not answer: nobody is limited", exc_info=True)
            self._asleep_until = time.monotonic() + PAUSE_S
            return None
        reset_s = max(1, round(left.reset_time - time.time()))
        rate = Rate(name, item.amount, item.get_expiry(), max(left.remaining, 0) if allowed else 0, reset_s)
        if not allowed:
            raise RateLimited(rate.headers, reset_s)
        return rate
