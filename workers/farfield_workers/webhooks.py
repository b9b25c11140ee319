"""Delivers what is to be told to webhooks: takes a delivery from the table, posts it, writes down how that went.

Problem  Receivers are slow, broken or hostile, and given to us by clients; the reconciler, in whose process this runs, must
         neither wait for them nor be led by them to an address inside our network.
Method   A few threads, of which one receiver gets two at most. Every attempt resolves the host anew, refuses what is not
         public (farfield.webhooks) and connects to an address that was looked at: no second look-up, no proxy, no redirect.
         An attempt has one deadline for all of it, so that a byte now and then buys no time; of the answer nothing is read
         but its status. What is lost with a killed process is due again when its lease in the table ends: sent at least once.
"""

import logging
import ssl
import threading
import time
from collections import Counter
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import httpcore
import sqlalchemy as sa
from farfield.errors import WebhookAddressRefused
from farfield.store import sealed, webhooks
from farfield.store.webhooks import LEASE_S, Delivery
from farfield.webhooks import Endpoint, Network, resolve, sign

EVERY_S = 1.0
DEADLINE_S = 15.0
SLOTS = 8
SLOTS_EACH = 2
TRIED_ADDRESSES = 3
FORGET_EVERY_S = 3600.0

log = logging.getLogger(__name__)

assert DEADLINE_S < LEASE_S


class Postman:
    """Delivers from one process; any number of processes may."""

    def __init__(
        self, engine: sa.Engine, networks: Sequence[Network], *, key: str | None = None, trust: ssl.SSLContext | None = None
    ) -> None:  # fmt: skip
        """Deliver to receivers of the open Internet and of `networks`.

        key    with which their secrets are sealed
        trust  instead of the system's roots
        """
        self.engine, self.networks, self.key = engine, networks, key
        self.trust = trust or ssl.create_default_context()
        self._pool = ThreadPoolExecutor(SLOTS, thread_name_prefix="webhook")
        self._lock = threading.Lock()
        self._busy: Counter[str] = Counter()
        self._forget_at = 0.0

    def run(self, stop: threading.Event) -> None:
        """Deliver until `stop` is set."""
        while not stop.wait(EVERY_S):
            try:
                self.round()
                if time.monotonic() > self._forget_at:
                    self._forget_at = time.monotonic() + FORGET_EVERY_S
                    webhooks.forget_old(self.engine)
                    sealed.seal_all(self.engine, self.key)
            except sa.exc.SQLAlchemyError:
                log.warning("webhooks wait: the database does not answer", exc_info=True)
        self._pool.shutdown(wait=False, cancel_futures=True)

    def round(self) -> int:
        """Begin as many deliveries as are due and have a free thread; return how many."""
        number = 0
        while True:
            with self._lock:
                if sum(self._busy.values()) >= SLOTS:
                    return number
                full = [webhook_id for webhook_id, n in self._busy.items() if n >= SLOTS_EACH]
            due = webhooks.claim(self.engine, but=full)
            if due is None:
                return number
            with self._lock:
                self._busy[due.webhook_id] += 1
            self._pool.submit(self._deliver, due)
            number += 1

    def wait(self) -> None:
        """Wait until what has begun has ended."""
        while True:
            with self._lock:
                if not self._busy:
                    return
            time.sleep(0.01)

    def _deliver(self, due: Delivery) -> None:
        status, error = None, None
        try:
            status = post(resolve(due.url, self.networks), due, self.trust, key=self.key)
        except WebhookAddressRefused as refused:
            error = str(refused)
        except (OSError, httpcore.NetworkError, httpcore.TimeoutException, httpcore.ProtocolError) as failed:
            error = _told(failed)
        except Exception:  # unforeseen, it counts as well: what is not finished comes again without end
            log.exception("delivery %s", due.id)
            error = "the delivery failed"
        try:
            webhooks.finish(self.engine, due, status=status, error=error)
        except sa.exc.SQLAlchemyError:
            log.warning("how delivery %s went could not be written: it comes again", due.id, exc_info=True)
        finally:
            with self._lock:
                self._busy[due.webhook_id] -= 1
                self._busy += Counter()  # forgets who has none
        log.info("delivery %s to webhook %s, attempt %d: %s", due.id, due.webhook_id, due.attempt, status or error)


