"""What a route may refuse, for the OpenAPI document: a status, the problem's schema and an example for each error.

What every route with a key may refuse is added to all of them once the app is made (`describe`); "default" stands for what
nobody foresaw.
"""

import inspect
from typing import Any

from farfield import errors
from farfield.errors import FarfieldError

from farfield_api import errors as ours
from farfield_api.errors import MEDIA_TYPE, PROBLEM_SCHEMA, STATUS

_REF = {"$ref": "#/components/schemas/Problem"}
_MADE_UP = {
    "digest": "9f86d081884c7d65", "job": "4f1c9a7e2b3d45f6", "state": "running", "key": "budget", "why": "must be positive",
    "scope": "submit", "limit": 4096, "what": "jobs", "used": 100, "n_jobs": 2, "name": "harbour", "headers": {}, "wait_s": 7,
    "tenant": "9e8d7c6b5a493827", "webhook": "0a1b2c3d4e5f6071", "delivery": "0a1b2c3d4e5f6071", "device": "0a1b2c3d4e5f6071",
    "placement": "town", "path": "manifest.json", "message": "it is empty", "code": "SceneEmpty", "advice": "Look at the export.",
    "most": 64, "upload": "0a1b2c3d4e5f6071", "seconds": 60, "offset": 0, "received": 33_554_432,
}  # fmt: skip
ABOUT = (
    "Every route but /livez, /readyz and POST /v1/session needs an API key or a session. An admin of the operator's tenant "
    "acts in another with the header `Farfield-Tenant: ID`, and reads all with `*`. Answers carry `RateLimit`; refusals are "
    "problems (RFC 9457) with a stable `code`; lists come in pages with `limit` and `cursor`; `If-None-Match` answers 304."
)
EVERYWHERE = (ours.KeyMissing, ours.KeyUnknown, ours.ScopeMissing, ours.TenantRefused, ours.RateLimited)
CHANGES = (ours.CsrfMissing,)


def refusals(*named: str | type[FarfieldError]) -> dict[int | str, dict[str, Any]]:
    """Return the `responses` of a route that may refuse with these errors (names of farfield.errors or of ours)."""
    found: dict[int | str, dict[str, Any]] = {}
    for error in named:
        cls = error if isinstance(error, type) else getattr(errors, error, None) or getattr(ours, error)
        add_refusal(found, cls)
    return found


def add_refusal(responses: dict[int | str, dict[str, Any]], cls: type[FarfieldError], *, text: bool = False) -> None:
    """Add an error to `responses`, beside others of its status; `text`: keys are text, as in the finished document."""
    status = next(STATUS[c] for c in cls.__mro__ if c in STATUS)
    at = responses.setdefault(str(status) if text else status, {"description": "", "content": {}})
    content = at.setdefault("content", {}).setdefault(MEDIA_TYPE, {"schema": _REF})
    content.setdefault("examples", {}).setdefault(cls.__name__, {"value": _example(cls, status)})
    names = [name for name in at["description"].split(", ") if name]
    if cls.__name__ not in names:
        at["description"] = ", ".join([*names, cls.__name__])


def _example(cls: type[FarfieldError], status: int) -> dict[str, Any]:
    parameters = list(inspect.signature(cls.__init__).parameters.values())[1:]
    plain = cls.__init__ is Exception.__init__ or any(p.kind is p.VAR_POSITIONAL for p in parameters)
    values = [
        _MADE_UP.get(p.name, 7 if p.annotation in (int, float) else "it") for p in parameters if p.default is p.empty
    ]
    error = cls("why it was refused") if plain else cls(*values)
    body = {"type": f"urn:farfield:error:{cls.__name__}", "title": cls.__name__, "status": status, "code": cls.__name__}
    return {**body, "detail": str(error), "advice": error.advice}


def describe(document: dict[str, Any], open_routes: set[tuple[str, str]]) -> None:
    """Finish the OpenAPI document: the problem's schema, how to sign in, and what every route may refuse.

    open_routes  (method, path) of those that need no key
    """
    document["info"]["description"] = ABOUT
    parts = document.setdefault("components", {})
    parts.setdefault("schemas", {})["Problem"] = PROBLEM_SCHEMA
    parts["securitySchemes"] = {
        "key": {"type": "http", "scheme": "bearer", "description": "an API key: ff_..."},
        "session": {"type": "apiKey", "in": "cookie", "name": "farfield_session",
                    "description": "of the pages; changes need X-CSRF-Token, too"},
    }  # fmt: skip
    document["security"] = [{"key": []}, {"session": []}]
    for path, methods in document["paths"].items():
        for method, operation in methods.items():
            if not isinstance(operation, dict) or "responses" not in operation:
                continue
            free = (method.upper(), path) in open_routes
            if free:
                operation["security"] = []
            _common(operation, changes=method not in ("get", "head"), free=free)


def _common(operation: dict[str, Any], *, changes: bool, free: bool) -> None:
    responses = operation["responses"]
    for cls in () if free else (*EVERYWHERE, *(CHANGES if changes else ())):
        add_refusal(responses, cls, text=True)
    problem = {"content": {MEDIA_TYPE: {"schema": _REF}}}
    if any(p["in"] == "path" for p in operation.get("parameters", ())):
        responses.setdefault("404", {"description": "NotFound", **problem})
    if "requestBody" in operation:
        responses.setdefault("400", {"description": "RequestRefused: the body cannot be read", **problem})
        responses.setdefault("413", {"description": "RequestTooLarge", **problem})
    if operation.get("parameters") or "requestBody" in operation:
        invalid = responses.setdefault("422", {"description": ""})
        if "application/json" in invalid.get("content", {}):  # FastAPI's own, which no route of ours answers
            del invalid["content"]["application/json"]
        invalid.setdefault("content", {}).setdefault(MEDIA_TYPE, {"schema": _REF}).setdefault("examples", {})[
            "RequestInvalid"
        ] = {"value": _INVALID}
        names = [n for n in invalid["description"].split(", ") if n not in ("", "Validation Error", "RequestInvalid")]
        invalid["description"] = ", ".join([*names, "RequestInvalid"])
    responses.setdefault("default", {"description": "A problem (RFC 9457)", **problem})


_INVALID = {
    "type": "urn:farfield:error:RequestInvalid", "title": "RequestInvalid", "status": 422, "code": "RequestInvalid",
    "detail": "query.limit: Input should be greater than or equal to 1",
    "advice": "See /v1/openapi.json for the form of the request.",
    "errors": [{"where": "query.limit", "what": "Input should be greater than or equal to 1"}],
}  # fmt: skip
