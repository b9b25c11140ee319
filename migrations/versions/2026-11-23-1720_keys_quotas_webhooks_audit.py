"""Let keys end, tenants have quotas, webhooks be told, and who did what be known."""

import sqlalchemy as sa
from alembic import op

revision = "0004"
down_revision = "operations"
branch_labels = None
depends_on = None

# What a table says of itself is not what a mistake, or an intruder with the service's own account, will respect.
GUARD = {
    "sqlite": (
        "CREATE TRIGGER audit_no_{verb} BEFORE {verb} ON audit BEGIN SELECT RAISE(ABORT, 'audit is append-only'); END",
    ),
    "postgresql": (
        "CREATE OR REPLACE FUNCTION audit_is_append_only() RETURNS trigger LANGUAGE plpgsql AS "
        "$$ BEGIN RAISE EXCEPTION 'audit is append-only'; END $$",
        "CREATE TRIGGER audit_no_{verb} BEFORE {verb} ON audit FOR EACH ROW EXECUTE FUNCTION audit_is_append_only()",
    ),
}


def upgrade() -> None:
    with op.batch_alter_table("tenant") as tenant:
        tenant.add_column(sa.Column("is_operator", sa.Boolean(), server_default=sa.false(), nullable=False))
        tenant.add_column(sa.Column("max_bytes", sa.BigInteger(), nullable=True))
        tenant.add_column(sa.Column("max_jobs", sa.Integer(), nullable=True))
        tenant.add_column(sa.Column("max_running", sa.Integer(), nullable=True))
    op.execute(sa.text("UPDATE tenant SET is_operator = :yes WHERE name = 'default'").bindparams(yes=True))
    with op.batch_alter_table("api_key") as key:
        key.add_column(sa.Column("expires_at", sa.Double(), nullable=True))
        key.add_column(sa.Column("last_used_at", sa.Double(), nullable=True))
    with op.batch_alter_table("device_sample") as sample:
        sample.add_column(sa.Column("idempotency_key", sa.String(length=255), nullable=True))
        sample.add_column(sa.Column("request_digest", sa.String(length=64), nullable=True))
        sample.create_unique_constraint(
            op.f("uq_device_sample_device_profile_id_idempotency_key"), ["device_profile_id", "idempotency_key"]
        )
    with op.batch_alter_table("webhook") as hook:
        hook.add_column(sa.Column("name", sa.String(length=100), server_default="", nullable=False))
        hook.add_column(sa.Column("old_secret", sa.String(length=100), nullable=True))
        hook.add_column(sa.Column("old_until", sa.Double(), nullable=True))
        hook.add_column(
            sa.Column("events", sa.String(length=100), server_default="done failed cancelled", nullable=False)
        )
        hook.add_column(sa.Column("every_job", sa.Boolean(), server_default=sa.false(), nullable=False))
        hook.add_column(sa.Column("active", sa.Boolean(), server_default=sa.true(), nullable=False))
    _webhook_delivery()
    _audit()


def _webhook_delivery() -> None:
    op.create_table(
        "webhook_delivery",
        sa.Column("id", sa.String(length=32), nullable=False),
        sa.Column("tenant_id", sa.String(length=32), nullable=False),
        sa.Column("webhook_id", sa.String(length=32), nullable=False),
        sa.Column("job_id", sa.String(length=32), nullable=True),
        sa.Column("seq", sa.BigInteger(), nullable=True),
        sa.Column("event", sa.String(length=40), nullable=False),
        sa.Column("body", sa.Text(), nullable=False),
        sa.Column("state", sa.String(length=10), nullable=False),
        sa.Column("attempt", sa.Integer(), nullable=False),
        sa.Column("status", sa.Integer(), nullable=True),
        sa.Column("error", sa.String(length=200), nullable=True),
        sa.Column("next_at", sa.Double(), nullable=True),
        sa.Column("created_at", sa.Double(), nullable=False),
        sa.Column("ended_at", sa.Double(), nullable=True),
        sa.CheckConstraint("state IN ('pending', 'delivered', 'failed')", name=op.f("ck_webhook_delivery_state_known")),
        sa.ForeignKeyConstraint(
            ["tenant_id"], ["tenant.id"], name=op.f("fk_webhook_delivery_tenant_id_tenant"), ondelete="CASCADE"
        ),
        sa.ForeignKeyConstraint(
            ["webhook_id"], ["webhook.id"], name=op.f("fk_webhook_delivery_webhook_id_webhook"), ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_webhook_delivery")),
    )
    op.create_index(op.f("ix_webhook_delivery_state_next_at"), "webhook_delivery", ["state", "next_at"])
    op.create_index(
        op.f("ix_webhook_delivery_webhook_id_created_at_id"), "webhook_delivery", ["webhook_id", "created_at", "id"]
    )


def _audit() -> None:
    op.create_table(
        "audit",
        sa.Column("id", sa.BigInteger().with_variant(sa.Integer(), "sqlite"), autoincrement=True, nullable=False),
        sa.Column("tenant_id", sa.String(length=32), nullable=False),
        sa.Column("key_id", sa.String(length=32), nullable=True),
        sa.Column("key_name", sa.String(length=100), nullable=False),
        sa.Column("address", sa.String(length=100), nullable=False),
        sa.Column("action", sa.String(length=200), nullable=False),
        sa.Column("target", sa.String(length=500), nullable=False),
        sa.Column("status", sa.Integer(), nullable=False),
        sa.Column("created_at", sa.Double(), nullable=False),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_audit")),
    )
    op.create_index(op.f("ix_audit_tenant_id_id"), "audit", ["tenant_id", "id"])
    for statement in GUARD.get(op.get_bind().dialect.name, ()):
        for verb in ("UPDATE", "DELETE") if "{verb}" in statement else ("",):
            op.execute(sa.text(statement.replace("{verb}", verb)))


def downgrade() -> None:
    op.drop_table("audit")
    if op.get_bind().dialect.name == "postgresql":
        op.execute(sa.text("DROP FUNCTION audit_is_append_only()"))
    op.drop_table("webhook_delivery")
    with op.batch_alter_table("webhook") as hook:
        for name in ("active", "every_job", "events", "old_until", "old_secret", "name"):
            hook.drop_column(name)
    with op.batch_alter_table("device_sample") as sample:
        sample.drop_constraint(op.f("uq_device_sample_device_profile_id_idempotency_key"), type_="unique")
        sample.drop_column("request_digest")
        sample.drop_column("idempotency_key")
    with op.batch_alter_table("api_key") as key:
        key.drop_column("last_used_at")
        key.drop_column("expires_at")
    with op.batch_alter_table("tenant") as tenant:
        for name in ("max_running", "max_jobs", "max_bytes", "is_operator"):
            tenant.drop_column(name)
