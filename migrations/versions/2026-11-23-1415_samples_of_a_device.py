"""Keep the frames measured on a device, and what its profile rests on."""

import sqlalchemy as sa
from alembic import op

revision = "0003"
down_revision = "0002"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "device_sample",
        sa.Column("tenant_id", sa.String(length=32), nullable=False),
        sa.Column("device_profile_id", sa.String(length=32), nullable=False),
        sa.Column("first", sa.Integer(), nullable=False),
        sa.Column("frames", sa.JSON(), nullable=False),
        sa.Column("created_at", sa.Double(), nullable=False),
        sa.ForeignKeyConstraint(
            ["device_profile_id"],
            ["device_profile.id"],
            name=op.f("fk_device_sample_device_profile_id_device_profile"),
            ondelete="CASCADE",
        ),
        sa.ForeignKeyConstraint(
            ["tenant_id"], ["tenant.id"], name=op.f("fk_device_sample_tenant_id_tenant"), ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("device_profile_id", "first", name=op.f("pk_device_sample")),
    )
    with op.batch_alter_table("device_profile") as profile:
        profile.add_column(sa.Column("refusal", sa.JSON(none_as_null=True), nullable=True))
        profile.add_column(sa.Column("n_samples", sa.Integer(), server_default="0", nullable=False))
        profile.add_column(sa.Column("n_fitted", sa.Integer(), server_default="0", nullable=False))
        profile.alter_column("model", existing_type=sa.JSON(), nullable=True)


def downgrade() -> None:
    op.execute(sa.text("DELETE FROM device_profile WHERE model IS NULL"))
    with op.batch_alter_table("device_profile") as profile:
        profile.alter_column("model", existing_type=sa.JSON(), nullable=False)
        profile.drop_column("n_fitted")
        profile.drop_column("n_samples")
        profile.drop_column("refusal")
    op.drop_table("device_sample")
