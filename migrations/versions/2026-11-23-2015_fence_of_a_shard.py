"""Number the claims of a shard: attempts are given back, and so cannot tell one holder from the next."""

import sqlalchemy as sa
from alembic import op

revision = "0007"
down_revision = "0006"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.add_column("shard", sa.Column("claims", sa.BigInteger(), server_default="0", nullable=False))


def downgrade() -> None:
    with op.batch_alter_table("shard") as shard:
        shard.drop_column("claims")
