"""Keep what is known of a file on its way in, and the picture of a scene."""

import sqlalchemy as sa
from alembic import op

revision = "0005"
down_revision = "0004"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "upload",
        sa.Column("id", sa.String(length=32), nullable=False),
        sa.Column("tenant_id", sa.String(length=32), nullable=False),
        sa.Column("name", sa.String(length=255), nullable=False),
        sa.Column("n_bytes", sa.BigInteger(), nullable=False),
        sa.Column("digest", sa.String(length=64), nullable=True),
        sa.Column("received", sa.BigInteger(), nullable=False),
        sa.Column("scene_digest", sa.String(length=64), nullable=True),
        sa.Column("refusal", sa.JSON(none_as_null=True), nullable=True),
        sa.Column("created_at", sa.Double(), nullable=False),
        sa.Column("expires_at", sa.Double(), nullable=False),
        sa.ForeignKeyConstraint(
            ["tenant_id"], ["tenant.id"], name=op.f("fk_upload_tenant_id_tenant"), ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_upload")),
    )
    op.create_index(op.f("ix_upload_tenant_id_digest"), "upload", ["tenant_id", "digest"])
    op.create_index(op.f("ix_upload_expires_at"), "upload", ["expires_at"])
    # In place: a batch would drop the table that jobs refer to.
    op.execute(
        "ALTER TABLE scene ADD COLUMN picture_digest VARCHAR(64) "
        "CONSTRAINT fk_scene_picture_digest_artifact REFERENCES artifact (digest)"
    )


def downgrade() -> None:
    with op.batch_alter_table("scene") as scene:
        scene.drop_column("picture_digest")
    op.drop_index(op.f("ix_upload_expires_at"), table_name="upload")
    op.drop_index(op.f("ix_upload_tenant_id_digest"), table_name="upload")
    op.drop_table("upload")
