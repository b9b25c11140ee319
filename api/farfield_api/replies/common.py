"""What all answers share: a base that knows no other keys, identifiers, and examples; patterns, which requests share."""

from typing import Annotated, Any

from fastapi import Path
from pydantic import BaseModel, ConfigDict, Field

JOB = "4f1c9a7e2b3d45f68790a1b2c3d4e5f6"
KEY = "0a1b2c3d4e5f60718293a4b5c6d7e8f9"
TENANT = "9e8d7c6b5a49382716059f8e7d6c5b4a"
SCENE = "9f86d081884c7d659a2feaa0c55ad015a3bf4f1b2b0b822cd15d6c15b0f00a08"
AT = "2026-01-31T09:15:00.000Z"

ID, DIGEST = "^[0-9a-f]{32}$", "^[0-9a-f]{64}$"
PLAIN = r"^[^\x00-\x1f]*$"  # a text on one line, without control codes

Id = Annotated[str, Path(pattern=ID, examples=[JOB])]
Digest = Annotated[str, Path(pattern=DIGEST, examples=[SCENE])]
Time = Annotated[str, Field(json_schema_extra={"format": "date-time"}, description="RFC 3339, UTC")]
Next = Annotated[str | None, Field(description="cursor of the next page; null: this is the last one")]


class Reply(BaseModel):
    """An answer. It holds exactly the keys that it says."""

    model_config = ConfigDict(extra="forbid")


class Problem(Reply):
    """Why something failed elsewhere: a stage of a job, the fit of a device."""

    model_config = ConfigDict(extra="allow")
    code: str | None = None
    message: str | None = None
    detail: str | None = None
    advice: str | None = None
    stage: str | None = None


def example(**value: Any) -> ConfigDict:
    """Return the configuration of a model with this example."""
    return ConfigDict(extra="forbid", json_schema_extra={"examples": [value]})
