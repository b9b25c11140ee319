"""A part of an artifact as an answer: streamed from wherever the blobs are, with ranges, never written to disk here.

A job's placement is one artifact, a container of files. Its table says where each file lies, so that a page of it is a
range of a blob: the API keeps nothing, and any replica answers any request.
"""

import functools
import re
from collections.abc import Iterator
from itertools import chain

from farfield.store.artifacts import Artifacts
from fastapi import Request, Response
from fastapi.responses import StreamingResponse

TABLES = 32  # of the containers asked for last
AT_ONCE_BYTES = 256 << 10  # sent in one piece: a stream asks for a thread for each of its pieces, and one more


@functools.lru_cache(maxsize=TABLES)
def files_in(artifacts: Artifacts, digest: str) -> dict[str, tuple[int, int]]:
    """Return name -> [start, stop) of each file in the container. Raises ArtifactMissing, ColumnsAltered."""
    from farfield.columns import files_table  # brings numpy: 16 MiB that a process without placements saves

    return files_table(lambda start, stop: b"".join(artifacts.stream(digest, start, stop)), where="the placement")


def slice_response(
    request: Request, artifacts: Artifacts, digest: str, start: int, stop: int, *, media_type: str,
    headers: dict[str, str],
) -> Response:  # fmt: skip
    """Answer with the bytes [start, stop) of the artifact, or with the one range of them that is asked for.

    `headers` hold the ETag that If-Range is compared with. More than one range is answered with all of it, which RFC
    9110 allows. Raises ArtifactMissing before anything is sent.
    """
    size = stop - start
    headers = {**headers, "accept-ranges": "bytes", "content-length": str(size)}
    wanted = request.headers.get("range", "")
    if request.headers.get("if-range", headers["etag"]) != headers["etag"]:
        wanted = ""
    match = re.fullmatch(r"bytes=([0-9]{0,18})-([0-9]{0,18})", wanted.strip())
    status = 200
    if match is not None and wanted.strip() != "bytes=-":
        first, last = match.groups()
        begin = int(first) if first else max(0, size - int(last))
        end = min(size, int(last) + 1) if first and last else size
        if begin >= end and not (first and last and int(last) < int(first)):
            return Response(
                status_code=416, headers={**headers, "content-range": f"bytes */{size}", "content-length": "0"}
            )
        if begin < end:
            headers |= {"content-range": f"bytes {begin}-{end - 1}/{size}", "content-length": str(end - begin)}
            start, stop, status = start + begin, start + end, 206
    if request.method == "HEAD":
        return Response(status_code=status, headers=headers, media_type=media_type)
    if stop - start <= AT_ONCE_BYTES:
        body = b"".join(artifacts.stream(digest, start, stop))
        return Response(body, status_code=status, headers=headers, media_type=media_type)
    return StreamingResponse(
        _begun(artifacts.stream(digest, start, stop)), status_code=status, headers=headers, media_type=media_type
    )


def _begun(stream: Iterator[bytes]) -> Iterator[bytes]:
    """Return the stream with its first piece read: what is missing is an error then, and no torn answer."""
    return chain([next(stream, b"")], stream)
