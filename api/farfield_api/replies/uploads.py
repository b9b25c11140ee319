"""Answers about uploads that resume."""

from typing import Any, Literal

from pydantic import Field

from farfield_api.replies.common import AT, SCENE, Reply, Time, example

_ID = "0a1b2c3d4e5f60718293a4b5c6d7e8f9"
_UPLOAD: dict[str, Any] = {
    "id": _ID, "name": "harbour.glb", "state": "open", "bytes": 73_400_320, "received": 33_554_432, "sha256": SCENE,
    "scene": None, "problem": None, "created_at": AT, "expires_at": AT,
    "links": {"self": f"/v1/uploads/{_ID}", "scene": None},
}  # fmt: skip


class UploadLinks(Reply):
    self: str
    scene: str | None


class UploadProblem(Reply):
    """What a file was refused with: the problem that the last PATCH was answered with."""

    status: int
    code: str
    detail: str
    advice: str


class UploadReply(Reply):
    model_config = example(**_UPLOAD)
    id: str
    name: str
    state: Literal["open", "reading", "done", "refused"] = Field(
        description="reading: all bytes have arrived; where nobody reads, a PATCH without bytes makes somebody"
    )
    bytes: int
    received: int = Field(description="bytes that survive a power cut: where to go on")
    sha256: str | None = Field(description="what the sender announced")
    scene: str | None = Field(description="the digest of the scene that it became")
    problem: UploadProblem | None
    created_at: Time
    expires_at: Time
    links: UploadLinks


class UploadListReply(Reply):
    model_config = example(uploads=[_UPLOAD])
    uploads: list[UploadReply]
