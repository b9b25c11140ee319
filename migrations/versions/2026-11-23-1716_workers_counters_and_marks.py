"""Know the workers, count what metrics show, mark artifacts that nothing refers to."""

import sqlalchemy as sa
from alembic import op

revision = "operations"
down_revision = "0003"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "worker",
        sa.Column("name", sa.String(length=100), nullable=False),
        sa.Column("host", sa.String(length=255), nullable=False),
        sa.Column("queues", sa.String(length=200), nullable=False),
        sa.Column("capability", sa.JSON(), nullable=False),
        sa.Column("started_at", sa.Double(), nullable=False),
        sa.Column("heartbeat_at", sa.Double(), nullable=False),
        sa.Column("stopped_at", sa.Double(), nullable=True),
        sa.Column("shard_id", sa.String(length=32), nullable=True),
        sa.Column("stage", sa.String(length=40), nullable=True),
        sa.Column("shard_since", sa.Double(), nullable=True),
        sa.Column("done", sa.BigInteger(), nullable=False),
        sa.Column("failed", sa.BigInteger(), nullable=False),
        sa.Column("busy_seconds", sa.Double(), nullable=False),
        sa.Column("recent", sa.Integer(), nullable=False),
        sa.PrimaryKeyConstraint("name", name=op.f("pk_worker")),
    )
    op.create_index(op.f("ix_worker_heartbeat_at"), "worker", ["heartbeat_at"])
    op.create_table(
        "counter",
        sa.Column("name", sa.String(length=60), nullable=False),
        sa.Column("labels", sa.String(length=200), nullable=False),
        sa.Column("value", sa.Double(), nullable=False),
        sa.PrimaryKeyConstraint("name", "labels", name=op.f("pk_counter")),
    )
    op.add_column("artifact", sa.Column("marked_at", sa.Double(), nullable=True))
    op.create_index(op.f("ix_artifact_marked_at"), "artifact", ["marked_at"])
    op.add_column("shard", sa.Column("ready_at", sa.Double(), nullable=True))
    op.create_index(op.f("ix_shard_artifact_digest"), "shard", ["artifact_digest"])
    op.create_index(op.f("ix_stage_artifact_digest"), "stage", ["artifact_digest"])


def downgrade() -> None:
    op.drop_index(op.f("ix_stage_artifact_digest"), "stage")
    op.drop_index(op.f("ix_shard_artifact_digest"), "shard")
    with op.batch_alter_table("shard") as shard:
        shard.drop_column("ready_at")
    op.drop_index(op.f("ix_artifact_marked_at"), "artifact")
    with op.batch_alter_table("artifact") as artifact:
        artifact.drop_column("marked_at")
    op.drop_table("counter")
    op.drop_index(op.f("ix_worker_heartbeat_at"), "worker")
    op.drop_table("worker")
