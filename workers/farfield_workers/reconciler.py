"""Makes true what the tables say: sends what is ready and undelivered or whose lease ran out, moves on what stands.

Nothing relies on the broker's redelivery: a flushed broker costs one round of this loop.
"""

import logging
import signal
import threading

import sqlalchemy as sa
from farfield.store import progress

from farfield_workers.app import artifacts, engine, pipeline, send

EVERY_S = 2.0

log = logging.getLogger(__name__)


def reconcile() -> int:
    """Do one round and return how many messages it sent."""
    messages = progress.undelivered(engine())
    send(messages)  # before anything can fail: they are marked as sent
    number = len(messages)
    for job_id in progress.standing_still(engine()):
        try:
            messages = progress.advance(engine(), artifacts(), job_id, pipeline().kinds())
        except sa.exc.OperationalError:
            raise
        except Exception:  # one job that cannot move, such as with a lost artifact, must not hold up the others
            log.exception("job %s cannot be moved on", job_id)
            continue
        send(messages)
        number += len(messages)
    return number


def main() -> None:
    """Reconcile until SIGTERM or SIGINT."""
    logging.basicConfig(level=logging.INFO, format="%(asctime)s reconciler %(levelname)s %(message)s")
    stop = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: stop.set())
    while not stop.wait(EVERY_S):
        try:
            sent = reconcile()
            if sent:
                log.info("sent %d messages", sent)
        except sa.exc.OperationalError:
            log.warning("the database does not answer", exc_info=True)


if __name__ == "__main__":
    main()
