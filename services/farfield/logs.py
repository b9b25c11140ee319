"""Logs of every process: one line a record, as text or JSON, with what it is about; secrets are taken out last.

Context   `about(job=..., stage=...)` says what all records within concern, in this thread or task; a record's own fields
          come as `extra={"fields": {...}}`. Names: job, stage, shard, attempt, tenant, worker, request, seconds, status.
Form      FARFIELD_LOG=json: one object a line, keys `at`, `level`, `service`, `logger`, `message`, then the fields,
          `trace` for an exception. Anything else: text for people. FARFIELD_LOG_LEVEL: INFO unless told.
Secrets   API keys, bearer and basic credentials, passwords in URLs, login links and query strings are replaced in the
          finished line, whoever wrote them and wherever they stand: a traceback quotes what it likes.
"""

import contextvars
import json
import logging
import os
import re
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from datetime import UTC, datetime
from types import MappingProxyType
from typing import Any

_NOTHING: Mapping[str, Any] = MappingProxyType({})
_context: contextvars.ContextVar[Mapping[str, Any]] = contextvars.ContextVar("farfield_log_context", default=_NOTHING)

_NAMES = "farfield_session|x-csrf-token|aws_secret_access_key|password|secret"
_SECRETS = (
    (re.compile(r"ff_[0-9a-f]{32}_[\w-]+"), "ff_***"),
    (re.compile(r"whsec_[\w+/=-]+"), "whsec_***"),
    (re.compile(r"(?i)\b(bearer|basic)\s+[\w.~+/=-]{8,}"), r"\1 ***"),
    (re.compile(r"(\w[\w+.-]*://)[^\s/@]+@"), r"\1***@"),
    (re.compile(r"(login=)[\w-]+"), r"\1***"),
    (re.compile(rf"(?i)(\b(?:{_NAMES})\b[\"']?\s*[=:]\s*[\"']?)[^\s,;\"'}}]+"), r"\1***"),
    (re.compile(r"((?:https?|wss?)://[^\s?#\"']*|\s/[^\s?#\"']*)\?[^\s\"']*"), r"\1?***"),
)  # fmt: skip


def redacted(text: str) -> str:
    """Return `text` without what nobody should read in a log."""
    for pattern, instead in _SECRETS:
        text = pattern.sub(instead, text)
    return text


@contextmanager
def about(**fields: Any) -> Iterator[None]:
    """Say what the records within are about, in addition to what was said before; None takes a field out."""
    token = _context.set({**_context.get(), **fields})
    try:
        yield
    finally:
        _context.reset(token)


def say(**fields: Any) -> None:
    """Do what `about` does, until the end of this task or thread."""
    _context.set({**_context.get(), **fields})


def known(name: str) -> Any:
    """Return a field of the context, None where it has not been said."""
    return _context.get().get(name)


class _Formatter(logging.Formatter):
    def __init__(self, service: str) -> None:
        super().__init__()
        self.service = service

    def fields(self, record: logging.LogRecord) -> dict[str, Any]:
        found = {**_context.get(), **getattr(record, "fields", {})}
        return {name: value for name, value in found.items() if value is not None}

    def at(self, record: logging.LogRecord) -> str:
        moment = datetime.fromtimestamp(record.created, UTC)
        return moment.isoformat(timespec="milliseconds").replace("+00:00", "Z")


class Text(_Formatter):
    """2026-01-31T09:15:00.000Z worker INFO done stage=bake shard=3 seconds=1.2"""

    def format(self, record: logging.LogRecord) -> str:
        words = [self.at(record), self.service, record.levelname, record.getMessage()]
        words += [f"{name}={value}" for name, value in self.fields(record).items()]
        if record.exc_info:
            words.append("\n" + self.formatException(record.exc_info))
        return redacted(" ".join(words))


class Json(_Formatter):
    """One object a line."""

    def format(self, record: logging.LogRecord) -> str:
        line = {
            "at": self.at(record), "level": record.levelname, "service": self.service, "logger": record.name,
            "message": record.getMessage(), **self.fields(record),
        }  # fmt: skip
        if record.exc_info:
            line["trace"] = self.formatException(record.exc_info)
        return json.dumps({k: redacted(v) if isinstance(v, str) else v for k, v in line.items()}, default=_plain)


def _plain(value: Any) -> str:
    return redacted(str(value))


def configure(service: str, environment: Mapping[str, str] = os.environ) -> None:
    """Send all records of this process to stderr in the form that FARFIELD_LOG asks for."""
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(Json(service) if environment.get("FARFIELD_LOG") == "json" else Text(service))
    root = logging.getLogger()
    root.handlers[:] = [handler]
    level = environment.get("FARFIELD_LOG_LEVEL", "INFO").upper()
    root.setLevel(level if level in logging.getLevelNamesMapping() else "INFO")
    for name in ("httpx", "httpcore", "botocore", "boto3", "s3transfer", "urllib3", "alembic", "numba", "kombu"):
        logging.getLogger(name).setLevel(logging.WARNING)
    logging.captureWarnings(True)
