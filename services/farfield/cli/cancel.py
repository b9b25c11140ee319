"""`farfield cancel JOB --url URL`: stop a job; what is done stays."""

import argparse
import json

from farfield.cli.connect import DONE, add_service, call
from farfield.client import Client


def add_parser(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add the verb."""
    parser = subparsers.add_parser("cancel", help="stop a job of a service")
    parser.add_argument("job", metavar="JOB")
    add_service(parser)
    parser.add_argument("--json", action="store_true", help="print the job as JSON and nothing else")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Do it and print the job's state; exit 0."""

    def act(service: Client) -> int:
        job = service.cancel(args.job)
        print(json.dumps(job) if args.json else f"job {job['id']} is {job['state']}")
        return DONE

    return call(args, act)
