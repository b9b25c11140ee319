"""GLB files with another JSON document, for the relations of placements on real levels."""

import json
from collections.abc import Callable
from typing import Any

import numpy as np
from levels import pack_glb


def edited(glb: bytes, edit: Callable[[dict[str, Any]], None]) -> bytes:
    """Return a GLB whose JSON document `edit` has changed in place."""
    size = int.from_bytes(glb[12:16], "little")
    document = json.loads(glb[20 : 20 + size])
    edit(document)
    return pack_glb(json.dumps(document).encode(), glb[28 + size :])


def shuffled_nodes(document: dict[str, Any]) -> None:
    """Give the nodes of a flat glTF document another order."""
    order = np.random.default_rng(0).permutation(len(document["nodes"])).tolist()
    document["nodes"] = [document["nodes"][i] for i in order]
