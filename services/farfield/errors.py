"""Every error farfield names. Domain errors carry facts and advice, never an HTTP status.

    FarfieldError
    ├── SceneError            the uploaded level cannot be used                      exit 3, HTTP 422
    ├── SettingsInvalid       a setting is out of its range                          exit 2, HTTP 422
    ├── ImpostorError         outside the domain of the error metric                 exit 3, HTTP 422
    ├── PlacementFileError    a placement database file cannot be read               exit 3, HTTP 422
    │   └── NotColumns, ColumnsTooNew, ColumnsTruncated, ColumnsAltered, PlacementFileMissing
    ├── CalibrationError      measured frames that no device profile can be fitted to exit 3, HTTP 422
    │   └── SamplesInvalid, SamplesTooFew, SamplesDegenerate, DeviceNotCalibrated
    ├── BaseUnfit             a placement that another cannot start from             exit 3, HTTP 422
    ├── OutsideViewSpace      a camera position outside the view space               exit 3, HTTP 422
    ├── DirectionInvalid      a view direction of length 0, or not finite            exit 3
    ├── ExportError           what is asked for cannot be exported                   exit 3
    │   └── NothingToExport, ExportTooLarge
    ├── StoreError            a row or blob of the service
    │   ├── SceneNotFound, JobNotFound, PlacementNotFound, DeviceNotFound,
    │   │   UploadNotFound                                                    exit 3, HTTP 404
    │   ├── UploadsTooMany                                                    exit 3, HTTP 429
    │   ├── TenantNotFound, KeyNotFound, WebhookNotFound, DeliveryNotFound       exit 3, HTTP 404
    │   ├── JobNotFinished, JobStillRunning, JobNotStopped, IdempotencyConflict,
    │   │   SceneInUse, TenantExists,
    │   │   DeviceExists                                                      exit 3, HTTP 409
    │   ├── ArtifactMissing   a blob that a row names is not there                exit 3, HTTP 500
    │   │   └── ArtifactDamaged   its bytes are not what its name says
    │   └── ArtifactLost      ... and cannot be computed again                exit 3, HTTP 500
    ├── QuotaExceeded         the tenant has as much as it may have              exit 3, HTTP 403
    │   └── RunningQuotaExceeded  as many jobs run as may at a time                      HTTP 429
    ├── WebhookError          an address that no webhook may have, or a forged delivery  exit 3, HTTP 422
    │   └── WebhookAddressRefused, SignatureInvalid
    ├── ServiceError          the service cannot start, or does not answer       exit 3
    │   └── StoreUnavailable  the artifact store does not answer                 exit 3, HTTP 503
    ├── OverMemory            a shard needs more memory than any worker has
    ├── FailedElsewhere       a named error of another process, passed on
    └── StageFailed           a shard failed for good                                exit 1, HTTP 500

Each message says what is wrong, where, and what to do. `code` is the stable name that the API and `--json` show.
"""

from typing import Any


class FarfieldError(Exception):
    """Root of the tree. `advice` is a sentence on what to do."""

    advice = ""

    @property
    def code(self) -> str:
        return type(self).__name__

    def __reduce__(self) -> tuple[Any, ...]:
        """Cross a process border with message and facts: `__init__` takes other arguments than the message."""
        return _revived, (type(self), self.args, self.__dict__)


def _revived(cls: type[FarfieldError], args: tuple[Any, ...], facts: dict[str, Any]) -> FarfieldError:
    error = cls.__new__(cls, *args)
    error.__dict__.update(facts)
    return error


class SceneError(FarfieldError):
    """The scene file cannot be used."""


class SceneUnreadable(SceneError):
    """Unknown or corrupt format."""

    advice = "Export the level again as glTF 2.0 (GLB), OBJ, PLY or STL, or a zip of these."


class SceneNotAFile(SceneError):
    """The path given for a scene is no file."""

    advice = "Check the path."


