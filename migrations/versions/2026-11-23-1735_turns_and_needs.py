"""Count the shards of a stage, state what a shard needs, and know whose turn it is; messages have no time any more."""

import sqlalchemy as sa
from alembic import op

revision = "0006"
down_revision = "0005"
branch_labels = None
depends_on = None

OPEN = sa.text("finished_at IS NULL")


def upgrade() -> None:
    op.add_column("tenant", sa.Column("turn", sa.BigInteger(), server_default="0", nullable=False))
    op.add_column("job", sa.Column("priority", sa.SmallInteger(), server_default="1", nullable=False))
    op.add_column("job", sa.Column("turn", sa.BigInteger(), server_default="0", nullable=False))
    op.create_index(
        "ix_job_turn", "job", ["tenant_id", "priority", "turn", "id"], sqlite_where=OPEN, postgresql_where=OPEN
    )
    op.create_index(op.f("ix_job_tenant_id_state_created_at_id"), "job", ["tenant_id", "state", "created_at", "id"])
    op.add_column("stage", sa.Column("n_shards", sa.Integer(), server_default="0", nullable=False))
    op.add_column("stage", sa.Column("n_done", sa.Integer(), server_default="0", nullable=False))
    op.add_column("stage", sa.Column("peak_bytes", sa.BigInteger(), nullable=True))
    of = "FROM shard WHERE shard.stage_id = stage.id"
    op.execute(
        sa.text(
            f"UPDATE stage SET n_shards = (SELECT count(*) {of} AND kind = 'run'), "
            f"n_done = (SELECT count(*) {of} AND kind = 'run' AND state = 'done'), "
            f"peak_bytes = (SELECT max(shard.peak_bytes) {of})"
        )
    )
    op.add_column("shard", sa.Column("put_off", sa.SmallInteger(), server_default="0", nullable=False))
    op.add_column("shard", sa.Column("need_bytes", sa.BigInteger(), server_default="0", nullable=False))
    op.add_column("shard", sa.Column("host", sa.String(length=255), nullable=True))
    op.create_index(op.f("ix_shard_job_id_state_queue_ordinal"), "shard", ["job_id", "state", "queue", "ordinal"])
    op.create_index(op.f("ix_shard_queue_state_ready_at"), "shard", ["queue", "state", "ready_at"])
    op.drop_index(op.f("ix_shard_job_id_state"), "shard")
    with op.batch_alter_table("shard") as shard:
        shard.drop_column("sent_at")


def downgrade() -> None:
    op.add_column("shard", sa.Column("sent_at", sa.Double(), nullable=True))
    op.create_index(op.f("ix_shard_job_id_state"), "shard", ["job_id", "state"])
    op.drop_index(op.f("ix_shard_queue_state_ready_at"), "shard")
    op.drop_index(op.f("ix_shard_job_id_state_queue_ordinal"), "shard")
    with op.batch_alter_table("shard") as shard:
        shard.drop_column("host")
        shard.drop_column("need_bytes")
        shard.drop_column("put_off")
    with op.batch_alter_table("stage") as stage:
        stage.drop_column("peak_bytes")
        stage.drop_column("n_done")
        stage.drop_column("n_shards")
    op.drop_index(op.f("ix_job_tenant_id_state_created_at_id"), "job")
    op.drop_index("ix_job_turn", "job")
    with op.batch_alter_table("job") as job:
        job.drop_column("turn")
        job.drop_column("priority")
    with op.batch_alter_table("tenant") as tenant:
        tenant.drop_column("turn")
