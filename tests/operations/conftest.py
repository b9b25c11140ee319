"""Tests of the service as it is run: real processes, a real PostgreSQL."""

from servers import postgres as postgres
