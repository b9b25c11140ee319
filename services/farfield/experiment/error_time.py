"""`farfield experiment error-time`: what each knob's run time buys in error; the truth is never made by what is judged."""

import argparse
import time
from typing import Any

from farfield.experiment.document import Job, document

HELP = "for each knob, seconds of preprocessing against the error that they buy"
SAID = ()


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add what only this experiment asks."""


def build(job: Job, args: argparse.Namespace) -> dict[str, Any]:
    """Return the document."""
    started = time.monotonic()
    return document("error-time", "Error against run time", job, [], seconds=time.monotonic() - started)
