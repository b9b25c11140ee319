"""`farfield experiment table1`: the sixteen tests of Table 1 [I3D 2005] on a level of yours."""

import argparse
import time
from typing import Any

from farfield.experiment.document import Job, document

HELP = "the sixteen tests of the paper on this level, their ratios beside ours"
SAID = ()


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add what only this experiment asks."""


def build(job: Job, args: argparse.Namespace) -> dict[str, Any]:
    """Return the document."""
    started = time.monotonic()
    return document("table1", "The sixteen tests", job, [], seconds=time.monotonic() - started)
