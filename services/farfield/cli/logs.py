"""`farfield logs JOB --url URL`: what happened in a job, a line an event; with --follow, until it ends."""

import argparse
import json
from typing import Any

from farfield.cli.connect import DONE, NOT_VALID, add_service, call
from farfield.client import ENDED, Client


def add_parser(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add the verb."""
    parser = subparsers.add_parser("logs", help="show what happened in a job")
    parser.add_argument("job", metavar="JOB")
    add_service(parser)
    parser.add_argument("--follow", action="store_true", help="go on until the job ends; exit 4 if it does not succeed")
    parser.add_argument("--json", action="store_true", help="print a JSON object a line")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Print the events; exit 0, or with --follow 4 for a job that failed or was cancelled."""

    def show(service: Client) -> int:
        state = ""
        if not args.follow:
            for event in service.past_events(args.job):
                _print(event["kind"], {**event["data"], "at": event["at"]}, args.json)
            return DONE
        for kind, data in service.events(args.job):
            _print(kind, data, args.json)
            state = data["state"] if kind == "job" else state
        state = state if state in ENDED else service.job(args.job)["state"]
        return DONE if state == "done" else NOT_VALID

    return call(args, show)


def _print(kind: str, data: dict[str, Any], as_json: bool) -> None:
    if as_json:
        print(json.dumps({"kind": kind, **data}), flush=True)
        return
    what = " ".join(str(data[key]) for key in ("stage", "kind", "ordinal", "state") if data.get(key) is not None)
    error = data.get("error") or {}
    if kind == "progress" and "bytes" in data:
        what += f" {data['bytes'] / 1e6:.1f} MB chosen" + (
            f", {data['unsolved']} views unsolved" if "unsolved" in data else ""
        )
    more = [
        f"skipped: {data['skipped']}" if data.get("skipped") else "",
        f"verdict {data['verdict']}" if data.get("verdict") else "",
        "reused" if data.get("cached") else f"{data['seconds']:.2f} s" if data.get("seconds") is not None else "",
        f"{error.get('code')}: {error.get('message')}" if error else "",
    ]
    print(" ".join([data.get("at", ""), kind, what, *filter(None, more)]), flush=True)
