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

from farfield.store.engine import now

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
PRIORITIES = ("high", "normal", "low")
SCOPES = ("read", "submit", "admin")
WEBHOOK_EVENTS = ("queued", "running", "done", "failed", "cancelled")
DELIVERY_STATES = ("pending", "delivered", "failed")

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
    sa.Column("is_operator", sa.Boolean, nullable=False, server_default=sa.false()),  # its admins may act in all others
    sa.Column("max_bytes", sa.BigInteger, nullable=True),  # quotas; null: the default of the service
    sa.Column("max_jobs", sa.Integer, nullable=True),
    sa.Column("max_running", sa.Integer, nullable=True),
    sa.Column("turn", sa.BigInteger, nullable=False, server_default="0"),  # number of the claim that served it last
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
    _at("expires_at"),
    _at("last_used_at"),  # to about half a minute
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

ended_session = sa.Table(  # cookies whose owner has logged out, until they would have ended by themselves
    "ended_session",
    metadata,
    sa.Column("session_digest", _DIGEST, primary_key=True),
    _at("expires_at", nullable=False),
    sa.Index(None, "expires_at"),
)

artifact = sa.Table(
    "artifact",
    metadata,
    sa.Column("digest", _DIGEST, primary_key=True),
    sa.Column("n_bytes", sa.BigInteger, nullable=False),
    _at("created_at", nullable=False),
    _at("marked_at"),  # when nothing was found to refer to it; null: in use, or new. See store.collect
    sa.Index(None, "marked_at"),
)

worker = sa.Table(  # who computes, told by itself; a row is a fact about now, and no shard depends on it
    "worker",
    metadata,
    sa.Column("name", sa.String(100), primary_key=True),
    sa.Column("host", sa.String(255), nullable=False),
    sa.Column("queues", sa.String(200), nullable=False),  # separated by a comma
    sa.Column("capability", sa.JSON, nullable=False),  # cores, memory_bytes, version, renderer
    _at("started_at", nullable=False),
    _at("heartbeat_at", nullable=False),
    _at("stopped_at"),  # it said that it ends
    sa.Column("shard_id", _ID, nullable=True),  # what it computes now
    sa.Column("stage", sa.String(40), nullable=True),
    _at("shard_since"),
    sa.Column("done", sa.BigInteger, nullable=False),  # shards since its start
    sa.Column("failed", sa.BigInteger, nullable=False),
    sa.Column("busy_seconds", sa.Double, nullable=False),
    sa.Column("recent", sa.Integer, nullable=False),  # shards done in the last five minutes
    sa.Index(None, "heartbeat_at"),
)

counter = sa.Table(  # what only grows, added up over all processes: the metrics that outlive them
    "counter",
    metadata,
    sa.Column("name", sa.String(60), primary_key=True),
    sa.Column("labels", sa.String(200), primary_key=True),  # "stage=bake,le=1"
    sa.Column("value", sa.Double, nullable=False),
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
    _artifact("picture_digest"),  # PNG from above
    _at("created_at", nullable=False),
    sa.PrimaryKeyConstraint("tenant_id", "digest"),
)

upload = sa.Table(  # a file on its way in; its bytes lie in a file named by the id
    "upload",
    metadata,
    _id_column(),
    _of("tenant"),
    sa.Column("name", sa.String(255), nullable=False),
    sa.Column("n_bytes", sa.BigInteger, nullable=False),
    sa.Column("digest", _DIGEST, nullable=True),  # SHA-256 that it shall have
    sa.Column("received", sa.BigInteger, nullable=False),  # bytes that are synced
    sa.Column("scene_digest", _DIGEST, nullable=True),  # the scene that it became
    sa.Column("refusal", sa.JSON(none_as_null=True), nullable=True),  # status, code, detail, advice
    _at("created_at", nullable=False),
    _at("expires_at", nullable=False),
    sa.Index(None, "tenant_id", "digest"),
    sa.Index(None, "expires_at"),
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
    sa.Column("idempotency_key", sa.String(255), nullable=True),
    sa.Column("request_digest", _DIGEST, nullable=True),  # of the frames, where there is a key
    _at("created_at", nullable=False),
    sa.PrimaryKeyConstraint("device_profile_id", "first"),
    sa.UniqueConstraint("device_profile_id", "idempotency_key"),
)

webhook = sa.Table(
    "webhook",
    metadata,
    _id_column(),
    _of("tenant"),
    sa.Column("name", sa.String(100), nullable=False, server_default=""),
    sa.Column("url", sa.String(2000), nullable=False),
    sa.Column("secret", sa.String(100), nullable=False),  # signs; sealed (sealed.py), because it must be used
    sa.Column("old_secret", sa.String(100), nullable=True),  # signs too, until old_until
    _at("old_until"),
    sa.Column("events", sa.String(100), nullable=False, server_default="done failed cancelled"),  # of WEBHOOK_EVENTS
    sa.Column("every_job", sa.Boolean, nullable=False, server_default=sa.false()),  # false: jobs that name it only
    sa.Column("active", sa.Boolean, nullable=False, server_default=sa.true()),
    _at("created_at", nullable=False),
)

