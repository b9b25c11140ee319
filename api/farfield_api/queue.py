"""A bare Celery client: the only place of the API that sends, always after the transaction has committed.

What cannot be sent is not lost: the reconciler finds the shard ready and undelivered.
"""

import logging

import sqlalchemy as sa
from celery import Celery
from farfield.stages import RUN_SHARD
from farfield.store.progress import Message
from kombu.exceptions import OperationalError

log = logging.getLogger(__name__)


class Queue:
    """Sends messages to the workers."""

    def __init__(self, broker_url: str, engine: sa.Engine) -> None:
        self.celery = Celery("farfield", broker=broker_url)
        self.celery.conf.update(
            task_serializer="json", task_ignore_result=True, broker_connection_timeout=2,
            # One try: a client waits for this answer, and the reconciler does not.
            broker_transport_options={"socket_connect_timeout": 2, "socket_timeout": 5, "max_retries": 1,
                                      "interval_start": 0, "interval_step": 0, "interval_max": 0},
        )  # fmt: skip
        self.engine = engine

    def check(self) -> None:
        """Raise where the broker does not answer."""
        with self.celery.connection_for_write(connect_timeout=1.0) as connection:
            connection.ensure_connection(max_retries=1, interval_start=0, interval_step=0)
            connection.default_channel.client.ping()

    def send(self, message: Message) -> None:
        """Tell a worker of the queue about the shard."""
        try:
            self.celery.send_task(
                RUN_SHARD, args=[message.shard_id], queue=message.queue, retry=False, ignore_result=True
            )
        except OperationalError:
            log.warning("the broker does not answer; the reconciler will send shard %s", message.shard_id)
