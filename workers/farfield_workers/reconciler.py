"""Makes true what the tables say: takes back what lost its lease, moves on what stands still, wakes who could work.

Nothing relies on the broker's redelivery: a flushed broker costs one round of this loop.
"""

import logging
import signal
import threading

from farfield import logs
from farfield.stages import Queue
from farfield.store import progress

from farfield_workers.app import artifacts, engine, pipeline, settings, wake
from farfield_workers.lease import UNREACHABLE
from farfield_workers.upkeep import Upkeep, from_environment
from farfield_workers.webhooks import Postman
from farfield_workers.work import advance

EVERY_S = 2.0

log = logging.getLogger(__name__)


def reconcile() -> int:
    """Do one round and return how many messages it sent."""
    taken = progress.reclaim(engine(), lease_s=settings().lease_s)
    if taken:
        log.warning("took back %d shards whose workers did not renew their leases", taken)
    for job_id in progress.standing_still(engine()):
        try:
            advance(engine(), artifacts(), pipeline(), settings(), job_id)
        except UNREACHABLE:
            raise
        except Exception:  # one job that cannot move, such as with a lost artifact, must not hold up the others
            log.exception("job %s cannot be moved on", job_id)
    return wake(map(str, Queue))


def main() -> None:
    """Reconcile until SIGTERM or SIGINT."""
    logs.configure("reconciler")
    stop = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: stop.set())
    upkeep = Upkeep(engine(), artifacts(), from_environment())
    upkeep.start()
    postman = Postman(engine(), settings().webhook_networks, key=settings().webhook_key)
    threading.Thread(target=postman.run, args=(stop,), name="webhooks", daemon=True).start()
    while not stop.wait(EVERY_S):
        try:
            sent = reconcile()
            upkeep.round(sent)
            if sent:
                log.info("sent %d messages", sent)
        except UNREACHABLE:
            log.warning("the database does not answer", exc_info=True)
    upkeep.stop()


if __name__ == "__main__":
    main()