def post(to: Endpoint, due: Delivery, trust: ssl.SSLContext, *, key: str | None = None) -> int:
    """Post the delivery and return the status of the answer. Raises OSError, httpcore's errors, and ServiceError."""
    shown = f"[{to.host}]" if ":" in to.host else to.host
    standard = 443 if to.secure else 80
    headers = {
        "host": shown if to.port == standard else f"{shown}:{to.port}", "user-agent": "farfield-webhooks/1",
        "content-type": "application/json", "content-length": str(len(due.body)),
        **sign(due.secrets(key), due.id, due.body, at=int(time.time())),
    }  # fmt: skip
    scheme = b"https" if to.secure else b"http"
    url = httpcore.URL(scheme=scheme, host=to.host.encode(), port=to.port, target=to.target.encode())
    backend = _Pinned(to.addresses[:TRIED_ADDRESSES], time.monotonic() + DEADLINE_S)
    sent = [(name.encode(), value.encode()) for name, value in headers.items()]
    with (
        httpcore.ConnectionPool(ssl_context=trust, network_backend=backend, max_connections=1, retries=0) as pool,
        pool.stream("POST", url, headers=sent, content=due.body) as answer,
    ):
        return answer.status


def _told(error: Exception) -> str:
    """Return what the owner of the webhook may read: nothing of our network."""
    if isinstance(error, (httpcore.TimeoutException, TimeoutError)):
        return f"there was no answer within {DEADLINE_S:.0f} s"
    if "CERTIFICATE" in str(error).upper():
        return "the certificate is not valid for this host"
    if isinstance(error, httpcore.ConnectError):
        return "the connection was refused or failed"
    return "the connection ended before there was an answer"


class _Stream(httpcore.NetworkStream):
    """A connection that ends at a point in time, however often it is read."""

    def __init__(self, inner: httpcore.NetworkStream, deadline: float) -> None:
        self.inner, self.deadline = inner, deadline

    def read(self, max_bytes: int, timeout: float | None = None) -> bytes:
        return self.inner.read(max_bytes, timeout=_left(self.deadline))

    def write(self, buffer: bytes, timeout: float | None = None) -> None:
        self.inner.write(buffer, timeout=_left(self.deadline))

    def close(self) -> None:
        self.inner.close()

    def start_tls(
        self, ssl_context: ssl.SSLContext, server_hostname: str | None = None, timeout: float | None = None
    ) -> httpcore.NetworkStream:
        secured = self.inner.start_tls(ssl_context, server_hostname, timeout=_left(self.deadline))
        return _Stream(secured, self.deadline)

    def get_extra_info(self, info: str) -> Any:
        return self.inner.get_extra_info(info)


class _Pinned(httpcore.NetworkBackend):
    """Connects to the given addresses, whatever name it is asked for."""

    def __init__(self, addresses: Sequence[str], deadline: float) -> None:
        self.addresses, self.deadline, self.inner = addresses, deadline, httpcore.SyncBackend()

    def connect_tcp(
        self, host: str, port: int, timeout: float | None = None, local_address: str | None = None,
        socket_options: Iterable[Any] | None = None,
    ) -> httpcore.NetworkStream:  # fmt: skip
        failed: Exception | None = None
        for address in self.addresses:
            try:
                return _Stream(self.inner.connect_tcp(address, port, timeout=_left(self.deadline)), self.deadline)
            except httpcore.ConnectError as error:
                failed = error
        raise failed or httpcore.ConnectError("there is no address")


def _left(deadline: float) -> float:
    left = deadline - time.monotonic()
    if left <= 0:
        raise httpcore.ReadTimeout("the deadline has passed")
    return left
