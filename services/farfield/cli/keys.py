"""`farfield keys list|create|rotate|revoke`: API keys, at the machine that holds the service's database. No key is needed.

The way in where the last admin key is lost or leaked, and to the first key of a new tenant. Over HTTP: /v1/keys, /v1/tenants.
"""

import argparse
import json
import re
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any

from farfield.cli.stored import add_stored, opened
from farfield.errors import SettingsInvalid

if TYPE_CHECKING:
    import sqlalchemy as sa

_SECONDS = {"h": 3600.0, "d": 86400.0, "w": 7 * 86400.0}


def add_parser(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add the verb."""
    parser = subparsers.add_parser("keys", help="make, list, rotate and revoke API keys of a service on this machine")
    actions = parser.add_subparsers(dest="action", required=True, metavar="ACTION")
    listing = actions.add_parser("list", help="all keys, newest first; never their secrets")
    making = actions.add_parser("create", help="make a key and print it: this once")
    making.add_argument("--name", required=True, help="what it is for")
    making.add_argument("--scopes", default="read,submit", metavar="A,B", help="of read, submit, admin (%(default)s)")
    making.add_argument("--expires", metavar="90d", help="hours, days or weeks until it ends (default: never)")
    turning = actions.add_parser("rotate", help="make a key of the same name and scopes; the old one ends")
    turning.add_argument("key", metavar="ID")
    turning.add_argument("--grace", default="0h", metavar="24h", help="how long the old one still works (%(default)s)")
    ending = actions.add_parser("revoke", help="end a key and its sessions, now")
    ending.add_argument("key", metavar="ID")
    for action in (listing, making):
        action.add_argument("--tenant", metavar="NAME", help="of this tenant; `create` makes it (default: default)")
    for action in (listing, making, turning, ending):
        add_stored(action)
        action.add_argument("--json", action="store_true", help="print JSON and nothing else")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Do it; exit 0."""
    with opened(args) as (engine, _):
        told = {"list": _list, "create": _create, "rotate": _rotate, "revoke": _revoke}[args.action](engine, args)
    if args.json:
        print(json.dumps(told))
    elif "keys" in told:
        for key in told["keys"]:
            print(f"{key['id']}  {key['tenant']:16} {','.join(key['scopes']):18} {key['state']:8} "
                  f"{key['last_used'] or 'never used':16}  {key['name']}")  # fmt: skip
    else:
        print(told.get("key", f"key {told['id']} is revoked"))
    return 0


def _list(engine: "sa.Engine", args: argparse.Namespace) -> dict[str, Any]:
    from farfield.store import tenants
    from farfield.store.pages import ALL

    names = {row.id: row.name for row in tenants.page_of_tenants(engine, before=None, limit=1_000_000)}
    rows = tenants.page_of_keys(engine, ALL, before=None, limit=1_000_000)
    now = datetime.now(UTC).timestamp()
    listed = [
        {
            "id": row.id, "tenant": names[row.tenant_id], "name": row.name, "scopes": row.scopes.split(),
            "state": "revoked" if row.revoked_at else "expired" if (row.expires_at or now + 1) < now else "valid",
            "created": _shown(row.created_at), "expires": _shown(row.expires_at), "last_used": _shown(row.last_used_at),
        }
        for row in rows
        if args.tenant in (None, names[row.tenant_id])
    ]  # fmt: skip
    return {"keys": listed}


def _create(engine: "sa.Engine", args: argparse.Namespace) -> dict[str, Any]:
    from farfield.store import tenants
    from farfield.store.tables import SCOPES

    scopes = [scope.strip() for scope in args.scopes.split(",") if scope.strip()]
    if not scopes or not set(scopes) <= set(SCOPES):
        raise SettingsInvalid("--scopes", f"{args.scopes!r} is not a list of {', '.join(SCOPES)}")
    lifetime_s = _seconds("--expires", args.expires) if args.expires else None
    name = args.tenant or "default"
    tenant_id = tenants.create_tenant(engine, name, operator=name == "default")
    key = tenants.create_key(engine, tenant_id, args.name, scopes, lifetime_s=lifetime_s)
    key_id = key.split("_")[1]
    _record(engine, tenant_id, "farfield keys create", key_id)
    return {"id": key_id, "tenant": name, "key": key}


def _rotate(engine: "sa.Engine", args: argparse.Namespace) -> dict[str, Any]:
    from farfield.store import tenants
    from farfield.store.pages import ALL

    tenant_id = tenants.get_key(engine, ALL, args.key).tenant_id
    key = tenants.rotate_key(engine, tenant_id, args.key, grace_s=_seconds("--grace", args.grace))
    _record(engine, tenant_id, "farfield keys rotate", args.key)
    return {"id": key.split("_")[1], "key": key}


def _revoke(engine: "sa.Engine", args: argparse.Namespace) -> dict[str, Any]:
    from farfield.store import tenants
    from farfield.store.pages import ALL

    tenant_id = tenants.get_key(engine, ALL, args.key).tenant_id
    tenants.revoke_key(engine, args.key)
    _record(engine, tenant_id, "farfield keys revoke", args.key)
    return {"id": args.key}


def _record(engine: "sa.Engine", tenant_id: str, action: str, key_id: str) -> None:
    from farfield.store import audit

    audit.record(
        engine, tenant_id, key_id=None, key_name=audit.AT_THE_MACHINE, address="local", action=action,
        target=f"/v1/keys/{key_id}", status=200,
    )  # fmt: skip


def _seconds(option: str, text: str) -> float:
    match = re.fullmatch(r"(\d{1,5})([hdw])", text)
    if match is None:
        raise SettingsInvalid(option, f"{text!r} is not like 12h, 90d or 4w")
    return int(match[1]) * _SECONDS[match[2]]


def _shown(at: float | None) -> str | None:
    return datetime.fromtimestamp(at, UTC).strftime("%Y-%m-%d %H:%M") if at is not None else None
