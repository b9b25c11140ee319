"""The table of contents: every stage once, in order.

A stage is a pure function of content-addressed inputs, cut into shards. Whoever runs the pipeline (spawned processes of
`farfield place`, Celery workers of the service) walks this table and nothing else:

    skip    a reason not to run, or None; asked first. A skipped stage still has an output (`run` of an empty plan).
    plan    the shards: JSON values, named by content and place, never by worker or count of workers
    run     one shard -> bytes (an artifact)
    merge   the shards' artifacts, in plan order -> the stage's artifact; with one shard and no merge it is that shard's

Inputs are artifacts of earlier stages as buffers (bytes or memory maps), keyed by stage, and the settings.
"""
