"""The Python client of the service: what a build farm does, each call once whatever the line does.

    with Client("https://farfield.studio.example", key) as service:
        scene = service.send_scene(Path("level.glb"))
        job = service.create_job(scene, {"budget": "16 ms"}, idempotency_key="build-17")
        for kind, data in service.events(job["id"]):
            print(kind, data)
        service.fetch(job["id"], Path("placed"))

Requests are sent again where the connection fails: what comes twice is done once, and an upload goes on where it stopped
(`sending.py`). Events are followed with Last-Event-ID: a service that restarts in between loses none. Refusals are raised as
`Refused`, with the service's own code and advice.
"""

import hashlib
import json
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any

import httpx

from farfield.errors import ColumnsAltered, FarfieldError, ServiceError
from farfield.sending import send_file

TRIES = 5
PAGE = 100  # jobs a request
LONGEST_S = 60  # that we wait because the service asks for it
ENDED = ("done", "failed", "cancelled")

Sent = Callable[[int], object]  # told the bytes of each piece that went or came


class Refused(FarfieldError):
    """The service refused a request, or the job failed, with this code."""

    def __init__(self, problem: Mapping[str, Any]) -> None:
        super().__init__(str(problem.get("detail") or problem.get("message") or "no reason was given"))
        self._code, self.advice = str(problem.get("code", "Refused")), str(problem.get("advice", ""))
        self.problem = dict(problem)

    @property
    def code(self) -> str:
        return self._code

    def __reduce__(self) -> Any:
        return type(self), (self.problem,)