class SceneEmpty(SceneError):
    """No triangles."""

    advice = "Check that the export contains meshes with triangles."


class SceneIndexOutOfRange(SceneError):
    """An index points past its vertices, accessor or buffer."""

    advice = "Export the level again; the file contradicts itself."


class SceneNotFinite(SceneError):
    """A position or transform is NaN or infinite."""

    advice = "Remove the vertices or transforms that are not finite."


class SceneUriRefused(SceneError):
    """A reference leaves the scene's folder, or names a network or absolute address."""

    advice = "Pack the level as one GLB, or a zip with all files beside it and relative names."


class SceneFileMissing(SceneError):
    """A relative file that the scene names is not there."""

    advice = "Add the file beside the scene, or pack the level as one GLB or zip."


class SceneOverLimit(SceneError):
    """Larger than a limit in bytes, nodes, triangles, texture pixels or depth."""

    advice = "Split the level, or ask the operator to raise the limit."


class SettingsInvalid(FarfieldError):
    """A setting is out of its range. `key` is its dotted name."""

    advice = "See docs/settings.md for the range of each setting."

    def __init__(self, key: str, why: str) -> None:
        super().__init__(f"{key}: {why}")
        self.key = key


class ImpostorError(FarfieldError):
    """Outside the domain of the error metric."""


class ObjectTouchesViewCell(ImpostorError):
    """No impostor is valid where the viewer can touch the object (t0 <= 0)."""

    advice = "Keep the geometry there, or take a view cell that is farther away."


class OutOfDomain(ImpostorError):
    """A parameter of the error metric is outside its domain."""

    advice = "See `farfield layers --help` for the domain of each parameter."


class PlacementFileError(FarfieldError):
    """A file of a placement database, or an artifact, cannot be read."""

    advice = "Fetch the placement again, or place the level again."


class NotColumns(PlacementFileError):
    def __init__(self, where: str) -> None:
        super().__init__(f"{where} is not a farfield file: it does not begin with FARFIELD.")


class ColumnsTooNew(PlacementFileError):
    advice = "Update farfield."

    def __init__(self, where: str, found: int, known: int) -> None:
        super().__init__(f"{where} has format version {found}; this farfield reads version {known}.")


class ColumnsTruncated(PlacementFileError):
    def __init__(self, where: str, found_bytes: int, needed_bytes: int) -> None:
        super().__init__(f"{where} is truncated: {found_bytes} of at least {needed_bytes} bytes are there.")


class ColumnsAltered(PlacementFileError):
    def __init__(self, where: str, why: str) -> None:
        super().__init__(f"{where} is altered or damaged: {why}.")


class PlacementFileMissing(PlacementFileError):
    def __init__(self, where: str) -> None:
        super().__init__(f"{where} is missing.")


class CalibrationError(FarfieldError):
    """Measured frames that no device profile can be fitted to."""


class SamplesInvalid(CalibrationError):
    """A sample lacks a number, or has one that nothing can measure."""

    advice = "See docs/calibration.md for the columns: counts of what a frame drew, and the milliseconds that it took."


class SamplesTooFew(CalibrationError):
    """Fewer samples than a quantile needs."""

    advice = "Measure more frames, from as many different views as possible."


class SamplesDegenerate(CalibrationError):
    """The samples do not tell the coefficients apart."""

    advice = "Add samples as the message says; none of those that are there has to go."


class DeviceNotCalibrated(CalibrationError):
    """A device of the service that has no profile yet."""

    advice = "Send samples: POST /v1/devices/{id}/samples. The answer says what is missing."

    def __init__(self, name: str, why: str) -> None:
        super().__init__(f"device {name!r} has no profile yet: {why}")


class BaseUnfit(FarfieldError):
    """A placement that another cannot start from."""

    advice = "Place from scratch, or start from a placement that was made with the same settings by this version."

    def __init__(self, why: str) -> None:
        super().__init__(f"the base does not fit: {why}")


