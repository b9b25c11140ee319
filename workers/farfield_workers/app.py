"""The Celery app: queues, signals, and the one task. Nothing here knows a stage.

Baking needs an OpenGL context, which must never exist in a process that forks: workers run with `-P solo`, one process
a slot. A message may come twice, late or never; the tables decide, and the reconciler sends again.
"""

import functools
import logging
import socket
import time
from collections.abc import Callable, Iterable
from functools import partial
from typing import Any

import sqlalchemy as sa
from celery import Celery
from celery.signals import setup_logging, worker_process_init, worker_ready, worker_shutdown
from farfield import logs
from farfield.stages import RUN_SHARD, Queue
from farfield.store import progress
from farfield.store.artifacts import Artifacts, open_artifacts
from farfield.store.engine import GONE_S, open_engine
from farfield.store.progress import WINDOW
from kombu.exceptions import OperationalError

from farfield_workers import telemetry
from farfield_workers.lease import UNREACHABLE
from farfield_workers.settings import WorkerSettings, from_environment
from farfield_workers.table import Pipeline, load_pipeline
from farfield_workers.work import work_next

log = logging.getLogger(__name__)

TURN_S = 1.0
BROKER_AWAY = (OperationalError, ConnectionError, TimeoutError)


@functools.cache
def settings() -> WorkerSettings:
    return from_environment()


@functools.cache
def engine() -> sa.Engine:
    return open_engine(settings().database_url)


@functools.cache
def pipeline() -> Pipeline:
    return load_pipeline(settings().pipeline)


@functools.cache
def artifacts() -> Artifacts:
    return open_artifacts(settings().artifacts, cache=settings().cache, cache_bytes=settings().cache_bytes)


app = Celery("farfield", broker=settings().broker_url)
app.conf.update(
    accept_content=["json"],
    broker_connection_max_retries=None,
    broker_connection_retry_on_startup=True,
    broker_transport_options={
        "socket_connect_timeout": 10,
        "socket_keepalive": True,
        # A broker that acknowledges nothing is gone: else a host that was cut off waits a quarter of an hour for it.
        "socket_keepalive_options": {
            socket.TCP_KEEPIDLE: GONE_S // 2,
            socket.TCP_KEEPINTVL: 5,
            socket.TCP_KEEPCNT: 2,
            socket.TCP_USER_TIMEOUT: GONE_S * 1000,
        },
    },
    task_acks_late=True,
    task_default_queue="cpu",
    task_ignore_result=True,
    task_serializer="json",
    worker_enable_remote_control=False,
    worker_hijack_root_logger=False,
    worker_prefetch_multiplier=1,
    worker_send_task_events=False,
)


@worker_process_init.connect
def after_fork(**_: object) -> None:
    """Forget the parent's connections without closing them: they are still the parent's."""
    engine().dispose(close=False)


@setup_logging.connect
def write_logs(**_: object) -> None:
    logs.configure("worker")
    logs.say(worker=settings().worker)


@worker_ready.connect
def tell_of_us(sender: Any, **_: object) -> None:
    queues = tuple(sorted(sender.app.amqp.queues.consume_from))
    if queues == (str(Queue.GL),):  # a baker: it will need the context in any case
        prepare_baker()
    telemetry.here.start(engine(), name=settings().worker, host=settings().host, queues=queues)


@worker_shutdown.connect
def tell_of_our_end(**_: object) -> None:
    telemetry.here.stop(engine())


def prepare_baker() -> None:
    """Make the OpenGL context, so that the renderer is known from the start; without one, numba bakes the same."""
    from farfield.bake.gl.context import NoContext, context

    try:
        context()
    except NoContext as error:
        log.warning("no OpenGL: %s", error)


@app.task(name=RUN_SHARD)
def run_shard(shard_id: str = "") -> None:
    """Run what the message's queue holds next, for TURN_S at least; which shard it was sent for matters to nobody.

    Many small shards a message: Celery takes as long for one as the tables do.
    """
    queue = (run_shard.request.delivery_info or {}).get("routing_key") or str(Queue.CPU)
    end = time.monotonic() + TURN_S
    claimed: Callable[[], object] = partial(wake, [queue])  # who else could work on it
    while (messages := work_next(engine(), artifacts(), pipeline(), settings(), queue, claimed=claimed)) is not None:
        claimed = bool
        ours = [message for message in messages if message.queue == queue]  # we take one of them ourselves
        wake({message.queue for message in messages if message.queue != queue or len(ours) > 1})
        if time.monotonic() > end:
            wake([queue])
            return


def wake(queues: Iterable[str]) -> int:
    """See that each queue has a message for every shard that is ready, up to WINDOW; return how many were sent.

    The broker is asked how many it has: one that forgot them all, or whose messages were taken by workers that died,
    is filled again by whoever asks next, the reconciler at the latest.
    """
    number = 0
    try:
        with app.producer_pool.acquire(block=True) as producer:
            for queue in queues:
                depth = _depth(producer.channel, queue)
                missing = progress.waiting(engine(), queue) - depth if depth < WINDOW // 2 else 0
                for _ in range(missing):
                    app.send_task(RUN_SHARD, queue=queue, producer=producer)
                number += max(missing, 0)
    except BROKER_AWAY:
        log.warning("the broker does not answer; the reconciler will wake the workers")
    except UNREACHABLE:
        log.warning("the database does not answer; the reconciler will wake the workers")
    return number


def _depth(channel: Any, queue: str) -> int:
    """Return how many messages wait in the queue; one that nobody has sent to yet is not there."""
    try:
        return int(channel.queue_declare(queue, passive=True).message_count)
    except channel.connection.client.channel_errors:
        return 0
