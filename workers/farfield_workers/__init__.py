"""Celery workers of farfield: a thin shell that runs the shards of `farfield.pipeline`."""
