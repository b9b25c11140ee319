"""`farfield migrate`: make a fleet's database, bucket and first key ready; the launcher of one machine does it by itself."""

import argparse
import os
from pathlib import Path


def add_parser(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add the verb."""
    parser = subparsers.add_parser(
        "migrate", help="bring a fleet's database up to date (FARFIELD_DATABASE_URL), also while it works"
    )
    parser.add_argument("--to", default="head", metavar="REVISION", help="version of the tables (default: the newest)")
    parser.add_argument(
        "--patience-s", type=float, default=600.0, metavar="S",
        help="give up when the tables were too busy for so long (default: %(default).0f)",
    )  # fmt: skip
    parser.add_argument("--make-bucket", action="store_true", help="also make the bucket of FARFIELD_ARTIFACTS")
    parser.add_argument(
        "--first-key", action="store_true", help="where no key is valid, make one of the operator's and print it"
    )
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Migrate, and do what else was asked for."""
    from farfield.errors import ServiceError
    from farfield.store import tenants
    from farfield.store.artifacts import open_artifacts
    from farfield.store.engine import open_engine
    from farfield.store.migrate import migrate

    if "FARFIELD_DATABASE_URL" not in os.environ:
        raise ServiceError("set FARFIELD_DATABASE_URL; `farfield serve` migrates its own database")
    if args.make_bucket and "FARFIELD_ARTIFACTS" not in os.environ:
        raise ServiceError("set FARFIELD_ARTIFACTS to the address of the bucket to make")
    engine = open_engine(os.environ["FARFIELD_DATABASE_URL"])
    folder = Path(os.environ.get("FARFIELD_MIGRATIONS", Path(__file__).resolve().parents[3] / "migrations"))
    migrate(engine, folder, revision=args.to, patience_s=args.patience_s)
    if args.make_bucket:
        cache = os.environ.get("FARFIELD_CACHE")
        open_artifacts(os.environ["FARFIELD_ARTIFACTS"], cache=Path(cache) if cache else None).make()
    if args.first_key and not tenants.has_keys(engine):
        tenant_id = tenants.create_tenant(engine, "default", operator=True)
        print(tenants.create_key(engine, tenant_id, "made by farfield migrate", ("read", "submit", "admin")))
    engine.dispose()
    return 0
