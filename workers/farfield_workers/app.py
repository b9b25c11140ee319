"""The Celery app: queues, signals, and the one task. Nothing here knows a stage.

Baking needs an OpenGL context, which must never exist in a process that forks: workers run with `-P solo`, one process
a slot. A message may come twice, late or never; the tables decide, and the reconciler sends again.
"""

import functools
import logging
from collections.abc import Iterable

import sqlalchemy as sa
from celery import Celery
from celery.signals import worker_process_init
from farfield.stages import RUN_SHARD
from farfield.store import progress
from farfield.store.artifacts import Artifacts, open_artifacts
from farfield.store.engine import open_engine
from farfield.store.progress import Message
from kombu.exceptions import OperationalError

from farfield_workers.settings import WorkerSettings, from_environment
from farfield_workers.table import Pipeline, load_pipeline
from farfield_workers.work import work

log = logging.getLogger(__name__)


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


@app.task(name=RUN_SHARD)
def run_shard(shard_id: str) -> None:
    """Run one shard. Safe to run twice: what is done is found done."""
    send(work(engine(), artifacts(), pipeline(), settings(), shard_id))


def send(messages: Iterable[Message]) -> None:
    """Hand the messages to the broker; where it does not answer, the reconciler sends them later."""
    sent = []
    try:
        for message in messages:
            app.send_task(RUN_SHARD, args=[message.shard_id], queue=message.queue)
            sent.append(message.shard_id)
    except OperationalError:
        log.warning("the broker does not answer; the reconciler will send again")
    if sent:
        progress.mark_sent(engine(), sent)
