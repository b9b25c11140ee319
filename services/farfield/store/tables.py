"""The tables of the service. SQL is the truth: what is not in a committed row has not happened.

Time     Every *_at and *_until is seconds since 1970 UTC by the database's own clock (`engine.now`).
Tenant   Every row that a client can name carries its tenant; every query of the API filters on it.
         Blobs (`artifact`) have none: they are shared by digest, below the API only.
State    job    queued -> running -> done | failed | cancelled
         stage  waiting -> planning -> running -> merging -> done | skipped, or failed;
         the last one is `reporting` before it is done
         shard  ready -> running -> done | failed | cancelled; a lease that ran out makes `running` claimable again
"""

import sqlalchemy as sa

metadata = sa.MetaData(
    naming_convention={
        "ix": "ix_%(table_name)s_%(column_0_N_name)s",
        "uq": "uq_%(table_name)s_%(column_0_N_name)s",
        "ck": "ck_%(table_name)s_%(constraint_name)s",
        "fk": "fk_%(table_name)s_%(column_0_N_name)s_%(referred_table_name)s",
        "pk": "pk_%(table_name)s",
    }
)

JOB_STATES = ("queued", "running", "done", "failed", "cancelled")
STAGE_STATES = ("waiting", "planning", "running", "merging", "reporting", "done", "skipped", "failed")
SHARD_STATES = ("ready", "running", "done", "failed", "cancelled")
SHARD_KINDS = ("plan", "run", "merge", "report")
SCOPES = ("read", "submit", "admin")

_ID = sa.String(32)
_DIGEST = sa.String(64)


def _one_of(column: str, values: tuple[str, ...]) -> sa.CheckConstraint:
    listed = ", ".join(f"'{v}'" for v in values)
    return sa.CheckConstraint(f"{column} IN ({listed})", name=f"{column}_known")


def _id_column() -> sa.Column[str]:
    return sa.Column("id", _ID, primary_key=True)


def _of(table: str, *, nullable: bool = False) -> sa.Column[str]:
    return sa.Column(f"{table}_id", _ID, sa.ForeignKey(f"{table}.id", ondelete="CASCADE"), nullable=nullable)


def _at(name: str, *, nullable: bool = True) -> sa.Column[float]:
    return sa.Column(name, sa.Double, nullable=nullable)


tenant = sa.Table(
    "tenant",
    metadata,
    _id_column(),
    sa.Column("name", sa.String(100), nullable=False, unique=True),
    _at("created_at", nullable=False),
)

api_key = sa.Table(
    "api_key",
    metadata,
    _id_column(),
    _of("tenant"),
    sa.Column("name", sa.String(100), nullable=False),
    sa.Column("secret_digest", _DIGEST, nullable=False),  # SHA-256 of 32 random bytes in base64url
    sa.Column("scopes", sa.String(100), nullable=False),  # words of SCOPES, separated by a space
    _at("created_at", nullable=False),
    _at("revoked_at"),
)

login = sa.Table(  # one-time links that open the pages in a browser
    "login",
    metadata,
    sa.Column("token_digest", _DIGEST, primary_key=True),
    _of("tenant"),
    _of("api_key"),
    _at("created_at", nullable=False),
    _at("expires_at", nullable=False),
    _at("used_at"),
)

artifact = sa.Table(
    "artifact",
    metadata,
    sa.Column("digest", _DIGEST, primary_key=True),
    sa.Column("n_bytes", sa.BigInteger, nullable=False),
    _at("created_at", nullable=False),
)


def _artifact(name: str, *, nullable: bool = True) -> sa.Column[str]:
    return sa.Column(name, _DIGEST, sa.ForeignKey("artifact.digest"), nullable=nullable)


scene = sa.Table(
    "scene",
    metadata,
    _of("tenant"),
    _artifact("digest", nullable=False),  # SHA-256 of the uploaded file
    sa.Column("name", sa.String(255), nullable=False),
    sa.Column("suffix", sa.String(16), nullable=False),  # says the format: ".glb", ".zip"
    sa.Column("n_bytes", sa.BigInteger, nullable=False),
    sa.Column("summary", sa.JSON, nullable=False),  # of `farfield inspect`, without the list of objects
    _artifact("inspect_digest", nullable=False),  # all of it
    _at("created_at", nullable=False),
    sa.PrimaryKeyConstraint("tenant_id", "digest"),
)

device_profile = sa.Table(
    "device_profile",
    metadata,
    _id_column(),
    _of("tenant"),
    sa.Column("name", sa.String(100), nullable=False),
    sa.Column("model", sa.JSON(none_as_null=True), nullable=True),  # settings.DeviceProfile; null: not yet fitted
    sa.Column("refusal", sa.JSON(none_as_null=True), nullable=True),  # of the last fit: code, detail, advice
    sa.Column("n_samples", sa.Integer, nullable=False, server_default="0"),
    sa.Column("n_fitted", sa.Integer, nullable=False, server_default="0"),  # samples that model or refusal rest on
    _at("created_at", nullable=False),
    sa.UniqueConstraint("tenant_id", "name"),
)