class Client:
    """A service under `url`, as the holder of `key`. Every method raises Refused, or ServiceError where nobody answers."""

    def __init__(self, url: str, key: str, *, trust_proxy: bool = True, http: httpx.Client | None = None) -> None:
        """http  instead of a client of our own: whose transport, certificates or proxies you have set yourself"""
        self.url = url.rstrip("/")
        self._http = http or httpx.Client(
            base_url=self.url, timeout=httpx.Timeout(30.0, read=900.0), trust_env=trust_proxy
        )
        self._http.headers["authorization"] = f"Bearer {key}"

    def __enter__(self) -> "Client":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._http.close()

    # scenes

    def knows_scene(self, digest: str) -> bool:
        """Say whether a scene with this SHA-256 was sent before."""
        answer = self._request("HEAD", f"/v1/scenes/{digest}")
        if not answer.is_success and answer.status_code != 404:
            self._get(f"/v1/scenes/{digest}")  # HEAD has no body that says why
        return answer.is_success

    def send_scene(self, path: Path, *, digest: str | None = None, sent: Sent = int) -> dict[str, Any]:
        """Send the file at `path` where it is unknown, and return what the service says of it (`digest`, `warnings`).

        What was sent before a lost connection, or by a process that was killed, is not sent again.
        sent  told the bytes of each piece that went or was there; negative where the service has lost some
        """
        digest = digest or file_digest(path)
        if self.knows_scene(digest):
            return self.scene(digest)
        send_file(_Sender(self), path, digest=digest, sent=sent)
        return self.scene(digest)

    def scene(self, digest: str) -> dict[str, Any]:
        """Return what the service says of a scene."""
        return self._get(f"/v1/scenes/{digest}")

    def scenes(self, *, name: str | None = None) -> Iterator[dict[str, Any]]:
        """Yield all scenes, newest first; `name`: with this in their name."""
        yield from self._pages("/v1/scenes", "scenes", {"name": name})

    def delete_scene(self, digest: str, *, dry_run: bool = False) -> dict[str, Any]:
        """Delete a scene that no job needs; return what goes with it. `dry_run`: only say so."""
        return self._read(self._request("DELETE", f"/v1/scenes/{digest}", params={"dry_run": dry_run}))

    # jobs

    def create_job(
        self, scene: str, settings: Mapping[str, Any], *, idempotency_key: str, name: str | None = None,
        priority: str = "normal", webhook: str | None = None,
    ) -> dict[str, Any]:  # fmt: skip
        """Start a job for the scene with this digest; the same key again is the same job.

        priority  high, normal or low
        webhook   id of one that is told of this job
        """
        body = {"scene": scene, "settings": dict(settings), "name": name, "priority": priority, "webhook": webhook}
        headers = {"idempotency-key": idempotency_key}
        return self._read(self._request("POST", "/v1/jobs", json=body, headers=headers))

    def job(self, job: str) -> dict[str, Any]:
        """Return the job: state, stages, verdict, links."""
        return self._get(f"/v1/jobs/{job}")

    def jobs(
        self, *, state: str | None = None, scene: str | None = None, verdict: str | None = None, name: str | None = None
    ) -> Iterator[dict[str, Any]]:
        """Yield all jobs, newest first: in that state, of that scene, with that verdict, with this in their name."""
        yield from self._pages("/v1/jobs", "jobs", {"state": state, "scene": scene, "verdict": verdict, "name": name})

    def wait(self, job: str) -> dict[str, Any]:
        """Return the job once it has ended."""
        for _ in self.events(job):
            pass
        return self.job(job)

    def delete(self, job: str, *, dry_run: bool = False) -> dict[str, Any]:
        """Delete a job that has ended; return what goes with it. `dry_run`: only say so."""
        return self._read(self._request("DELETE", f"/v1/jobs/{job}", params={"dry_run": dry_run}))

    def curve(self, job: str) -> dict[str, Any]:
        """Return what a larger budget would need, of a job that is done."""
        return self._get(f"/v1/jobs/{job}/curve")

    def usage(self) -> dict[str, Any]:
        """Return what the tenant has, and how much it may have."""
        return self._get("/v1/usage")

    def cancel(self, job: str) -> dict[str, Any]:
        """Stop the job; what is done stays."""
        return self._read(self._request("POST", f"/v1/jobs/{job}/cancel"))

    def retry(self, job: str) -> dict[str, Any]:
        """Let a failed or cancelled job go on from what is done; one that goes on already is left to it."""
        try:
            return self._read(self._request("POST", f"/v1/jobs/{job}/retry"))
        except Refused as refused:  # perhaps the answer to the first request was lost
            found = self.job(job) if refused.code == "JobNotStopped" else {}
            if found.get("state") not in ("queued", "running"):
                raise
            return found

    def report(self, job: str) -> dict[str, Any]:
        """Return the report of a job that is done (docs/formats/report.md)."""
        return self._get(f"/v1/jobs/{job}/report")

    def login_url(self, to: str) -> str:
        """Return an address that opens the page `to` in a browser, once."""
        return str(self._read(self._request("POST", "/v1/logins", json={"to": to}))["url"])

    def past_events(self, job: str) -> Iterator[dict[str, Any]]:
        """Yield what has happened so far: `seq`, `kind`, `at`, `data`."""
        after = 0
        while True:
            answer = self._request(
                "GET", f"/v1/jobs/{job}/events", params={"after": after, "limit": 1000},
                headers={"accept": "application/json"},
            )  # fmt: skip
            page = self._read(answer)
            yield from page["events"]
            if not page["events"]:
                return
            after = page["next"]

    def events(self, job: str, *, after: int = 0) -> Iterator[tuple[str, dict[str, Any]]]:
        """Yield (kind, data) of every event after that number once, in order, until the job has ended."""
        last, failures = str(after), 0
        while True:
            try:
                headers = {"last-event-id": last, "accept": "text/event-stream"}
                timeout = httpx.Timeout(30.0, read=60.0)  # the service says something every 15 s
                with self._http.stream("GET", f"/v1/jobs/{job}/events", headers=headers, timeout=timeout) as stream:
                    if stream.status_code == 204:
                        return
                    if not stream.is_success:
                        stream.read()
                        self._read(stream)
                    fields: dict[str, str] = {}
                    for line in stream.iter_lines():
                        failures = 0
                        if line:
                            name, _, value = line.partition(":")
                            fields[name] = value.removeprefix(" ")
                            continue
                        if "data" in fields:
                            last = fields.get("id", last)
                            yield fields.get("event", "message"), json.loads(fields["data"])
                        fields = {}
            except httpx.TransportError as error:
                failures += 1
                if failures >= TRIES:
                    raise self._silent(error) from error
                time.sleep(0.5 * 2**failures)

    # webhooks; their deliveries are checked with farfield.webhooks.verify

    def create_webhook(
        self, url: str, *, name: str, every_job: bool = False, events: Sequence[str] = ENDED
    ) -> dict[str, Any]:
        """Register an address; the answer holds its `id` and, this once, its `secret`."""
        body = {"url": url, "name": name, "every_job": every_job, "events": list(events)}
        return self._read(self._request("POST", "/v1/webhooks", json=body))

    def webhooks(self) -> Iterator[dict[str, Any]]:
        """Yield all webhooks, newest first."""
        yield from self._pages("/v1/webhooks", "webhooks", {})

    def delete_webhook(self, webhook: str) -> None:
        """Delete a webhook and what waits for it."""
        answer = self._request("DELETE", f"/v1/webhooks/{webhook}")
        if not answer.is_success:
            self._read(answer)

    # placements

    def files(self, job: str) -> tuple[bytes, dict[str, str | None]]:
        """Return (manifest.json, {path below the job's folder: SHA-256 of the file})."""
        manifest = self._file(job, "manifest.json")
        told = json.loads(manifest)
        below = [told["index"], *told["chunks"], *told["pages"]]
        if geometry := told.get("geometry"):
            below += [geometry["index"], *geometry["pages"], *geometry["textures"]]
        files: dict[str, str | None] = {f"placement/{f['file']}": str(f["sha256"]) for f in below}
        return manifest, {told["scene"]["file"]: told["scene"]["sha256"], **files, "report.json": None}

    def fetch(self, job: str, folder: Path, *, sent: Sent = int, found: Callable[[int], object] = int) -> int:
        """Write the job's placement, scene and report to `folder` as `farfield place` does; return how many files came.

        Files that are there and have the right digest are not fetched again, so that a call after a lost line goes on
        where the first one stopped. The manifest comes last: a folder that has one is complete. Raises ColumnsAltered
        where what came is not what the manifest says.
        """
        manifest, files = self.files(job)
        found(len(files) + 1)
        for name in files:
            if not (folder / name).resolve().is_relative_to(folder.resolve()):
                raise ColumnsAltered("manifest.json", f"it names a file outside its folder: {name}")
        complete = folder / "placement" / "manifest.json"
        if complete.is_file() and complete.read_bytes() != manifest:
            complete.unlink()  # it is of another job, whose files are replaced from here on
        fetched = 0
        for name, digest in files.items():
            path = folder / name
            if digest is None or not path.is_file() or file_digest(path) != digest:
                content = self._file(job, name.removeprefix("placement/"))
                if digest is not None and hashlib.sha256(content).hexdigest() != digest:
                    raise ColumnsAltered(name, "its digest is not the one in the manifest")
                _write(path, content)
                fetched += 1
            sent(1)
        _write(complete, manifest)
        sent(1)
        return fetched + 1

    def export_gltf(self, job: str, out: Path, *, cell: int | None = None, images: str = "png") -> int:
        """Write the job's impostors to the file `out` (.glb) as `farfield export gltf` does; return its bytes.

        cell    only what the views of this cell show
        images  "png", "webp" or "webp+png"
        """
        wanted = {"images": images} if cell is None else {"images": images, "cell": str(cell)}
        arriving = out.with_name(out.name + ".part")
        try:
            with self._http.stream("GET", f"/v1/placements/{job}/gltf", params=wanted) as answer:
                if not answer.is_success:
                    answer.read()
                    self._read(answer)
                with arriving.open("wb") as file:
                    for piece in answer.iter_bytes():
                        file.write(piece)
            arriving.replace(out)
        except httpx.TransportError as error:
            raise self._silent(error) from error
        finally:
            arriving.unlink(missing_ok=True)
        return out.stat().st_size

    def _file(self, job: str, path: str) -> bytes:
        answer = self._request("GET", f"/v1/placements/{job}/{path}")
        if not answer.is_success:
            self._read(answer)
        return answer.content

    # requests

    def _pages(self, path: str, key: str, wanted: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
        query = {"limit": PAGE, **{name: value for name, value in wanted.items() if value is not None}}
        while True:
            page = self._get(path, query)
            yield from page[key]
            if page["next"] is None:
                return
            query["cursor"] = page["next"]

    def _get(self, path: str, query: Mapping[str, Any] | None = None) -> dict[str, Any]:
        return self._read(self._request("GET", path, params=query))

    def _request(self, method: str, path: str, **more: Any) -> httpx.Response:
        """Return the answer; ask again where the connection fails, the service is starting, or says when to go on."""
        for attempt in range(TRIES):
            try:
                answer = self._http.request(method, path, **more)
            except httpx.TransportError as error:
                if attempt == TRIES - 1:
                    raise self._silent(error) from error
            else:
                if answer.status_code not in (429, 502, 503, 504) or attempt == TRIES - 1:
                    return answer
                told = answer.headers.get("retry-after", "")
                if answer.status_code == 429 and told.isdecimal():  # too often, or too many jobs at a time
                    time.sleep(min(int(told), LONGEST_S))
                    continue
            time.sleep(0.5 * 2**attempt)
        raise AssertionError("unreachable")

    def _read(self, answer: httpx.Response) -> dict[str, Any]:
        try:
            body = answer.json()
        except ValueError:
            body = None
        if answer.is_success and isinstance(body, dict):
            return body
        if answer.is_success or not isinstance(body, dict):
            body = {"code": "ServiceError", "detail": f"{self.url} answered {answer.status_code} without JSON"}
        raise Refused(body)

    def _silent(self, error: httpx.TransportError) -> ServiceError:
        return ServiceError(f"{self.url} does not answer: {error}")


class _Sender:
    """What `sending` may do with a client."""

    def __init__(self, client: Client) -> None:
        self.request, self.read, self.refuse, self._client = client._request, client._read, Refused, client

    def once(self, method: str, path: str, **more: Any) -> httpx.Response:
        return self._client._http.request(method, path, **more)


def file_digest(path: Path) -> str:
    """Return the SHA-256 (hex) of a file."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _write(path: Path, content: bytes) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(path.name + ".part")
    temporary.write_bytes(content)
    temporary.replace(path)
