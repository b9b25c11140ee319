"""Shards in, artifacts out: the Celery shell around the pipeline, the reconciler, the launcher of `farfield serve`."""