class OutsideViewSpace(FarfieldError):
    """The camera position lies outside the view space of the placement."""

    advice = "Clamp the camera to the boxes in the manifest's view_space."


class DirectionInvalid(FarfieldError):
    """A view direction of length 0, or one that is not finite."""

    advice = "Give a direction of any length but 0."


class ExportError(FarfieldError):
    """What is asked for cannot be exported."""


class NothingToExport(ExportError):
    """No impostor is shown there."""

    advice = "Views within the budget show geometry alone; export another cell or view, or all."

    def __init__(self, where: str) -> None:
        super().__init__(f"no impostor is shown in {where}")


class ExportTooLarge(ExportError):
    """A GLB states its length in 32 bits."""

    advice = "Export as .gltf, or one cell at a time with --cell."

    def __init__(self, name: str, size: int) -> None:
        super().__init__(f"{name} would have {size} bytes, and a GLB cannot exceed 4 GiB")


class StoreError(FarfieldError):
    """A row or blob of the service."""


class SceneNotFound(StoreError):
    advice = "Upload the scene first: POST /v1/scenes."

    def __init__(self, digest: str) -> None:
        super().__init__(f"no scene {digest} has been uploaded")
        self.digest = digest


class UploadNotFound(StoreError):
    advice = "It was finished, ended or has expired: start another one with POST /v1/uploads."

    def __init__(self, upload: str) -> None:
        super().__init__(f"there is no upload {upload[:64]}")


class UploadsTooMany(StoreError):
    advice = "Finish or DELETE some of those that GET /v1/uploads lists."

    def __init__(self, most: int) -> None:
        super().__init__(f"at most {most} uploads may be open at a time")


class JobNotFound(StoreError):
    advice = "List the jobs with GET /v1/jobs."

    def __init__(self, job: str) -> None:
        super().__init__(f"there is no job {job}")
        self.job = job


class PlacementNotFound(StoreError):
    advice = "See whether the job is done: GET /v1/jobs/{id}."

    def __init__(self, placement: str, path: str = "") -> None:
        super().__init__(
            f"there is no {path} in placement {placement}" if path else f"there is no placement {placement}"
        )
        self.placement = placement


class JobNotFinished(StoreError):
    """What was asked for is there only once the job is done."""

    advice = "Wait for the job's last event, then ask again."

    def __init__(self, job: str, state: str) -> None:
        super().__init__(f"job {job} is {state}: it has no result yet")
        self.job, self.state = job, state


class JobStillRunning(StoreError):
    advice = "Cancel the job first: POST /v1/jobs/{id}/cancel."

    def __init__(self, job: str, state: str) -> None:
        super().__init__(f"job {job} is {state}")
        self.job, self.state = job, state


class JobNotStopped(StoreError):
    advice = "Only a job that failed or was cancelled can be retried."

    def __init__(self, job: str, state: str) -> None:
        super().__init__(f"job {job} is {state}")
        self.job, self.state = job, state


class DeviceNotFound(StoreError):
    advice = "List the devices with GET /v1/devices."

    def __init__(self, device: str) -> None:
        super().__init__(f"there is no device {device}")
        self.device = device


class DeviceExists(StoreError):
    advice = "Choose another name, or send samples to the device that has it."

    def __init__(self, name: str) -> None:
        super().__init__(f"there is a device {name!r} already")
        self.name = name


class TenantNotFound(StoreError):
    advice = "List the tenants with GET /v1/tenants."

    def __init__(self, tenant: str) -> None:
        super().__init__(f"there is no tenant {tenant:.64}")


class TenantExists(StoreError):
    advice = "Choose another name."

    def __init__(self, name: str) -> None:
        super().__init__(f"there is a tenant {name!r} already")


class KeyNotFound(StoreError):
    advice = "List the keys with GET /v1/keys."

    def __init__(self, key: str) -> None:
        super().__init__(f"there is no valid key {key:.64}")