webhook_delivery = sa.Table(  # written with the event it tells of; it outlives the job
    "webhook_delivery",
    metadata,
    _id_column(),
    _of("tenant"),
    _of("webhook"),
    sa.Column("job_id", _ID, nullable=True),  # null: a test
    sa.Column("seq", sa.BigInteger, nullable=True),  # number of the event in its job
    sa.Column("event", sa.String(40), nullable=False),
    sa.Column("body", sa.Text, nullable=False),  # the bytes that are signed and sent, at every attempt the same
    sa.Column("state", sa.String(10), nullable=False),
    sa.Column("attempt", sa.Integer, nullable=False),
    sa.Column("status", sa.Integer, nullable=True),  # the receiver's last answer
    sa.Column("error", sa.String(200), nullable=True),  # why there was none
    _at("next_at"),  # when to try (again); while it is being tried, when to take the sender for dead
    _at("created_at", nullable=False),
    _at("ended_at"),
    sa.Index(None, "state", "next_at"),
    sa.Index(None, "webhook_id", "created_at", "id"),
    _one_of("state", DELIVERY_STATES),
)

audit = sa.Table(  # append-only: triggers refuse to change or delete a row; so it has no foreign keys either
    "audit",
    metadata,
    sa.Column("id", sa.BigInteger().with_variant(sa.Integer, "sqlite"), primary_key=True, autoincrement=True),
    sa.Column("tenant_id", _ID, nullable=False),  # in which it was done
    sa.Column("key_id", _ID, nullable=True),  # null: the operator, at the machine
    sa.Column("key_name", sa.String(100), nullable=False),
    sa.Column("address", sa.String(100), nullable=False),
    sa.Column("action", sa.String(200), nullable=False),  # "POST /v1/jobs/{job_id}/cancel"
    sa.Column("target", sa.String(500), nullable=False),  # the address, or that of what was made
    sa.Column("status", sa.Integer, nullable=False),
    _at("created_at", nullable=False),
    sa.Index(None, "tenant_id", "id"),
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
    sa.Column("priority", sa.SmallInteger, nullable=False, server_default="1"),  # place in PRIORITIES
    sa.Column("turn", sa.BigInteger, nullable=False, server_default="0"),  # number of the claim that served it last
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
    sa.Index(None, "tenant_id", "state", "created_at", "id"),
    sa.Index(  # the order of claims: see store/fair.py
        "ix_job_turn",
        "tenant_id",
        "priority",
        "turn",
        "id",
        sqlite_where=sa.text("finished_at IS NULL"),
        postgresql_where=sa.text("finished_at IS NULL"),
    ),
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
    sa.Column("n_shards", sa.Integer, nullable=False, server_default="0"),  # of kind `run`
    sa.Column("n_done", sa.Integer, nullable=False, server_default="0"),  # of these
    sa.Column("peak_bytes", sa.BigInteger, nullable=True),  # the largest of its shards
    _artifact("artifact_digest"),
    _at("started_at"),
    _at("finished_at"),
    sa.UniqueConstraint("job_id", "ordinal"),
    sa.UniqueConstraint("job_id", "name"),
    sa.Index(None, "artifact_digest"),
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
    sa.Column("attempt", sa.Integer, nullable=False),  # claims that count: of those that were handed back none does
    sa.Column("claims", sa.BigInteger, nullable=False, server_default="0"),  # fence: grows with every claim
    _at("lease_until"),
    sa.Column("ready_at", sa.Double, default=now(), nullable=True),  # since when it could run; ahead: it was put off
    sa.Column("put_off", sa.SmallInteger, nullable=False, server_default="0"),  # how often, for want of disk or store
    sa.Column("need_bytes", sa.BigInteger, nullable=False, server_default="0"),  # memory, an upper estimate
    sa.Column("host", sa.String(255), nullable=True),  # whose memory its worker shares; null: it waits in a group
    sa.Column("worker", sa.String(100), nullable=True),
    _artifact("artifact_digest"),
    sa.Column("cached", sa.Boolean, nullable=False),  # its key was known: taken over, not computed
    sa.Column("seconds", sa.Double, nullable=True),
    sa.Column("peak_bytes", sa.BigInteger, nullable=True),
    sa.Column("error", sa.JSON(none_as_null=True), nullable=True),  # code, message, advice: for the client
    sa.Column("log", sa.Text, nullable=True),  # the traceback: for the operator
    sa.UniqueConstraint("stage_id", "kind", "ordinal"),
    sa.Index(None, "key"),
    sa.Index(None, "job_id", "state", "queue", "ordinal"),
    sa.Index(None, "queue", "state", "ready_at"),
    sa.Index(None, "state", "lease_until"),
    sa.Index(None, "artifact_digest"),
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
