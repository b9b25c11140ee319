"""Processes that take blobs into use and give them up while others collect: whoever holds a reference must find its blob.

python store_race.py use DATABASE_URL ARTIFACTS SEED ROUNDS   prints how often it stored, found its blob, was refused
python store_race.py collect DATABASE_URL ARTIFACTS SEED STOP prints how many it removed, once the file STOP is there
"""

import json
import random
import sys
import time
from pathlib import Path

import sqlalchemy as sa
from farfield.errors import ArtifactMissing
from farfield.store import collect, scenes, tenants
from farfield.store.artifacts import open_artifacts
from farfield.store.engine import open_engine, write
from farfield.store.tables import scene

CONTENTS = 5  # few, so that equal bytes are stored, used and collected at the same moment


def use(engine, artifacts, dice, rounds):
    """Store one of a few contents, wait as a worker does between its put and its commit, commit, look, give it up."""
    tenant = tenants.create_tenant(engine, f"user {dice.random()}")
    told = {"stored": 0, "found": 0, "refused": 0, "lost": 0}
    for _ in range(int(rounds)):
        data = f"content {dice.randrange(CONTENTS)}".encode()
        digest = artifacts.put(data)
        told["stored"] += 1
        time.sleep(dice.choice((0.0, 0.0, 0.002, 0.01)))
        try:
            scenes.add(
                engine, tenant, digest=digest, name="a", suffix=".glb", n_bytes=len(data), summary={},
                inspect_digest=digest, inspect_bytes=len(data), check=artifacts.has,
            )  # fmt: skip
        except ArtifactMissing:
            told["refused"] += 1
            continue
        for _ in range(dice.randrange(3)):
            time.sleep(dice.choice((0.0, 0.005)))
            told["found" if artifacts.has(digest) else "lost"] += 1
        with write(engine) as tx:
            tx.execute(sa.delete(scene).where(scene.c.tenant_id == tenant, scene.c.digest == digest))
    return told


def gather(engine, artifacts, dice, stop):
    """Collect without any grace, again and again: the protocol alone must hold."""
    told = {"removed": 0}
    while not Path(stop).exists():
        if dice.random() < 0.5:
            collect.adopt(engine, artifacts)
        collect.mark(engine)
        time.sleep(dice.choice((0.0, 0.002)))
        told["removed"] += collect.sweep(engine, artifacts, grace_s=0.0).removed
    return told


def main(act, url, store, seed, until):
    engine, artifacts = open_engine(url), open_artifacts(store)
    print(json.dumps((use if act == "use" else gather)(engine, artifacts, random.Random(int(seed)), until)))


if __name__ == "__main__":
    main(*sys.argv[1:])
