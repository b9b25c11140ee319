"""The certificate: what was tried against a placement, in a file that says what it speaks of (certificate.json).

It names the placement by the digests of its manifest (which holds those of all other files) and of scene.glb, so that one
that has gone stale shows. Same placement, same arguments, same versions: same bytes. No clock and no name of a machine.
"""

import json
import os
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any

from farfield.placementdb.read import Placement

NAME, FORMAT, VERSION = "certificate.json", "farfield certificate", 1


def build_certificate(folder: Path, found: Mapping[str, Any], *, refuted: bool) -> dict[str, Any]:
    """Return the certificate of `found` (what `verify` returned, with `proof` where pictures were compared)."""
    manifest = Placement.open(folder / "placement").manifest
    provenance = manifest["provenance"]
    return {
        "format": FORMAT, "version": VERSION, "refuted": refuted, "found": dict(found),
        "of": {
            "manifest_sha256": manifest["manifest_sha256"],
            "scene_sha256": (manifest["scene"] or {}).get("sha256"), "inputs": provenance["inputs"],
        },
        "settings": provenance["settings"],
        "software": {
            "placed_with": provenance["software"], "placement_format": manifest["version"],
            "verified_with": {name: version(name) for name in ("farfield", "numpy", "numba")},
        },
    }  # fmt: skip


def write_certificate(folder: Path, certificate: Mapping[str, Any]) -> Path:
    """Write certificate.json beside the placement, never half of it. Raises OSError."""
    path = folder / NAME
    text = json.dumps(certificate, indent=1, sort_keys=True, allow_nan=False) + "\n"
    part = path.with_name(f"{NAME}.{os.getpid()}.part")
    try:
        part.write_text(text, encoding="utf-8")
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)
    return path