class WebhookNotFound(StoreError):
    advice = "List the webhooks with GET /v1/webhooks."

    def __init__(self, webhook: str) -> None:
        super().__init__(f"there is no webhook {webhook:.64}")


class DeliveryNotFound(StoreError):
    advice = "List the deliveries with GET /v1/webhooks/{id}/deliveries."

    def __init__(self, delivery: str) -> None:
        super().__init__(f"there is no delivery {delivery:.64} of this webhook")


class SceneInUse(StoreError):
    advice = "Delete its jobs first: GET /v1/jobs?scene=DIGEST lists them."

    def __init__(self, digest: str, n_jobs: int) -> None:
        super().__init__(f"{n_jobs} jobs need the scene {digest}")


class IdempotencyConflict(StoreError):
    advice = "Use a new Idempotency-Key for a new request."

    def __init__(self, key: str) -> None:
        super().__init__(f"the Idempotency-Key {key} was used for a different request")
        self.key = key


class ArtifactMissing(StoreError):
    """A blob that should be there is not; it can be computed again."""

    advice = "Run the job again."

    def __init__(self, digest: str) -> None:
        super().__init__(f"artifact {digest[:64]} is not in the store")
        self.digest = digest


class ArtifactDamaged(ArtifactMissing):
    """A blob is not what its name says: a disk or a hand has altered it. Whoever removes it can have it computed again."""

    def __init__(self, digest: str) -> None:
        StoreError.__init__(self, f"artifact {digest[:64]} is damaged: its bytes do not have this SHA-256")
        self.digest = digest


class ArtifactLost(StoreError):
    """A blob that should be there is not, or is damaged, and nothing can compute it again."""

    advice = "Upload the scene again, and run the job again; ask the operator to look after the store (farfield fsck)."


class QuotaExceeded(FarfieldError):
    """The tenant has as much as it may have."""

    advice = "Delete jobs or scenes (GET /v1/usage says what there is), or ask the operator for a larger quota."

    def __init__(self, what: str, used: int, limit: int) -> None:
        super().__init__(f"{used} of {limit} {what} are used")


class RunningQuotaExceeded(QuotaExceeded):
    """As many jobs run as may at a time."""

    advice = "Wait for one to end, or cancel one, then ask again."


class WebhookError(FarfieldError):
    """An address that no webhook may have, or a delivery that is none of ours."""


class WebhookAddressRefused(WebhookError):
    advice = "Give an https address of a public host; the operator may allow more with FARFIELD_WEBHOOK_NETWORKS."


class SignatureInvalid(WebhookError):
    advice = "Check the secret and the receiver's clock, and verify the body's bytes as they came."


class ServiceError(FarfieldError):
    """The service cannot start, or does not answer."""


class StoreUnavailable(ServiceError):
    """The artifact store does not answer, or cannot be written. Nothing is wrong with the job: it waits."""

    advice = "See /readyz, and the store's own log."


class StageFailed(FarfieldError):
    """A shard failed for good; `stage` says where."""

    def __init__(self, stage: str, why: str) -> None:
        super().__init__(f"stage {stage} failed: {why}")
        self.stage = stage


class OverMemory(FarfieldError):
    """A shard needs more memory than the workers have."""

    advice = "Use a machine with more memory, or cut the level; FARFIELD_MEMORY_BYTES says what workers may use."

    def __init__(self, need_bytes: int, memory_bytes: int) -> None:
        need, there = need_bytes / 2**30, memory_bytes / 2**30
        super().__init__(
            f"it may need up to {need:.1f} GiB of memory; a worker's machine has {there:.1f} GiB for shards"
        )


class FailedElsewhere(FarfieldError):
    """A named error of another process, under the name and with the advice that this gave."""

    def __init__(self, code: str, message: str, advice: str) -> None:
        super().__init__(message)
        self._code, self.advice = code, advice

    @property
    def code(self) -> str:
        return self._code
