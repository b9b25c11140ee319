"""If-Match: change a thing only where it still is what the client has seen."""

from fastapi import Request
from pydantic import BaseModel

from farfield_api.answers import etag_of, matches
from farfield_api.errors import PreconditionFailed


def etag_of_shown(shown: BaseModel) -> str:
    """Return the ETag of a thing as it is shown."""
    return etag_of(shown.model_dump_json().encode())


def expect_match(request: Request, shown: BaseModel) -> None:
    """Raise PreconditionFailed where the request has an If-Match without the ETag of the thing as it is now."""
    header = request.headers.get("if-match")
    if header is not None and not matches(header, etag_of_shown(shown)):
        raise PreconditionFailed