device_sample = sa.Table(  # one row a request: a batch of measured frames
    "device_sample",
    metadata,
    _of("tenant"),
    _of("device_profile"),
    sa.Column("first", sa.Integer, nullable=False),  # number of its first frame
    sa.Column("frames", sa.JSON, nullable=False),  # rows of rendertime.samples.COLUMNS and ms
    _at("created_at", nullable=False),
    sa.PrimaryKeyConstraint("device_profile_id", "first"),
)

webhook = sa.Table(
    "webhook",
    metadata,
    _id_column(),
    _of("tenant"),
    sa.Column("url", sa.String(2000), nullable=False),
    sa.Column("secret", sa.String(100), nullable=False),
    _at("created_at", nullable=False),
)

job = sa.Table(
    "job",
    metadata,
    _id_column(),
    _of("tenant"),
    sa.Column("name", sa.String(255), nullable=False),
    sa.Column("scene_digest", _DIGEST, nullable=False),
    sa.Column("settings", sa.JSON, nullable=False),
    sa.Column("device_profile_id", _ID, sa.ForeignKey("device_profile.id"), nullable=True),
    sa.Column("webhook_id", _ID, sa.ForeignKey("webhook.id"), nullable=True),
    sa.Column("idempotency_key", sa.String(255), nullable=True),
    sa.Column("request_digest", _DIGEST, nullable=False),
    sa.Column("state", sa.String(10), nullable=False),
    sa.Column("verdict", sa.String(20), nullable=True),
    _artifact("report_digest"),
    sa.Column("figures", sa.JSON(none_as_null=True), nullable=True),  # of the report: bytes, hopeless views, budget
    sa.Column("error", sa.JSON(none_as_null=True), nullable=True),  # code, message, advice, stage
    sa.Column("event_seq", sa.BigInteger, nullable=False),  # number of its last event
    sa.Column("optimizer_token", sa.BigInteger, nullable=False),  # fence: grows with every lease
    sa.Column("optimizer_shard_id", _ID, nullable=True),
    _at("optimizer_until"),
    _at("created_at", nullable=False),
    _at("started_at"),
    _at("finished_at"),
    sa.UniqueConstraint("tenant_id", "idempotency_key"),
    sa.ForeignKeyConstraint(["tenant_id", "scene_digest"], ["scene.tenant_id", "scene.digest"]),
    sa.Index(None, "tenant_id", "created_at", "id"),
    sa.Index(None, "state"),
    _one_of("state", JOB_STATES),
)

stage = sa.Table(
    "stage",
    metadata,
    _id_column(),
    _of("tenant"),
    _of("job"),
    sa.Column("ordinal", sa.Integer, nullable=False),
    sa.Column("name", sa.String(40), nullable=False),
    sa.Column("state", sa.String(10), nullable=False),
    sa.Column("queue", sa.String(20), nullable=True),
    sa.Column("skipped", sa.Text, nullable=True),  # the reason
    _artifact("artifact_digest"),
    _at("started_at"),
    _at("finished_at"),
    sa.UniqueConstraint("job_id", "ordinal"),
    sa.UniqueConstraint("job_id", "name"),
    _one_of("state", STAGE_STATES),
)

shard = sa.Table(
    "shard",
    metadata,
    _id_column(),
    _of("tenant"),
    _of("job"),
    _of("stage"),
    sa.Column("kind", sa.String(10), nullable=False),
    sa.Column("ordinal", sa.Integer, nullable=False),
    sa.Column("queue", sa.String(20), nullable=False),
    sa.Column("params", sa.JSON, nullable=False),  # what `plan` said, null for plan and merge
    sa.Column("key", sa.String(80), nullable=True),  # digest of all that shapes the result; known once it is claimed
    sa.Column("state", sa.String(10), nullable=False),
    sa.Column("attempt", sa.Integer, nullable=False),
    _at("lease_until"),
    _at("sent_at"),  # when its message was last sent; null: not yet
    sa.Column("worker", sa.String(100), nullable=True),
    _artifact("artifact_digest"),
    sa.Column("cached", sa.Boolean, nullable=False),  # its key was known: taken over, not computed
    sa.Column("seconds", sa.Double, nullable=True),
    sa.Column("peak_bytes", sa.BigInteger, nullable=True),
    sa.Column("error", sa.JSON(none_as_null=True), nullable=True),  # code, message, advice: for the client
    sa.Column("log", sa.Text, nullable=True),  # the traceback: for the operator
    sa.UniqueConstraint("stage_id", "kind", "ordinal"),
    sa.Index(None, "key"),
    sa.Index(None, "job_id", "state"),
    sa.Index(None, "state", "lease_until"),
    _one_of("state", SHARD_STATES),
    _one_of("kind", SHARD_KINDS),
)

event = sa.Table(
    "event",
    metadata,
    _of("tenant"),
    _of("job"),
    sa.Column("seq", sa.BigInteger, nullable=False),  # 1, 2, 3 ... of its job, in order of commit
    sa.Column("kind", sa.String(40), nullable=False),
    sa.Column("data", sa.JSON, nullable=False),
    _at("created_at", nullable=False),
    sa.PrimaryKeyConstraint("job_id", "seq"),
)
